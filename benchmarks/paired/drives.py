"""The drives of the benchmarks, as folders that any version of homeward reads.

A benchmark has families of drives, and a family has numbered drives. Each drive is made once, by
the present version, so that all variants run on the same one.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

from benchmarks.case2 import PARTS
from benchmarks.consistency.scenarios import SCENARIOS, Family
from benchmarks.cost import make_drive
from benchmarks.kidnapped import CARRIED, calamity, hall
from benchmarks.leaderboard.families import HOME_NOISE_DEG, real
from benchmarks.leaderboard.set_1 import set_1_drive
from benchmarks.mrclam import data
from homeward.drives.drive import Drive, Truth
from homeward.drives.folder import write_folder
from homeward.drives.opening import open_drive
from homeward.errors import InputError
from homeward.geometry.frames import Pose, compose
from homeward.lab.simulation.simulate import PAPER_HOMING, simulate
from homeward.lab.studies.study.trial import Trial

TIMED_S, TIMED_HZ = 60.0, (2.0, 20.0)  # duration of timed drives, and their rates of bearings


class Case(NamedTuple):
    """One drive of a benchmark."""

    benchmark: str
    family: str
    number: int


@dataclass(frozen=True)
class Input:
    """A drive, with its answers."""

    drive: Drive
    moved: frozenset[str] | None = None
    """Landmarks that moved; None: unknown."""
    needs_truth: bool = False
    """Whether its ground truth is to be smoothed from its survey, which the localiser must not get.
    """
    folder: Path | None = None
    """Where it is already; None: nowhere."""


def mrclam() -> dict[str, Family]:
    """MRCLAM sets 6 and 1, the latter with a smoothed solution in place of ground truth."""
    found = real()
    return {n: replace(f, make=_set_1) if n == "utias-1" else f for n, f in found.items()}


def _set_1(number: int) -> Input:
    return Input(set_1_drive(number, math.radians(HOME_NOISE_DEG)), frozenset(), needs_truth=True)


def case2() -> dict[str, Family]:
    """The paper's Case 2: 0 to 2 of 7 landmarks moved."""

    def make(change: Mapping[str, object], seed: int) -> Input:
        made = simulate(PAPER_HOMING.model_copy(update={**change, "seed": seed}))
        return Input(made.drive, frozenset(made.world.moved))

    return {name: Family("", partial(make, change)) for name, change in PARTS.items()}


def cost() -> dict[str, Family]:
    """Time per frame, with 20 landmarks; a seed is a repetition."""
    return {
        f"{rate:g} Hz": Family("", lambda _, rate=rate: Input(make_drive(20, TIMED_S, rate=rate)))
        for rate in TIMED_HZ
    }


def kidnapped() -> dict[str, Family]:
    """Drives of benchmarks.kidnapped."""

    makes = {"calamities": lambda seed: calamity(seed)[1]}
    makes |= {how: lambda seed, how=how: hall(seed, CARRIED[how]) for how in CARRIED}
    return {
        name: Family("", lambda seed, make=make: Input(make(seed), frozenset()))
        for name, make in makes.items()
    }


def field() -> dict[str, Family]:
    """Field cases with ground truth."""
    return {
        str(path.relative_to(data() / "field")): Family("", partial(_field_case, path), copies=0)
        for path in _field_folders()
    }


def _field_folders() -> Iterator[Path]:
    for path in sorted((data() / "field").glob("**/truth.csv")):
        if (path.parent / "bearings.csv").exists() and (path.parent / "odometry.csv").exists():
            try:
                usable = open_drive(path.parent).truth is not None
            except InputError:
                continue
            if usable:
                yield path.parent


def _field_case(path: Path, _: int) -> Input:
    drive = open_drive(path)
    if path.name not in TRUTHS:
        return Input(drive, folder=path)
    assert drive.truth is not None
    return Input(replace(drive, truth=TRUTHS[path.name](drive.truth)))


def _of_turtlebot(truth: Truth) -> Truth:
    """Return the ground truth of the robot's centre, without the interval in which it is wrong."""
    begin, end, camera = 270.0, 365.0, Pose(0.115, 0.0, 0.0)
    t = truth.t - truth.t[0]
    right = truth.rows((t < begin) | (t > end))
    at = compose(Pose(right.x, right.y, right.heading), camera)
    return Truth(right.t, at.x, at.y, at.heading)


TRUTHS = {"44-turtlebot-course": _of_turtlebot}
"""Corrections of ground truth, as the README of the field case specifies."""
BENCHMARKS: dict[str, Callable[[], dict[str, Family]]] = {
    "gate": lambda: SCENARIOS,
    "mrclam": mrclam,
    "case2": case2,
    "cost": cost,
    "kidnapped": kidnapped,
    "field": field,
}


@cache
def families(benchmark: str) -> dict[str, Family]:
    """Return the families of a benchmark by name."""
    return BENCHMARKS[benchmark]()


def cases(benchmark: str, seeds: int, only: list[str] | None = None) -> list[Case]:
    """Return the drives of a benchmark, the first seeds first; `only` some families."""
    found = [
        Case(benchmark, name, k)
        for name, family in families(benchmark).items()
        if not only or name in only
        for k in range(seeds * family.copies or 1)
    ]
    return sorted(found, key=lambda case: case.number)


def made(case: Case, folder: Path) -> Input:
    """Return the drive of a case, in `folder` unless it is in one already."""
    found = families(case.benchmark)[case.family].drive(case.number)
    if isinstance(found, Trial):
        found = Input(found.drive, found.moved)
    if found.folder is not None:
        return found
    write_folder(found.drive, folder)
    return replace(found, folder=folder)
