"""The exported C: against Python, and on an emulated Cortex-M4F.

`python -m benchmarks.mcu` replays a simulated drive of 12 landmarks under qemu-system-arm
(mps2-an386, counting instructions), prints flash, RAM and instructions, and fails if they exceed
the limits in docs/do/microcontroller.md. `--moved [--runs 100]` prints instead the EKF's position
errors at the end of simulated drives, with and without the resection.
"""

import math
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import monte_carlo
from homeward.drives.drive import Drive
from homeward.lab.engine.export.source import exported_files
from homeward.lab.filters.settings import FilterSettings
from homeward.lab.simulation.scenario import Moved
from homeward.lab.simulation.simulate import PAPER_HOMING, Simulation, simulate
from homeward.lab.studies.study.trial import simulated_trial
from homeward.registry import make_estimator

REPLAY = Path(__file__).parents[1] / "tests" / "lab" / "engine" / "replay.c"
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
LIMITS = {
    "flash of the example [bytes]": 64_000,
    "RAM: EKF, resection and stack [bytes]": 8_000,
    "odometry [instructions]": 32_000,
    "bearings [instructions]": 22_000,
    "resection [instructions]": 3_500_000,
}
"""Limits for 12 landmarks in floats; they vary a little with the compiler's version."""


def missing() -> list[str]:
    return [k for k in ARM if shutil.which(k) is None]


def scene(q: int, moved: int, seed: int) -> Simulation:
    """Return the paper's homing among `q` landmarks, some of them moved by 0.2 to 0.5 rad."""
    landmarks = PAPER_HOMING.landmarks.model_copy(update={"count": q})
    changes = {"landmarks": landmarks, "moved": Moved(count=moved, fault=(0.2, 0.5)), "seed": seed}
    return simulate(PAPER_HOMING.model_copy(update=changes))


def export(folder: Path, q: int, single: bool, settings: FilterSettings | None = None) -> None:
    for name, text in exported_files(q, settings or FilterSettings(), single).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def host_build(folder: Path, *flags: str) -> Path:
    source, out = folder / "src", folder / "replay"
    files = [REPLAY, source / "homeward_ekf.c"]
    subprocess.run([*HOST, *flags, "-I", source, *files, "-lm", "-o", out], check=True)
    return out


def arm_build(folder: Path, main: Path) -> Path:
    board, out = folder / "examples" / "cortex_m4f", folder / f"{main.stem}.elf"
    files = [folder / "src" / "homeward_ekf.c", main, board / "startup.c"]
    last = ["-T", board / "mps2_an386.ld", "--specs=rdimon.specs", "-lm", "-o", out]
    subprocess.run([*ARM_GCC, "-I", folder / "src", *files, *last], check=True)
    return out


def emulation(image: Path) -> list[str]:
    words = "qemu-system-arm -M mps2-an386 -display none -serial none -monitor none -icount shift=5"
    return [*words.split(), "-semihosting-config", "enable=on,target=native", "-kernel", str(image)]


class Samples(NamedTuple):
    """A drive in the format of replay.c, and Python's result for each sample."""

    text: str
    python: np.ndarray  # (samples, q + 3 + 3 + 6): state, pose and lower triangle of its covariance


def samples(drive: Drive, every_s: float = math.inf) -> Samples:
    """Return a drive, with a resection each `every_s` that restarts the EKF."""
    estimator = make_estimator("ekf", drive)
    tuning, ids = estimator._backend.tuning, list(drive.home)
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
            seen = [f"{ids.index(k)} {y!r} {b.get(k, 0.0)!r}" for k, y in a.items() if k in ids]
            lines.append(f"b {round(t * 1e6)} {len(seen)} {' '.join(seen)}")
            if t - solved >= every_s:
                solved = t
                lines.append("s 1")
        at = estimator.estimate(t)
        python.append([*estimator._belief.state, *at.pose, *at.covariance[np.tril_indices(3)]])
    if not math.isinf(every_s):
        lines.append("s 1")
    return Samples("\n".join(lines) + "\n", np.array(python))


class Replayed(NamedTuple):
    """Result of the C code for a drive."""

    kinds: str  # o or b of each sample
    numbers: np.ndarray
    """For each: instructions, bytes of stack, status, accepted, then as `Samples.python`."""
    answers: np.ndarray
    """For each resection: instructions, bytes of stack, decided, located, consistent, pose,
    covariance."""


def replayed(command: Iterable[str | Path], text: str) -> Replayed:
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


class EndErrors(NamedTuple):
    """Position errors at the end of each run [m]."""

    errors: dict[str, np.ndarray]
    """Of the EKF alone, of the resection, of the EKF restarted from it each second; and the
    Cramer-Rao bound if the moved landmarks are known."""
    right: np.ndarray  # (runs,), whether exactly the moved landmarks were left out

    def rms(self, name: str) -> float:
        return float(np.sqrt(np.mean(np.square(self.errors[name]))))


def end_errors(folder: Path, q: int, moved: int, seeds: Iterable[int]) -> EndErrors:
    """Run the exported filter, in floats, and Python's EKF over simulated drives."""
    export(folder, q, single=True)
    command = [host_build(folder)]
    rows, right = [], []
    for seed in seeds:
        simulation = scene(q, moved, seed)
        drive = simulation.drive
        given = samples(drive, every_s=1.0)
        found = replayed(command, given.text)
        truth = np.array([drive.truth.x[-1], drive.truth.y[-1]])
        pose = slice(3 + q, 5 + q)
        ends = given.python[-1, pose], found.answers[-1, 5:7], found.numbers[-1, 4:][pose]
        rows.append([*(np.hypot(*(end - truth)) for end in ends), _bound(simulation)])
        left_out = {k for i, k in enumerate(drive.home) if not int(found.answers[-1, 4]) >> i & 1}
        right.append(left_out == set(simulation.world.moved))
    names = ("ekf", "resection", "exported", "bound")
    return EndErrors(dict(zip(names, np.array(rows).T, strict=True)), np.array(right))


def _bound(simulation: Simulation) -> float:
    """Return the bound of the position's standard deviation at the end [m]."""
    covariance = simulated_trial(simulation).bound[-1]
    return math.sqrt(covariance[0, 0] + covariance[1, 1])


def figures(folder: Path) -> dict[str, int]:
    """Return the figures of `LIMITS` for the emulated processor."""
    export(folder, LANDMARKS, single=True)
    example = arm_build(folder, folder / "examples" / "cortex_m4f" / "main.c")
    size = _output("arm-none-eabi-size", example).splitlines()[1].split()
    symbols = [line.split() for line in _output("arm-none-eabi-nm", "-S", example).splitlines()]
    objects = {s[3]: int(s[1], 16) for s in symbols if s[-1] in ("ekf", "resection")}
    given = samples(scene(LANDMARKS, 2, seed=3).drive, every_s=1.0)
    image = arm_build(folder, REPLAY)
    found = replayed(emulation(image), given.text)
    kinds = np.array(list(found.kinds))
    deepest = max(found.numbers[:, 1].max(), found.answers[:, 1].max())
    values = (
        int(size[0]) + int(size[1]),
        sum(objects.values()) + int(deepest),
        *(int(found.numbers[kinds == k, 0].max()) for k in "ob"),
        int(found.answers[:, 0].max()),
    )
    return dict(zip(LIMITS, values, strict=True))


def _output(*command: str | Path) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def main() -> None:
    given = monte_carlo.parsed(__doc__, moved=False, runs=100)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if given.moved:
            print("landmarks moved  RMSE: ekf  resection  exported  bound  exact detection rate")
            for q, moved in ((7, 0), (7, 1), (7, 2), (7, 3), (12, 0), (12, 2), (12, 4), (12, 6)):
                runs = end_errors(folder, q, moved, range(given.runs))
                errors = "  ".join(f"{runs.rms(k):.4f} m" for k in runs.errors)
                print(f"{q:9} {moved:5}  {errors}  {runs.right.mean():.0%}", flush=True)
        elif missing():
            print(f"skipped: {', '.join(missing())} not installed")
        else:
            found = figures(folder)
            for k, limit in LIMITS.items():
                print(f"{k:40} {found[k]:>9,}  at most {limit:>9,}")
            sys.exit(any(found[k] > limit for k, limit in LIMITS.items()))


if __name__ == "__main__":
    main()
