"""How well a real drive determines home and landmarks, window by window of its time.

The empirical observability Gramian over the landmarks that were in sight when: the information of
all bearings of a window, and of the home bearings, on home's pose and the landmarks, at the true
(or best known) path, whose shape is taken as exact. What odometry adds in errors, the Cramer-Rao
bound counts (`homeward.lab.bounds`); the Gramian says what the places of things allow at best.
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
"""A new window begins after this part of one."""
MOST_WINDOWS = 5000
MOVED = 0.1
"""A home bearing further off than this [rad] is of a landmark that was moved since."""
LOOSELY = 0.15
"""The weakest direction is put in words when it lies so near to a family (sine of the angle)."""


@dataclass(frozen=True)
class Window:
    """What the bearings of a stretch of the drive determine."""

    begin: float
    """From the start of the drive [s]."""
    end: float
    sightings: int
    """Of landmarks that home knows."""
    landmarks: tuple[str, ...]
    """Those seen in it that home knows."""
    rank: int
    unknowns: int
    """3 + 2 q"""
    covariance: np.ndarray
    """(3, 3), of the pose of the camera at the end of the window relative to home, x [m], y [m],
    heading [rad]; infinite where it is not told."""
    weakest: tuple[str, ...]
    """In words: the unobservable directions, or else the least observable one of home."""

    @property
    def position_sigma(self) -> float:
        """Root mean square error of the position at best [m]; infinite where it is not told."""
        return float(np.sqrt(self.covariance[0, 0] + self.covariance[1, 1]))

    @property
    def heading_sigma(self) -> float:
        """The same of the heading [rad]."""
        return float(np.sqrt(self.covariance[2, 2]))


@dataclass(frozen=True)
class DriveView:
    """What the bearings of a drive determine."""

    name: str
    path_from: str
    """Where the path was taken from, in words."""
    bearing_sigma: float
    """[rad], assumed where the drive does not say."""
    home_sigma: float
    """[rad]"""
    t: np.ndarray
    """(n,), bearing stamps from the start of the drive [s]."""
    poses: np.ndarray
    """(n, 3), of the camera from the camera at home: x [m], y [m], heading [rad]."""
    names: tuple[str, ...]
    places: np.ndarray
    """(q, 2), of the landmarks, from the camera at home [m]."""
    stored: np.ndarray
    """(q,), bool, whose home bearings agree with that."""
    unplaced: tuple[str, ...]
    """Landmarks seen, but not well enough to be placed; they are left out."""
    windows: tuple[Window, ...]
    whole: Window
    """The same of all bearings at once."""


def check_window(drive: Drive, window: float) -> None:
    """Raise InputError when nothing was seen, or windows are not positive or far too short."""
    if not 0 < window < np.inf:
        raise InputError(f"the window must be a positive number of seconds, not {window:g}")
    if not drive.sightings.t.size:
        raise InputError(f"{drive.name}: nothing was seen on it")
    if (span := float(np.ptp(drive.sightings.t))) > window / OVERLAP * MOST_WINDOWS:
        least = OVERLAP * span / MOST_WINDOWS
        raise InputError(f"windows of {window:g} s are too many; of {least:.2g} s they are not")


def observe_drive(
    drive: Drive, window: float = WINDOW_S, progress: Callable[[float], None] | None = None
) -> DriveView:
    """Return what the bearings of a drive determine of the pose relative to home.

    Where the drive has no truth, its path is the robust localiser's, smoothed.

    Parameters
    ----------
    drive : Drive
        With home bearings.
    window : float
        [s]; a new one begins each half of it.
    progress : callable, optional
        Called with the fraction done, in [0, 1].

    Raises
    ------
    InputError
        As `check_window`.
    HomewardError
        When there is neither truth nor a pose, or no landmark can be placed.
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
    """Return which sightings have a pose, the robot's poses there, and where they are from."""
    t = drive.sightings.t
    if drive.truth is not None and drive.truth.t.size:
        rows = np.flatnonzero((t >= drive.truth.t[0]) & (t <= drive.truth.t[-1]))
        if rows.size:
            return rows, drive.truth.at(t[rows]), "its truth"
    track = smooth(drive)
    at = np.clip(np.searchsorted(track.t, t), 0, max(track.t.size - 1, 0))
    rows = np.flatnonzero(track.has_pose[at] & (track.t[at] == t))
    if not rows.size:
        raise HomewardError(f"{drive.name}: no truth, and the robust localiser found no pose in it")
    at = at[rows]
    return rows, Pose(track.x[at], track.y[at], track.heading[at]), "the robust localiser, smoothed"


class _Seen:
    """The sightings of a drive with the poses from which they were made."""

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
        """Place the landmarks, and compare them with what home stored."""
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
            off = np.inf
            if at_home is not None:
                off = abs(wrap(at_home.bearing - bearing(Pose(0.0, 0.0, 0.0), *found[0])))
            stored.append(off < MOVED)
        if not names:
            raise HomewardError(f"{drive.name}: no landmark was seen well enough to be placed")
        self.names, self.unplaced = tuple(names), tuple(unplaced)
        self.places, self.stored = np.array(places), np.array(stored, bool)

    def window(self, begin: float, end: float) -> Window:
        """Return what the bearings of a window determine."""
        rows = np.flatnonzero((self.t >= begin) & (self.t <= end))
        which = np.flatnonzero(self.visible[rows].any(axis=0) & self.stored)
        rows = rows[self.visible[np.ix_(rows, which)].any(axis=1)]
        names = tuple(self.names[i] for i in which)
        visible = self.visible[np.ix_(rows, which)]
        if not rows.size:
            unknown, words = np.full((3, 3), np.inf), ("nothing that home knows was seen",)
            return Window(begin, end, 0, names, 0, POLAR, unknown, words)
        stored, home = np.ones(which.size, bool), np.zeros(POLAR)
        places = home, self.places[which], self.poses[rows]
        scene = Scene(names, *places, visible, stored, axis="home's x-axis")
        sigmas = np.repeat([self.sigma, self.home_sigma], [visible.sum(), which.size])
        found = rank(scene.jacobian() / sigmas[:, None], scene.worth)
        covariance, weakest = _told(scene, found.null, sigmas)
        size, unknowns = int(visible.sum()), len(scene.truth)
        return Window(begin, end, size, names, found.value, unknowns, covariance, weakest)


def _told(scene: Scene, null: np.ndarray, sigmas: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return the covariance of the last pose from home, and the weakest of it in words."""
    if null.shape[1] and np.abs(null[:POLAR]).max() > 1e-9 * np.abs(null).max():
        return np.full((3, 3), np.inf), tuple(f.words for f in in_words(scene, null))
    worth = scene.worth
    scaled = scene.jacobian() / sigmas[:, None] * worth
    everything = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    _, directions = np.linalg.eigh(everything[:POLAR, :POLAR])
    together = everything[:, :POLAR] @ directions[:, -1]
    words = in_words(scene, (together * worth)[:, None], LOOSELY)
    home = everything[:POLAR, :POLAR] * np.outer(worth[:POLAR], worth[:POLAR])
    by_home = -lever(scene.poses[-1])  # home is the origin
    return by_home @ home @ by_home.T, tuple(f.words for f in words)
