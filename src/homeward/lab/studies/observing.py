"""Observability of home and landmarks in the windows of a real drive.

Empirical observability Gramian: the information of all bearings of a window, and of the home
bearings, on home's pose and the landmarks, at the true (or best known) path, whose shape counts as
exact. It is a limit from geometry only; `homeward.lab.bounds` includes the errors of odometry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from homeward.drives.drive import Drive
from homeward.errors import HomewardError, InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, between, compose
from homeward.geometry.se2 import lever
from homeward.io.naming import natural
from homeward.lab.model import POLAR
from homeward.lab.observability.ranks import rank
from homeward.lab.observability.scene import Scene
from homeward.lab.observability.words import in_words
from homeward.localizer.map.triangulation import triangulate
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.smoothing import smooth

WINDOW_S = 30.0
OVERLAP = 2
"""A new window begins after the inverse of this part of one."""
MAX_WINDOWS = 5000
MOVED = 0.1
"""Landmarks whose home bearing has a larger error [rad] count as moved."""
NEAR_FAMILY = 0.15
"""Maximum distance of the weakest direction from a named family (sine of the angle)."""


@dataclass(frozen=True)
class Window:
    """Observability in a window of the drive."""

    begin: float
    """From the start of the drive [s]."""
    end: float
    sightings: int
    """Sightings of landmarks with a home bearing."""
    landmarks: tuple[str, ...]
    """Landmarks in view that have a home bearing."""
    rank: int
    unknowns: int
    """3 + 2 q"""
    covariance: np.ndarray
    """(3, 3), of the pose of the camera at the end of the window relative to home, x [m], y [m],
    heading [rad]; infinite where it is not observable."""
    weakest: tuple[str, ...]
    """Description of the unobservable directions, or of home's least observable one."""

    @property
    def position_sigma(self) -> float:
        """Lower bound on the position error [m], RMS; infinite where it is not observable."""
        return float(np.sqrt(self.covariance[0, 0] + self.covariance[1, 1]))

    @property
    def heading_sigma(self) -> float:
        """Lower bound on the heading error [rad], RMS."""
        return float(np.sqrt(self.covariance[2, 2]))


@dataclass(frozen=True)
class DriveView:
    """Observability in all windows of a drive."""

    name: str
    path_from: str
    """Source of the path, as text."""
    bearing_sigma: float
    """[rad], a default where the drive has none."""
    home_sigma: float
    """[rad]"""
    t: np.ndarray
    """(n,), bearing stamps from the start of the drive [s]."""
    poses: np.ndarray
    """(n, 3), of the camera from the camera at home: x [m], y [m], heading [rad]."""
    names: tuple[str, ...]
    places: np.ndarray
    """(q, 2), landmark positions from the camera at home [m]."""
    stored: np.ndarray
    """(q,), bool, whether the home bearing agrees with the position."""
    unplaced: tuple[str, ...]
    """Landmarks with too few sightings or too little parallax for a position; not used."""
    windows: tuple[Window, ...]
    whole: Window
    """One window with all bearings."""


def check_window(drive: Drive, window: float) -> None:
    """Raise InputError for a drive without sightings, or windows that are too short."""
    if not 0 < window < np.inf:
        raise InputError(f"the window must be a positive number of seconds, not {window:g}")
    if not drive.sightings.t.size:
        raise InputError(f"{drive.name}: no sightings in the drive")
    if (span := float(np.ptp(drive.sightings.t))) > window / OVERLAP * MAX_WINDOWS:
        shortest = OVERLAP * span / MAX_WINDOWS
        raise InputError(f"windows of {window:g} s are too many; use at least {shortest:.2g} s")


def observe_drive(
    drive: Drive, window: float = WINDOW_S, progress: Callable[[float], None] | None = None
) -> DriveView:
    """Return the observability of the pose relative to home along a drive, in windows [s].

    Windows overlap by half. Without ground truth, the path is that of the robust localiser,
    smoothed. `progress` receives the finished fraction, in [0, 1]. Errors as `check_window`;
    `HomewardError` when there is neither ground truth nor a pose, or no landmark has a position.
    """
    check_window(drive, window)
    rows, poses, path_from = _path(drive)
    seen = _Seen(drive, rows, poses)
    step = window / OVERLAP
    begins = np.arange(0.0, max(seen.t[-1] - window + step, 1e-9), step)
    windows = []
    for k, begin in enumerate(begins):
        windows.append(seen.window(float(begin), min(float(begin) + window, float(seen.t[-1]))))
        if progress is not None:
            progress((k + 1) / begins.size)
    whole = seen.window(0.0, float(seen.t[-1]))
    path = seen.sigma, seen.home_sigma, seen.t, seen.poses
    marks = seen.names, seen.places, seen.stored, seen.unplaced
    return DriveView(drive.name, path_from, *path, *marks, tuple(windows), whole)


def _path(drive: Drive) -> tuple[np.ndarray, Pose, str]:
    """Return the sightings with a pose, the robot's poses there, and the source of the poses."""
    t = drive.sightings.t
    if drive.truth is not None and drive.truth.t.size:
        rows = np.flatnonzero((t >= drive.truth.t[0]) & (t <= drive.truth.t[-1]))
        if rows.size:
            return rows, drive.truth.at(t[rows]), "its ground truth"
    track = smooth(drive)
    at = np.clip(np.searchsorted(track.t, t), 0, max(track.t.size - 1, 0))
    rows = np.flatnonzero(track.has_pose[at] & (track.t[at] == t))
    if not rows.size:
        raise HomewardError(
            f"{drive.name}: no ground truth, and the robust localiser found no pose"
        )
    at = at[rows]
    return rows, Pose(track.x[at], track.y[at], track.heading[at]), "the robust localiser, smoothed"


class _Seen:
    """Sightings of a drive with their poses."""

    def __init__(self, drive: Drive, rows: np.ndarray, robot: Pose) -> None:
        defaults, sensor = LocalizerSettings(), drive.settings.sensor
        self.sigma = sensor.bearing_sigma or defaults.bearing_sigma
        given = [b.sigma for b in drive.home.values() if np.isfinite(b.sigma)]
        self.home_sigma = float(np.median(given)) if given else self.sigma
        camera = between(drive.settings.home_mount.pose, compose(robot, sensor.pose))
        every = np.stack([camera.x, camera.y, camera.heading], axis=1)
        stamps = drive.sightings.t[rows]
        self.t, at = np.unique(stamps - stamps[0], return_inverse=True)
        self.poses = np.zeros((self.t.size, POLAR))
        self.poses[at] = every
        ids = drive.sightings.landmark[rows]
        self._place(drive, ids, every, drive.sightings.bearing[rows], defaults.parallax)
        self.visible = np.zeros((self.t.size, len(self.names)), bool)
        column = {name: i for i, name in enumerate(self.names)}
        kept = np.array([name in column for name in ids], bool)
        self.visible[at[kept], [column[name] for name in ids[kept]]] = True

    def _place(
        self,
        drive: Drive,
        ids: np.ndarray,
        cameras: np.ndarray,
        bearings: np.ndarray,
        parallax: float,
    ) -> None:
        """Triangulate the landmarks, and compare them with the home bearings."""
        names, places, stored, unplaced = [], [], [], []
        for name in sorted(set(ids.tolist()), key=natural):
            mine = ids == name
            sigmas = np.full(int(mine.sum()), self.sigma)
            found = triangulate(cameras[mine], bearings[mine], sigmas, parallax)
            if found is None:
                unplaced.append(str(name))
                continue
            names.append(str(name))
            places.append(found[0])
            at_home = drive.home.get(str(name))
            error = np.inf
            if at_home is not None:
                error = abs(wrap(at_home.bearing - bearing(Pose(0.0, 0.0, 0.0), *found[0])))
            stored.append(error < MOVED)
        if not names:
            raise HomewardError(f"{drive.name}: no landmark has enough parallax for a position")
        self.names, self.unplaced = tuple(names), tuple(unplaced)
        self.places, self.stored = np.array(places), np.array(stored, bool)

    def window(self, begin: float, end: float) -> Window:
        """Return the observability in a window."""
        rows = np.flatnonzero((self.t >= begin) & (self.t <= end))
        which = np.flatnonzero(self.visible[rows].any(axis=0) & self.stored)
        rows = rows[self.visible[np.ix_(rows, which)].any(axis=1)]
        names = tuple(self.names[i] for i in which)
        visible = self.visible[np.ix_(rows, which)]
        if not rows.size:
            unknown, words = (
                np.full((3, 3), np.inf),
                ("no landmark with a home bearing was in view",),
            )
            return Window(begin, end, 0, names, 0, POLAR, unknown, words)
        stored, home = np.ones(which.size, bool), np.zeros(POLAR)
        places = home, self.places[which], self.poses[rows]
        scene = Scene(names, *places, visible, stored, axis="home's x-axis")
        sigmas = np.repeat([self.sigma, self.home_sigma], [visible.sum(), which.size])
        found = rank(scene.jacobian() / sigmas[:, None], scene.worth)
        covariance, weakest = _covariance_and_weakest(scene, found.null, sigmas)
        size, unknowns = int(visible.sum()), len(scene.truth)
        return Window(begin, end, size, names, found.value, unknowns, covariance, weakest)


def _covariance_and_weakest(
    scene: Scene, null: np.ndarray, sigmas: np.ndarray
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return the covariance of the last pose from home, and its weakest directions as text."""
    if null.shape[1] and np.abs(null[:POLAR]).max() > 1e-9 * np.abs(null).max():
        return np.full((3, 3), np.inf), tuple(f.words for f in in_words(scene, null))
    worth = scene.worth
    scaled = scene.jacobian() / sigmas[:, None] * worth
    everything = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    _, directions = np.linalg.eigh(everything[:POLAR, :POLAR])
    together = everything[:, :POLAR] @ directions[:, -1]
    words = in_words(scene, (together * worth)[:, None], NEAR_FAMILY)
    home = everything[:POLAR, :POLAR] * np.outer(worth[:POLAR], worth[:POLAR])
    by_home = -lever(scene.poses[-1])  # home is the origin
    return by_home @ home @ by_home.T, tuple(f.words for f in words)
