"""Run an estimator on a drive, sample by sample, and keep its estimates as a `Track`."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import repeat

import numpy as np

from homeward.drives.drive import Columns, Drive
from homeward.drives.robot import require_one_camera
from homeward.errors import Attempts, InputError, InternalFailure, failure_notes, require_kind
from homeward.estimator import (
    Counts,
    Estimate,
    Estimator,
    Innovation,
    LandmarkEstimate,
    Status,
    UsesCameras,
    add_frame,
    add_twist,
    takes_sideways,
)
from homeward.geometry.statistics import AccuracyLimit, PoseAccuracy
from homeward.io.blas_threads import single_threaded_blas
from homeward.io.naming import natural
from homeward.reasons import Reason
from homeward.sighting_keys import is_unlabelled

GRID_S = 0.1
"""Interval of the estimates between bearing stamps [s]."""
MIN_GRID_DISTANCE_S = 1e-3
"""A grid point closer to a bearing stamp than this is left out [s]."""
MAX_SPAN_S = 7 * 86400.0
"""A drive that is longer has a wrong stamp [s]."""
PROGRESS_S = 0.05
"""Minimum interval between progress reports [s of wall time]."""
STRAFES = "the robot moves sideways, but the estimator {} takes no sideways speed; robust takes it"
SIDEWAYS_IGNORED = (
    "The sideways speed was ignored: the estimator {} takes none. It is at most 2 % of the forward "
    "speed, averaged over 10 s."
)
HISTORY_S, MAX_HISTORY = 1.0, 2000
"""Interval at which landmark estimates are kept [s], and their maximum number in a long drive."""


@dataclass(frozen=True)
class Innovations(Columns):
    """The innovations of a whole track, one entry a sighting. All arrays have shape (m,)."""

    t: np.ndarray
    """Stamps [s]."""
    landmark: np.ndarray
    """Ids (str)."""
    value: np.ndarray
    """Measured minus predicted bearing [rad]."""
    sigma: np.ndarray
    """Its predicted standard deviation [rad]."""
    accepted: np.ndarray
    """bool; False when a gate rejected the sighting."""

    def by_landmark(self) -> dict[str, np.ndarray]:
        """Return the entries of each landmark, in order of time."""
        ids, number = np.unique(self.landmark, return_inverse=True)
        order = np.argsort(number, kind="stable")
        parts = np.split(order, np.cumsum(np.bincount(number))[:-1])
        return {str(i): part for i, part in zip(ids, parts, strict=False)}


@dataclass(frozen=True)
class LandmarkHistory:
    """Landmark estimates during a drive: k times, q landmarks, NaN where unknown."""

    t: np.ndarray = field(default_factory=lambda: np.empty(0))
    """(k,), strictly increasing [s]; each row is causal."""
    landmark: tuple[str, ...] = ()
    """Ids of the q landmarks."""
    x: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    """(k, q), in the home frame [m]."""
    y: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    """(k, q), in the home frame [m]."""
    moved_probability: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    """(k, q), probability that the landmark has moved since home was stored."""

    def at(self, t: np.ndarray) -> np.ndarray:
        """Return the last row not after each time `t` [s], shape (m,); -1 before the first."""
        return np.asarray(np.searchsorted(self.t, t, side="right") - 1)


@dataclass(frozen=True)
class Track:
    """The estimates of one drive; arrays of n rows, NaN without a pose.

    There is a row for each bearing stamp, and for each point of a 10 Hz grid between them.
    """

    estimator: str
    """Name of the estimator."""
    t: np.ndarray
    """(n,), strictly increasing [s]."""
    x: np.ndarray
    """(n,), in the home frame [m]."""
    y: np.ndarray
    """(n,), in the home frame [m]."""
    heading: np.ndarray
    """(n,), in the home frame [rad]."""
    covariance: np.ndarray
    """(n, 3, 3), of (x [m], y [m], heading [rad])."""
    status: list[Status]
    reason: list[str]
    innovations: Innovations
    update_seconds: np.ndarray
    """Wall time of each call of `bearings` [s], one per bearing stamp."""
    run_seconds: float
    """Wall time of the whole run [s]."""
    landmarks: list[LandmarkEstimate]
    counts: Counts
    notes: tuple[str, ...]
    history: LandmarkHistory = field(default_factory=LandmarkHistory)
    """Landmark estimates, about every second."""
    failures: tuple[InternalFailure, ...] = ()
    """Exceptions of the estimator; `notes` has one on them."""

    @property
    def has_pose(self) -> np.ndarray:
        """Which rows have a pose, shape (n,), bool."""
        return np.asarray(np.isfinite(self.x))

    @property
    def R(self) -> np.ndarray:
        """Distance from home [m], shape (n,)."""
        return np.asarray(np.hypot(self.x, self.y))

    @property
    def theta(self) -> np.ndarray:
        """Direction of the robot seen from home [rad], shape (n,)."""
        return np.asarray(np.arctan2(self.y, self.x))

    def accurate(self, largest_sigma: float) -> np.ndarray:
        """Return which rows have a pose within an `AccuracyLimit` [m], shape (n,), bool."""
        limit = AccuracyLimit(largest_sigma)
        sigmas = PoseAccuracy.of(self.covariance).position.tolist()
        return np.array([limit.is_met(sigma) for sigma in sigmas], bool)

    @property
    def sigmas(self) -> np.ndarray:
        """Standard deviations of (x [m], y [m], heading [rad]), shape (n, 3)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))


@single_threaded_blas()
def run(
    drive: Drive,
    estimator: Estimator,
    progress: Callable[[float], None] | None = None,
    on_estimate: Callable[[Estimate], object] | None = None,
) -> Track:
    """Feed a drive to an estimator as if it were online, and return its estimates.

    Samples are fed in order of time, odometry before bearings of the same stamp. The estimate at a
    grid point is computed before any later sample is fed, so every row is causal.

    An exception of the estimator does not end the run: it is kept in `Track.failures`, and given as
    an `InternalErrorWarning`. The estimator begins again without a map; one that cannot gives no
    estimates from then on.

    Parameters
    ----------
    drive : Drive
        The recorded drive.
    estimator : Estimator
        A new estimator; it cannot be used for another run.
    progress : callable, optional
        Receives the fraction done, in [0, 1], at most about 20 times a second.
    on_estimate : callable, optional
        Receives each estimate before later samples are fed.

    Raises
    ------
    InputError
        When the stamps of the drive span more than a week: one of them must be wrong. When the
        robot moves sideways, or sightings have no ids, and the estimator takes no such samples.
    """
    require_kind(drive, Drive, "read one with open_drive(PATH)")
    if isinstance(estimator, str):
        advice = f"make one with make_estimator({estimator!r}, drive)"
        raise InputError("an estimator is needed, not its name", advice=advice)
    ignored = sideways_notes(drive, estimator)
    require_ids(drive, estimator)
    began = time.perf_counter()
    stamps = np.unique(drive.sightings.t)
    grid = grid_times(drive.span, stamps)
    order = in_order(drive.odometry.t, stamps, grid)
    rows, attempts = _TrackRows(stamps.size + grid.size), Attempts(estimator)
    every = max(HISTORY_S, (drive.span[1] - drive.span[0]) / MAX_HISTORY)
    update_seconds: list[float] = []

    odometry = zip(
        drive.odometry.t.tolist(),
        drive.odometry.v.tolist(),
        drive.odometry.omega.tolist(),
        drive.odometry.vy.tolist(),
        strict=True,
    )
    sightings, has_ranges = drive.sightings.stamps(), np.isfinite(drive.sightings.range).any()
    ranges = drive.sightings.ranges() if has_ranges else repeat((None, None))
    begins = drive.sightings.t[drive.sightings.begins]
    frames = iter(np.unique(begins, return_counts=True)[1].tolist())
    names = drive.sightings.cameras() if drive.settings.cameras else repeat("")
    if drive.settings.cameras and not isinstance(estimator, UsesCameras):
        name = estimator.name
        require_one_camera(drive, f"the estimator {name} takes one camera; robust takes several")
    grid_points = iter(grid.tolist())
    reported = began
    for done, kind in enumerate(order):
        if kind == ODOMETRY:
            twist = next(odometry)
            attempts.attempt(twist[0], None, add_twist, estimator, *twist)
        elif kind == BEARINGS:
            start = time.perf_counter()
            innovations: tuple[Innovation, ...] = ()
            for _ in range(next(frames)):  # one of each camera
                t, seen, sigmas = next(sightings)
                sample = t, seen, sigmas or None, *next(ranges), next(names)
                estimate = attempts.attempt(t, _failed(t), add_frame, estimator, *sample)
                innovations = (*innovations, *estimate.innovations)
            update_seconds.append(time.perf_counter() - start)
            if len(innovations) > len(estimate.innovations):
                estimate = dataclasses.replace(estimate, innovations=innovations)
        else:
            t = next(grid_points)
            estimate = attempts.attempt(t, _failed(t), estimator.estimate, t)
        if kind != ODOMETRY:
            rows.keep(t, estimate)
            if on_estimate is not None:
                on_estimate(estimate)
            rows.keep_landmarks(t, attempts, estimator, every)
        if progress is not None and time.perf_counter() - reported > PROGRESS_S:
            reported = time.perf_counter()
            progress(done / len(order))
    if progress is not None:
        progress(1.0)
    seconds = np.array(update_seconds), time.perf_counter() - began
    track = rows.track(attempts, estimator, *seconds)
    return dataclasses.replace(track, notes=(*track.notes, *ignored)) if ignored else track


def require_ids(drive: Drive, estimator: Estimator) -> None:
    """Raise `InputError` if a drive has sightings without ids, and the estimator needs ids."""
    if getattr(estimator, "uses_unlabelled", False):
        return
    if any(map(is_unlabelled, {*map(str, drive.sightings.landmark), *drive.home})):
        raise InputError(
            f"the estimator {estimator.name} needs an id for each landmark; robust does not"
        )


def sideways_notes(drive: Drive, estimator: Estimator) -> tuple[str, ...]:
    """Return a note for the user if an estimator ignores the sideways speed of a drive.

    `InputError` if the robot strafes: then its poses would be wrong.
    """
    if takes_sideways(estimator) or not drive.odometry.moves_sideways:
        return ()
    if drive.odometry.strafes:
        raise InputError(STRAFES.format(estimator.name))
    return (SIDEWAYS_IGNORED.format(estimator.name),)


def _failed(t: float) -> Estimate:
    """Return the estimate at `t` [s] of an estimator that failed."""
    return Estimate(t, Status.WAITING, Reason.FAILED.words)


def track_of(estimator: Estimator, estimates: Sequence[Estimate]) -> Track:
    """Return the track of the estimates that an estimator gave during a drive, in order of time."""
    rows = _TrackRows(len(estimates))
    for estimate in estimates:
        rows.keep(estimate.t, estimate)
    return rows.track(Attempts(estimator), estimator, np.empty(0), 0.0)


ODOMETRY, BEARINGS, GRID = 0, 1, 2
"""The steps of a run, in their order at equal times."""


def grid_times(span: tuple[float, float], stamps: np.ndarray) -> np.ndarray:
    """Return the grid times [s] of a drive between its bearing stamps; errors as `run`."""
    first, last = span
    if np.isnan(first):
        return np.empty(0)
    if last - first > MAX_SPAN_S:
        raise InputError(
            f"the stamps run from {first!r} to {last!r} s, which is "
            f"{(last - first) / 86400:.0f} days: one of them is wrong, or they are not in seconds"
        )
    grid = first + GRID_S * np.arange(int(np.floor((last - first) / GRID_S + 1e-9)) + 1)
    if not stamps.size:
        return grid
    after = np.searchsorted(stamps, grid)
    gap_after = stamps[np.minimum(after, stamps.size - 1)] - grid
    gap_before = grid - stamps[np.maximum(after - 1, 0)]
    return np.asarray(grid[np.minimum(np.abs(gap_after), np.abs(gap_before)) > MIN_GRID_DISTANCE_S])


def in_order(odometry: np.ndarray, stamps: np.ndarray, grid: np.ndarray) -> list[int]:
    """Return the steps `ODOMETRY`, `BEARINGS` and `GRID` in order of time."""
    times = np.concatenate([odometry, stamps, grid])
    kinds = np.repeat([ODOMETRY, BEARINGS, GRID], [odometry.size, stamps.size, grid.size])
    return [int(k) for k in kinds[np.lexsort((kinds, times))]]


class _TrackRows:
    """A track that is filled row by row."""

    def __init__(self, number: int) -> None:
        self.filled = 0
        self.t = np.full(number, np.nan)
        self.pose = np.full((number, 3), np.nan)
        self.covariance = np.full((number, 3, 3), np.nan)
        self.status: list[Status] = []
        self.reason: list[str] = []
        self.innovations: list[tuple[float, str, float, float, bool]] = []
        self.known: list[tuple[float, list[LandmarkEstimate]]] = []

    def keep(self, t: float, estimate: Estimate) -> None:
        """Keep an estimate as the next row."""
        row = self.filled
        self.t[row] = t
        if estimate.pose is not None:
            self.pose[row] = estimate.pose
            self.covariance[row] = estimate.covariance
        self.status.append(estimate.status)
        self.reason.append(estimate.reason)
        self.innovations.extend(
            (t, i.landmark, i.value, i.sigma, i.accepted) for i in estimate.innovations
        )
        self.filled += 1

    def keep_landmarks(
        self, t: float, attempts: Attempts, estimator: Estimator, every: float
    ) -> None:
        """Keep the landmark estimates at `t` [s], at most once in `every` [s]."""
        if not self.known or t - self.known[-1][0] >= every:
            self.known.append((t, attempts.attempt(t, [], estimator.landmarks)))

    def history(self) -> LandmarkHistory:
        """Return the landmark estimates during the drive."""
        names = sorted({m.landmark for _, landmarks in self.known for m in landmarks}, key=natural)
        column = {name: i for i, name in enumerate(names)}
        values = np.full((3, len(self.known), len(names)), np.nan)
        for row, (_, landmarks) in enumerate(self.known):
            for m in landmarks:
                values[:, row, column[m.landmark]] = m.x, m.y, m.moved_probability
        return LandmarkHistory(np.array([t for t, _ in self.known]), tuple(names), *values)

    def track(
        self,
        attempts: Attempts,
        estimator: Estimator,
        update_seconds: np.ndarray,
        run_seconds: float,
    ) -> Track:
        """Return the finished track."""
        end = float(self.t[self.filled - 1]) if self.filled else 0.0
        nothing, silence = list[LandmarkEstimate](), tuple[str, ...]()
        landmarks = attempts.attempt(end, nothing, estimator.landmarks)
        notes = attempts.attempt(end, silence, lambda: estimator.notes)
        failures = tuple(attempts.failures)
        t, landmark, value, sigma, accepted = (
            zip(*self.innovations, strict=True) if self.innovations else ((),) * 5
        )
        return Track(
            estimator=estimator.name,
            t=self.t,
            x=self.pose[:, 0],
            y=self.pose[:, 1],
            heading=self.pose[:, 2],
            covariance=self.covariance,
            status=self.status,
            reason=self.reason,
            innovations=Innovations(
                t=np.array(t, float),
                landmark=np.array(landmark, str),
                value=np.array(value, float),
                sigma=np.array(sigma, float),
                accepted=np.array(accepted, bool),
            ),
            update_seconds=update_seconds,
            run_seconds=run_seconds,
            landmarks=landmarks,
            counts=estimator.counts,
            notes=(*failure_notes(failures), *notes),
            history=self.history(),
            failures=failures,
        )
