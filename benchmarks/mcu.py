"""The exported C: against Python, and on an emulated Cortex-M4F.

`python -m benchmarks.mcu` replays a simulated drive of 12 landmarks under qemu-system-arm
(mps2-an386, counting instructions), compares every sample with Python's EKF, prints flash, RAM and
instructions, and fails where they are above what docs/microcontroller.md says. With `--moved` it
prints instead, over many simulated drives, how far off the EKF ends with and without the resection.
"""

from __future__ import annotations

import argparse
import math
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from homeward.bounds import posterior_bound
from homeward.drives.drive import Drive
from homeward.engine.export.project import project
from homeward.filters.settings import FilterSettings
from homeward.registry import make_estimator
from homeward.simulation.presets import PAPER_HOMING
from homeward.simulation.scenario import Moved
from homeward.simulation.simulate import Simulation, simulate

REPLAY = Path(__file__).parents[1] / "tests" / "engine" / "replay.c"
HOST = (
    *("cc", "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion"),
    *("-Wshadow", "-Wdouble-promotion", "-ffp-contract=off"),
)
ARM_GCC = (
    *("arm-none-eabi-gcc", "-std=c99", "-Os", "-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard"),
    *("-mfpu=fpv4-sp-d16", "-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections"),
    *("-Wall", "-Wextra", "-Werror", "-Wdouble-promotion"),
)
ARM = ("arm-none-eabi-gcc", "qemu-system-arm")
LANDMARKS = 12


def missing() -> list[str]:
    """Return the programs that emulation needs and this machine lacks."""
    return [k for k in ARM if shutil.which(k) is None]


def scene(q: int, moved: int, seed: int) -> Simulation:
    """Return the paper's homing among `q` landmarks of which some were moved by 0.2 to 0.5 rad."""
    landmarks = PAPER_HOMING.landmarks.model_copy(update={"count": q})
    changes = {"landmarks": landmarks, "moved": Moved(count=moved, fault=(0.2, 0.5)), "seed": seed}
    return simulate(PAPER_HOMING.model_copy(update=changes))


def export(folder: Path, q: int, single: bool, settings: FilterSettings | None = None) -> None:
    """Write the library."""
    for name, text in project(q, settings or FilterSettings(), single).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def host_build(folder: Path, *flags: str) -> Path:
    """Compile the replay for this machine, every warning an error."""
    source, out = folder / "src", folder / "replay"
    files = [REPLAY, source / "homeward_ekf.c"]
    subprocess.run([*HOST, *flags, "-I", source, *files, "-lm", "-o", out], check=True)
    return out


def arm_build(folder: Path, main: Path) -> Path:
    """Compile a main program for the Cortex-M4F as it is emulated."""
    board, out = folder / "examples" / "cortex_m4f", folder / f"{main.stem}.elf"
    files = [folder / "src" / "homeward_ekf.c", main, board / "startup.c"]
    last = ["-T", board / "mps2_an386.ld", "--specs=rdimon.specs", "-lm", "-o", out]
    subprocess.run([*ARM_GCC, "-I", folder / "src", *files, *last], check=True)
    return out


def emulation(image: Path) -> list[str]:
    """Return the command that runs an image, counting instructions."""
    words = "qemu-system-arm -M mps2-an386 -display none -serial none -monitor none -icount shift=5"
    return [*words.split(), "-semihosting-config", "enable=on,target=native", "-kernel", str(image)]


class Samples(NamedTuple):
    """A drive in the words of replay.c, and what Python makes of each sample."""

    text: str
    python: np.ndarray
    """(samples, q + 3 + 3 + 6): state, pose and lower triangle of its covariance."""


def samples(drive: Drive, every_s: float = math.inf, restart: bool = True) -> Samples:
    """Return a drive; with the resection solved so often, and the EKF begun again from it."""
    estimator = make_estimator("ekf", drive)
    tuning, ids = estimator._runner.tuning, list(drive.home)
    sigmas = [b.sigma for b in drive.home.values()]
    home_sigma = tuning.bearing_sigma if np.isnan(sigmas).any() else float(np.mean(sigmas))
    yaw, density = drive.settings.sensor.yaw, np.sqrt(tuning.input_density)
    head = [*tuning.polar, *np.sqrt(tuning.variance[:3]), *tuning.stored]
    head += [yaw, tuning.bearing_sigma, home_sigma, *density]
    lines, python = [" ".join(repr(float(x)) for x in head)], []
    o = drive.odometry
    rows = [(t, 0, (v, w)) for t, v, w in zip(o.t, o.v, o.omega, strict=True)]
    rows += [(t, 1, (seen, own)) for t, seen, own in drive.sightings.stamps()]
    solved = rows[0][0]
    for t, kind, (a, b) in sorted(rows, key=lambda row: row[:2]):
        if kind == 0:
            estimator.odometry(t, a, b)
            lines.append(f"o {round(t * 1e6)} {float(a)!r} {float(b)!r}")
        else:
            estimator.bearings(t, a, b)
            seen = " ".join(f"{ids.index(k)} {y!r} {b.get(k, 0.0)!r}" for k, y in a.items())
            lines.append(f"b {round(t * 1e6)} {len(a)} {seen}")
            if t - solved >= every_s:
                solved = t
                lines.append(f"s {int(restart)}")
        at = estimator.estimate(t)
        python.append([*estimator._belief.state, *at.pose, *at.covariance[np.tril_indices(3)]])
    if not math.isinf(every_s):
        lines.append(f"s {int(restart)}")
    return Samples("\n".join(lines) + "\n", np.array(python))


class Replayed(NamedTuple):
    """What the C made of a drive."""

    kinds: str
    """o or b of each sample."""
    numbers: np.ndarray
    """Of each: instructions, bytes of stack, status, accepted, then as `Samples.python`."""
    answers: np.ndarray
    """Of each solution: instructions, bytes of stack, decided, located, consistent, pose, covariance."""


def replayed(command: Iterable[str | Path], text: str) -> Replayed:
    """Run a replay."""
    done = subprocess.run(
        [*map(str, command)], input=text, capture_output=True, text=True, check=True, timeout=500
    )
    rows = [line.split() for line in done.stdout.splitlines()]
    samples = [row for row in rows if row[0] != "s"]
    return Replayed(
        "".join(row[0] for row in samples),
        np.array([row[1:] for row in samples], float),
        np.array([row[1:] for row in rows if row[0] == "s"], float),
    )
