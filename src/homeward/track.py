"""The run: a drive fed to an estimator sample by sample, and the track that comes out."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from homeward.drives.drive import Drive
from homeward.errors import InputError
from homeward.estimator import Counts, Estimate, Estimator, LandmarkEstimate, Status
from homeward.io.naming import natural
from homeward.io.one_thread import one_thread

GRID_S = 0.1
"""Between bearing stamps an estimate is kept this often [s]."""
CLASH_S = 1e-3
"""A grid point this near to a bearing stamp is left out [s]."""
LONGEST_S = 7 * 86400.0
"""A drive that spans more than this holds a wrong stamp [s]."""
PROGRESS_S = 0.05
"""Progress is told at most this often [s of wall time]."""
REMEMBER_S, MOST_REMEMBERED = 1.0, 2000
"""What is known of the landmarks is kept so often [s], of a long drive at most so many times."""


@dataclass(frozen=True)
class Innovations:
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
    """What was known of the landmarks along the way: k times, q landmarks, NaN where unknown."""

    t: np.ndarray = field(default_factory=lambda: np.empty(0))
    """(k,), strictly increasing [s]; each row is as causal as the track."""
    landmark: tuple[str, ...] = ()
    """Ids of the q landmarks."""
    x: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    """(k, q), in the home frame [m]."""
    y: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    """(k, q), in the home frame [m]."""
    moved_probability: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    """(k, q), that it stands elsewhere than when home was stored."""

    def at(self, t: np.ndarray) -> np.ndarray:
        """Return the last row not after each time `t` [s], shape (m,); -1 before the first."""
        return np.asarray(np.searchsorted(self.t, t, side="right") - 1)


@dataclass(frozen=True)
class Track:
    """Everything that an estimator answered on one drive; arrays of n rows, NaN without a pose.

    A row per bearing stamp, and per point of a 10 Hz grid between them.
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
    """Of the landmarks, about every second."""

    @property
    def has_pose(self) -> np.ndarray:
        """Which rows hold a pose, shape (n,), bool."""
        return np.asarray(np.isfinite(self.x))

    @property
    def R(self) -> np.ndarray:
        """Distance from home [m], shape (n,)."""
        return np.asarray(np.hypot(self.x, self.y))

    @property
    def theta(self) -> np.ndarray:
        """Direction of the robot seen from home [rad], shape (n,)."""
        return np.asarray(np.arctan2(self.y, self.x))

    @property
    def sigmas(self) -> np.ndarray:
        """Standard deviations of (x [m], y [m], heading [rad]), shape (n, 3)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))


@one_thread()
def run(
    drive: Drive, estimator: Estimator, progress: Callable[[float], None] | None = None
) -> Track:
    """Feed a drive to an estimator exactly as if it were online, and keep what it answers.

    Samples go in by time, odometry before bearings of the same stamp. The answer at a grid point
    is asked for before any later sample is fed, so that every row is causal.

    Parameters
    ----------
    drive : Drive
        What to feed.
    estimator : Estimator
        A fresh one; it is used up.
    progress : callable, optional
        Told the fraction done, in [0, 1], at most about 20 times a second.

    Raises
    ------
    InputError
        When the stamps of the drive span more than a week: one of them must be wrong.
    """
    began = time.perf_counter()
    stamps = np.unique(drive.sightings.t)
    grid = grid_times(drive.span, stamps)
    order = in_order(drive.odometry.t, stamps, grid)
    rows = _TrackRows(stamps.size + grid.size)
    every = max(REMEMBER_S, (drive.span[1] - drive.span[0]) / MOST_REMEMBERED)
    update_seconds: list[float] = []

    odometry = zip(
        drive.odometry.t.tolist(),
        drive.odometry.v.tolist(),
        drive.odometry.omega.tolist(),
        strict=True,
    )
    sightings = drive.sightings.stamps()
    grid_points = iter(grid.tolist())
    told = began
    for done, kind in enumerate(order):
        if kind == ODOMETRY:
            estimator.odometry(*next(odometry))
        elif kind == BEARINGS:
            t, seen, sigmas = next(sightings)
            start = time.perf_counter()
            estimate = estimator.bearings(t, seen, sigmas or None)
            update_seconds.append(time.perf_counter() - start)
            rows.keep(t, estimate)
        else:
            t = next(grid_points)
            rows.keep(t, estimator.estimate(t))
        if kind != ODOMETRY:
            rows.remember(t, estimator, every)
        if progress is not None and time.perf_counter() - told > PROGRESS_S:
            told = time.perf_counter()
            progress(done / len(order))
    if progress is not None:
        progress(1.0)
    return rows.track(estimator, np.array(update_seconds), time.perf_counter() - began)


def track_of(estimator: Estimator, answers: Sequence[Estimate]) -> Track:
    """Return the track of answers that an estimator has given already, in order of time.

    Parameters
    ----------
    estimator : Estimator
        After its drive.
    answers : sequence of Estimate
        At increasing times.
    """
    rows = _TrackRows(len(answers))
    for answer in answers:
        rows.keep(answer.t, answer)
    return rows.track(estimator, np.empty(0), 0.0)


ODOMETRY, BEARINGS, GRID = 0, 1, 2
"""What to do next, in the order in which it is done at equal times."""


def grid_times(span: tuple[float, float], stamps: np.ndarray) -> np.ndarray:
    """Return the grid times [s] of a drive that do not clash with its bearing stamps.

    Raises
    ------
    InputError
        As `run`.
    """
    first, last = span
    if np.isnan(first):
        return np.empty(0)
    if last - first > LONGEST_S:
        raise InputError(
            f"the stamps run from {first!r} to {last!r} s, which is "
            f"{(last - first) / 86400:.0f} days: one of them is wrong, or their unit is not the "
            "second"
        )
    grid = first + GRID_S * np.arange(int(np.floor((last - first) / GRID_S + 1e-9)) + 1)
    if not stamps.size:
        return grid
    after = np.searchsorted(stamps, grid)
    gap_after = stamps[np.minimum(after, stamps.size - 1)] - grid
    gap_before = grid - stamps[np.maximum(after - 1, 0)]
    return np.asarray(grid[np.minimum(np.abs(gap_after), np.abs(gap_before)) > CLASH_S])


def in_order(odometry: np.ndarray, stamps: np.ndarray, grid: np.ndarray) -> list[int]:
    """Return what to do, `ODOMETRY`, `BEARINGS` or `GRID`, in order of time."""
    times = np.concatenate([odometry, stamps, grid])
    kinds = np.repeat([ODOMETRY, BEARINGS, GRID], [odometry.size, stamps.size, grid.size])
    return [int(k) for k in kinds[np.lexsort((kinds, times))]]


class _TrackRows:
    """A track that is being filled, row by row."""

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

    def remember(self, t: float, estimator: Estimator, every: float) -> None:
        """Keep what is known of the landmarks at `t` [s], unless that was done lately."""
        if not self.known or t - self.known[-1][0] >= every:
            self.known.append((t, estimator.landmarks()))

    def history(self) -> LandmarkHistory:
        """Return what was known of the landmarks along the way."""
        names = sorted({m.landmark for _, landmarks in self.known for m in landmarks}, key=natural)
        column = {name: i for i, name in enumerate(names)}
        values = np.full((3, len(self.known), len(names)), np.nan)
        for row, (_, landmarks) in enumerate(self.known):
            for m in landmarks:
                values[:, row, column[m.landmark]] = m.x, m.y, m.moved_probability
        return LandmarkHistory(np.array([t for t, _ in self.known]), tuple(names), *values)

    def track(self, estimator: Estimator, update_seconds: np.ndarray, run_seconds: float) -> Track:
        """Return the finished track."""
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
            landmarks=estimator.landmarks(),
            counts=estimator.counts,
            notes=estimator.notes,
            history=self.history(),
        )
