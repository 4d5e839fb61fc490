"""The simulated drives of the state log, in tests/data/state_log.

`python -m benchmarks.state_log_drives` makes them again. They are committed, since simulations of
two machines differ in the last digit; `make state-log` renews only the log.
"""

import math
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from benchmarks.consistency.hardships import with_walkers
from benchmarks.consistency.scenarios import MOUNT
from benchmarks.consistency.trial import Leg, trial, wandering, without
from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings, Truth
from homeward.drives.folder import write_folder
from homeward.drives.landmarks import KnownDistance, KnownLandmarks
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, between
from homeward.lab.simulation import scenario as sim
from homeward.lab.simulation.simulate import Simulation, simulate

FOLDER = Path(__file__).parents[1] / "tests" / "data" / "state_log"
DIGITS = 6  # of all numbers in the files
RATES = sim.Rates(odometry=10.0, bearings=4.0, truth=2.0)
NOISE = sim.Noise(bearing_sigma=0.01, home_sigma=0.01, wrong_ids=0.03)
RANGE_SIGMA = 0.1  # [m]
SURVEY_FRAME = Pose(1.5, -0.8, 0.4)  # of the survey, in the home frame [m, m, rad]
SURVEY_ERROR = 1.2  # of one of the surveyed positions [m]
MOVED_AT_S, MOVED_BY = 35.0, (0.9, -0.7)  # in mid-drive [s], [m]
Rows = TypeVar("Rows", Odometry, Sightings, Truth)


def moved() -> Drive:
    """Return a drive among landmarks of which a third moved since home; odometry noise unknown."""
    whole = trial(Leg(_simulated(1, moved=sim.Moved(count=4))))
    return without(whole, odometry=True).drive


def surveyed() -> Drive:
    """Return a drive with ranges, a measured distance and a survey with one wrong position."""
    made = _simulated(2)
    drive, ids, places = made.drive, list(made.world.ids), made.world.in_home_frame
    away = np.hypot(*_from_camera(made, drive.sightings))
    away += RANGE_SIGMA * np.random.default_rng(2).normal(size=away.size)
    points = between(SURVEY_FRAME, Pose(*places.T, 0.0))
    survey = {
        ids[k]: {"x": _rounded(points.x[k] + SURVEY_ERROR * (k == 3)), "y": _rounded(points.y[k])}
        for k in range(7)
    }
    ruler = {"between": (ids[8], ids[9]), "distance": _rounded(np.hypot(*(places[8] - places[9])))}
    sensor = drive.settings.sensor.model_copy(update={"range_sigma": RANGE_SIGMA})
    return replace(
        drive,
        sightings=replace(drive.sightings, range=np.maximum(away, RANGE_SIGMA)),
        settings=drive.settings.model_copy(update={"sensor": sensor}),
        known=KnownLandmarks(landmarks=survey, distances=(KnownDistance(**ruler),)),
    )


def walking() -> Drive:
    """Return a drive in which four landmarks walk and two others move in mid-drive."""
    still = _simulated(4, landmarks=sim.Ring(count=14, distance=(2.5, 5.0)))
    walks, walkers = with_walkers(still, 4, 0.3)
    seen = walks.drive.sightings
    names = [name for name in still.world.ids if name not in walkers][:2]
    x, y = _from_camera(still, seen)
    turn = still.drive.truth.at(seen.t).heading
    c, s, (dx, dy) = np.cos(turn), np.sin(turn), MOVED_BY
    moves = np.isin(seen.landmark.astype(str), names) & (seen.t > MOVED_AT_S)
    off = np.arctan2(y - s * dx + c * dy, x + c * dx + s * dy) - np.arctan2(y, x)
    changed = replace(seen, bearing=np.asarray(wrap(seen.bearing + np.where(moves, off, 0.0))))
    return replace(walks.drive, sightings=changed)


def narrow() -> Drive:
    """Return a drive with a camera of 90 deg whose extrinsics are unknown."""
    view = sim.Visibility(probability=0.8, field_of_view=math.radians(90))
    many = sim.Ring(count=24, distance=(2.5, 5.0))
    whole = trial(Leg(_simulated(6, landmarks=many, visibility=view, sensor=MOUNT)))
    return without(whole, mount=True).drive


DRIVES: dict[str, Callable[[], Drive]] = {
    "moved": moved,
    "surveyed": surveyed,
    "walking": walking,
    "narrow": narrow,
}


def _simulated(seed: int, **changes: Any) -> Simulation:
    given = {"name": "state log", "rates": RATES, "noise": NOISE} | changes
    return simulate(wandering(seed, 0, 40, (0.5, 2.0), speed=0.3, seconds=60.0, **given))


def _from_camera(made: Simulation, seen: Sightings) -> tuple[np.ndarray, np.ndarray]:
    """Return the true positions of the landmarks of sightings in the robot's frame, (n,) [m]."""
    assert made.drive.truth is not None
    ids = list(made.world.ids)
    x, y = made.world.in_home_frame[[ids.index(name) for name in seen.landmark]].T
    at = between(made.drive.truth.at(seen.t), Pose(x, y, 0.0))
    return at.x, at.y


def rounded(drive: Drive) -> Drive:
    """Return a drive whose numbers have `DIGITS` decimals."""

    def of(rows: Rows) -> Rows:
        columns = {f.name: getattr(rows, f.name) for f in fields(rows)}
        return replace(
            rows, **{n: v.round(DIGITS) for n, v in columns.items() if v.dtype.kind == "f"}
        )

    home = {
        n: HomeBearing(_rounded(b.bearing), _rounded(b.sigma), b.camera)
        for n, b in drive.home.items()
    }
    return replace(
        drive,
        odometry=of(drive.odometry),
        sightings=of(drive.sightings),
        home=home,
        truth=None if drive.truth is None else of(drive.truth),
    )


def _rounded(value: float) -> float:
    return round(float(value), DIGITS)


def main() -> None:
    for name, make in DRIVES.items():
        write_folder(rounded(make()), FOLDER / name)


if __name__ == "__main__":
    main()
