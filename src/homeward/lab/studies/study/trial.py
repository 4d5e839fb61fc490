"""Drives with ground truth, simulated or recorded, and references for scores."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated, Any

import numpy as np

from homeward.drives.drive import Drive, HomeBearing
from homeward.drives.importers.mrclam import read_mrclam
from homeward.drives.settings import Finite, NonNegative
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, compose, polar_covariance_to_pose, to_polar
from homeward.io.checks import Field
from homeward.lab.bounds import posterior_bound
from homeward.lab.simulation.scenario import Interval, Scenario
from homeward.lab.simulation.simulate import Simulation
from homeward.runs.single_run import DriveChoice, RunSettings, opened

MAX_SIGMAS = 5.0
"""Sightings with a larger error count as having a wrong id."""


@dataclass(frozen=True)
class Trial:
    """A drive with ground truth and references for scores."""

    drive: Drive
    moved: frozenset[str]
    """Landmarks that have moved since home was stored, at the end of the drive."""
    stamps: np.ndarray
    """(n,), of the bearings [s]."""
    bound: np.ndarray
    """(n, 3, 3), posterior Cramer-Rao bound of (x [m], y [m], heading [rad]) from all sightings up
    to the stamp; infinite where unknown."""
    none_else: bool = True
    """Whether `moved` is complete."""
    true_home: dict[str, float] = field(default_factory=dict)
    """True home bearings of all landmarks, in the robot's home frame [rad]."""
    final_distance: float = math.nan
    """True distance from home at the end [m]."""


def unknown_bound(drive: Drive) -> tuple[np.ndarray, np.ndarray]:
    """Return the bearing stamps of a drive, (n,) [s], and a bound of infinity, (n, 3, 3)."""
    stamps = np.unique(drive.sightings.t)
    return stamps, np.full((stamps.size, 3, 3), np.inf)


def drive_bound(
    drive: Drive,
    case: Scenario,
    marks: np.ndarray,
    column: np.ndarray,
    moved: np.ndarray,
    *,
    carried: np.ndarray | None = None,
    start_covariance: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the bearing stamps of a simulated drive, (n,) [s], and the bound there, (n, 3, 3).

    The bound assumes known camera extrinsics and noise, known moved landmarks and wrong ids, and no
    constant errors of the odometry. It is infinite where unknown: without noise, or with another
    camera at home.

    `marks` (m, 2) are true positions in the home frame [m], with two rows for a landmark that moves
    during the drive; `column` is the row of each sighting; `moved` (m,) are those that moved since
    home was stored. `carried` (n - 1,) are the steps between stamps in which the robot is carried.
    """
    noise, seen, truth = case.noise, drive.sightings, drive.truth
    same_camera = case.home_sensor is None or case.home_sensor == case.sensor
    if truth is None or not (same_camera and noise.bearing_sigma > 0 and noise.home_sigma > 0):
        return unknown_bound(drive)
    stamps = np.unique(seen.t)
    if not stamps.size:
        return unknown_bound(drive)
    poses, row = np.stack(truth.at(stamps), axis=1), np.searchsorted(stamps, seen.t)
    camera = compose(Pose(*poses[row].T), case.sensor.pose)
    error = wrap(seen.bearing - bearing(camera, *marks[column].T))
    right = np.abs(error) < MAX_SIGMAS * noise.bearing_sigma
    visible = np.zeros((stamps.size, len(marks)), bool)
    visible[row[right], column[right]] = True
    dt, step = np.diff(stamps), np.diff(poses, axis=0)
    turn = wrap(step[:, 2])
    arc = np.hypot(step[:, 0], step[:, 1]) / np.sinc(turn / 2 / np.pi)
    return stamps, posterior_bound(
        poses,
        np.stack([arc / dt, turn / dt], axis=1),
        dt,
        marks,
        visible,
        bearing_sigma=noise.bearing_sigma,
        home_sigma=noise.home_sigma,
        speed_sigma=case.odometry.speed_sigma,
        turn_sigma=case.odometry.turn_sigma,
        sideways_sigma=drive.settings.odometry.sideways_sigma,
        moved=moved,
        mount=case.sensor.pose,
        carried=carried,
        start_covariance=start_covariance,
    )


def _start_covariance(case: Scenario) -> np.ndarray | None:
    """Return the covariance of the start prior, (x, y, heading); None where there is none."""
    if not case.start.prior:
        return None
    start = to_polar(case.start.in_home_frame(case.home.pose))
    return polar_covariance_to_pose(start, np.diag(case.start.sigmas**2))


def simulated_trial(simulation: Simulation) -> Trial:
    """Return the trial of a simulation."""
    drive, world, case = simulation.drive, simulation.world, simulation.scenario
    ids, marks = list(world.ids), world.in_home_frame
    column = np.array([ids.index(name) for name in drive.sightings.landmark], int)
    moved = np.array([i in world.moved or i not in drive.home for i in ids])
    stamps, bound = drive_bound(
        drive, case, marks, column, moved, start_covariance=_start_covariance(case)
    )
    true_home = dict(zip(ids, np.arctan2(*marks.T[::-1]).tolist(), strict=True))
    final = simulation.final_distance
    return Trial(drive, frozenset(world.moved), stamps, bound, True, true_home, final)


class Recording(DriveChoice):
    """A recorded drive with ground truth; random modifications depend on the seed of each run.

    Its path may be relative to the study's file.
    """

    robot: int | None = None
    """For an MRCLAM folder: number of the robot."""
    home: tuple[Finite, Finite, Finite] | None = None
    """For an MRCLAM folder: x [m], y [m], heading [rad] of home in its map."""
    home_noise_deg: NonNegative = 0.0
    """For an MRCLAM folder: standard deviation of the computed home bearings [deg]."""
    label: str | None = None
    """Its name in figures; None: the drive's."""
    falsified: Annotated[int, Field(ge=0)] = 0
    """Number of home bearings with an added error, as if landmarks had been moved."""
    fault: Interval = (0.2, 0.6)
    """Size of these errors, uniform, with random sign [rad]."""
    dropped: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of the sightings that are removed at random."""

    @property
    def random(self) -> bool:
        """Whether its runs differ."""
        return bool(self.falsified or self.dropped or self.home_noise_deg)


def recorded(recording: Recording) -> Drive:
    """Return the unmodified drive.

    Raises `InputError` when it cannot be read, has no ground truth, or fewer home bearings than
    `falsified`.
    """
    if recording.home_noise_deg and recording.robot is None:
        raise InputError(f"{recording.drive}: home_noise_deg is for MRCLAM folders")
    drive = _opened(recording.drive, recording.robot, recording.home, recording.topics)
    if drive.truth is None:
        raise InputError(f"{recording.drive}: no ground truth in the drive; a study needs it")
    if recording.falsified > (number := len(drive.home)):
        raise InputError(f"{recording.drive}: falsified must be at most {number} home bearings")
    return drive


@lru_cache(maxsize=16)
def _opened(path: str, robot: int | None, home: Any, topics: str | None) -> Drive:
    if (robot is None) != (home is None):
        raise InputError(f"{path}: give both robot and home, or neither")
    if robot is not None:
        return read_mrclam(path, robot, Pose(*home))
    return opened(RunSettings(drive=path, topics=topics))


def recorded_trial(recording: Recording, seed: int) -> Trial:
    """Return the drive of one run, with falsified home bearings as the moved landmarks.

    Other home bearings may be wrong, too, unless they were computed from a survey (MRCLAM). Each
    kind of modification has its own random numbers, so that it does not change the others.
    """
    right = recorded(recording)
    noise, faults, drops = (np.random.default_rng([seed, k]) for k in range(3))
    if sigma := math.radians(recording.home_noise_deg):
        home = {
            i: HomeBearing(float(wrap(b.bearing + noise.normal(0.0, sigma))), sigma)
            for i, b in right.home.items()
        }
        right = dataclasses.replace(right, home=home)
    drive = falsified(right, recording.falsified, faults, recording.fault)
    drive = with_dropped(drive, recording.dropped, drops)
    assert drive.truth is not None  # checked in `recorded`
    return Trial(
        drive,
        frozenset(i for i, b in drive.home.items() if b != right.home[i]),
        *unknown_bound(drive),
        none_else=recording.robot is not None,
        true_home=right.home_bearings(),
        final_distance=math.hypot(float(drive.truth.x[-1]), float(drive.truth.y[-1])),
    )


def falsified(
    drive: Drive,
    number: int,
    draw: np.random.Generator,
    fault: tuple[float, float] = (0.2, 0.6),
) -> Drive:
    """Return a drive with errors in a number of its home bearings.

    `draw` chooses the bearings, the signs and the sizes, uniform in `fault` [rad].
    """
    chosen = set(draw.choice(sorted(drive.home), number, replace=False).tolist())
    home = {
        i: HomeBearing(
            float(wrap(b.bearing + draw.choice([-1, 1]) * draw.uniform(*fault))), b.sigma
        )
        if i in chosen
        else b
        for i, b in drive.home.items()
    }
    return dataclasses.replace(drive, home=home)


def with_dropped(drive: Drive, share: float, draw: np.random.Generator) -> Drive:
    """Return a drive without a random share of its sightings."""
    kept = draw.random(drive.sightings.t.size) >= share
    return dataclasses.replace(drive, sightings=drive.sightings.rows(kept))
