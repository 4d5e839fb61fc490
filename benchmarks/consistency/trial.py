"""One simulated drive, of one or several legs, and its bound.

Between two legs of a drive the world changes, or the robot is carried.
"""

import math
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from homeward.drives.drive import Drive, Odometry, Sightings, Truth
from homeward.drives.settings import OdometryNoise, Sensor
from homeward.geometry.frames import Pose, between
from homeward.lab.simulation import scenario as sim
from homeward.lab.simulation.simulate import Simulation
from homeward.lab.studies.study.trial import Trial, drive_bound

SAME_PLACE_M = 1e-6  # maximum shift of a landmark that has not moved [m]


@dataclass(frozen=True)
class SurveyedTrial(Trial):
    """A drive with the true positions of its landmarks when home was stored."""

    survey: dict[str, tuple[float, float]] = field(default_factory=dict)
    """In the home frame [m]; for baselines that get a map."""


@dataclass(frozen=True)
class Leg:
    """A part of a drive with a static world."""

    simulation: Simulation
    begins: float = 0.0  # [s]
    carried: bool = False  # whether the robot was carried to its start


def wandering(
    seed: int,
    stream: int,
    count: int,
    reach: tuple[float, float],
    *,
    speed: float,
    seconds: float,
    turned: float = 1.0,
    **changes: Any,
) -> sim.Scenario:
    """Return a random path among 12 landmarks all round home, with white noise and no start prior.

    It has `count` waypoints at distances from home within `reach` [m], at `speed` [m/s]. `stream`
    is part of the path's seed; `turned` is the initial heading over the direction of the first
    waypoint; `changes` are other fields of the scenario.
    """
    rng = np.random.default_rng([seed, stream])
    far, way = rng.uniform(*reach, count), rng.uniform(-math.pi, math.pi, count)
    points = [
        (float(r * math.cos(a)), float(r * math.sin(a))) for r, a in zip(far, way, strict=True)
    ]
    heading = float(way[0]) * turned
    given: dict[str, Any] = {
        "name": "wandering",
        "seed": seed,
        "landmarks": sim.Ring(count=12, distance=(2.5, 5.0)),
        "visibility": sim.Visibility(probability=0.8),
        "noise": sim.Noise(bearing_sigma=0.01, home_sigma=0.01),
        "rates": sim.Rates(odometry=20.0, bearings=5.0, truth=10.0),
        "odometry": sim.OdometryErrors(speed_sigma=0.01, turn_sigma=0.01),
        "start": sim.StartPose(x=points[0][0], y=points[0][1], heading=heading, prior=False),
        "trajectory": sim.Waypoints(speed=speed, duration=seconds, points=points[1:]),
    }
    return sim.Scenario(**(given | changes))


def trial(*legs: Leg) -> SurveyedTrial:
    """Join the legs of one drive, and compute its bound."""
    first = legs[0].simulation
    drive = _joined(legs)
    case, ids = first.scenario, list(first.world.ids)
    places = np.array([leg.simulation.world.in_home_frame for leg in legs])
    # A landmark that moves in mid-drive is a new one from then on, without a home bearing.
    fresh = np.ones(places.shape[:2], bool)
    fresh[1:] = np.hypot(*np.moveaxis(np.diff(places, axis=0), -1, 0)) > SAME_PLACE_M
    number = np.maximum.accumulate(np.where(fresh, fresh.cumsum().reshape(fresh.shape) - 1, 0))
    marks = places[fresh]
    stored = np.zeros(len(marks), bool)
    stored[: len(ids)] = [i in drive.home and i not in first.world.moved for i in ids]

    stamps = np.unique(drive.sightings.t)
    leg_of = np.searchsorted([leg.begins for leg in legs], stamps, side="right") - 1
    row = np.searchsorted(stamps, drive.sightings.t)
    column = number[leg_of[row], [ids.index(n) for n in drive.sightings.landmark]]
    carried = np.array([leg.carried for leg in legs])[leg_of[1:]] & (np.diff(leg_of) > 0)
    _, bound = drive_bound(drive, case, marks, column, ~stored, carried=carried)
    shifted = {n for n, new in zip(ids, fresh[1:].any(axis=0), strict=True) if new}
    moved = frozenset(shifted | set(first.world.moved))
    x, y = first.world.places_at_home.T
    at = between(first.world.home, Pose(x, y, 0.0))
    survey = dict(zip(ids, zip(at.x.tolist(), at.y.tolist(), strict=True), strict=True))
    return SurveyedTrial(drive, moved, stamps, bound, survey=survey)


def _joined(legs: tuple[Leg, ...]) -> Drive:
    """Return one drive of all legs, with home and settings of the first."""
    drives = [leg.simulation.drive for leg in legs]
    tables = {}
    for name, kind in {"odometry": Odometry, "sightings": Sightings, "truth": Truth}.items():
        parts = [getattr(drive, name) for drive in drives]
        columns = {f.name: [getattr(part, f.name) for part in parts] for f in fields(kind)}
        columns["t"] = [t + leg.begins for t, leg in zip(columns["t"], legs, strict=True)]
        tables[name] = kind(**{key: np.concatenate(column) for key, column in columns.items()})
    return replace(drives[0], **tables)


def scaled(whole: SurveyedTrial, factor: float) -> Trial:
    """Return the same drive with all lengths scaled by a factor."""
    drive = whole.drive
    assert drive.truth is not None
    known = drive.settings.odometry
    sigma = None if known.speed_sigma is None else factor * known.speed_sigma
    size = np.array([factor, factor, 1.0])
    return replace(
        whole,
        drive=replace(
            drive,
            odometry=replace(drive.odometry, v=factor * drive.odometry.v),
            truth=replace(drive.truth, x=factor * drive.truth.x, y=factor * drive.truth.y),
            settings=drive.settings.model_copy(
                update={"odometry": known.model_copy(update={"speed_sigma": sigma})}
            ),
        ),
        bound=whole.bound * size[:, None] * size,
        survey={n: (factor * x, factor * y) for n, (x, y) in whole.survey.items()},
    )


def without(whole: Trial, *, mount: bool = False, odometry: bool = False) -> Trial:
    """Return the same drive without the camera's extrinsics, or the odometry's noise."""
    settings = whole.drive.settings
    left_out: dict[str, object] = {}
    if mount:
        known = settings.sensor
        left_out["sensor"] = Sensor(
            bearing_sigma=known.bearing_sigma, field_of_view=known.field_of_view
        )
    if odometry:
        left_out["odometry"] = OdometryNoise()
    return replace(whole, drive=replace(whole.drive, settings=settings.model_copy(update=left_out)))


def slipping(whole: Trial, seed: int, share: float, every_s: float, for_s: float) -> Trial:
    """Return the same drive with wheels that sometimes slip, by a share; times as in `spells`."""
    o = whole.drive.odometry
    slips = spells(o.t, np.random.default_rng([seed, 1]), every_s, for_s)
    faster = replace(o, v=np.where(slips, o.v / (1.0 - share), o.v))
    return replace(whole, drive=replace(whole.drive, odometry=faster))


def spells(t: np.ndarray, rng: np.random.Generator, every_s: float, for_s: float) -> np.ndarray:
    """Return which times (n,) are in spells, which start `every_s` on average and last `for_s`."""
    starts = np.cumsum(rng.exponential(every_s, int(3 * t[-1] / every_s) + 3))
    before = np.searchsorted(starts, t, side="right") - 1
    return np.asarray((before >= 0) & (t - starts[before] < for_s))


def lagging(whole: Trial, seconds: float) -> Trial:
    """Return the same drive with odometry stamped `seconds` too late."""
    o = whole.drive.odometry
    return replace(whole, drive=replace(whole.drive, odometry=replace(o, t=o.t + seconds)))
