"""Observability of home and landmarks in the windows of a real drive.

Empirical observability Gramian: the information of all bearings of a window, and of the home
bearings, on home's pose and the landmarks, at the true (or best known) path, whose shape counts as
exact. It is a limit from geometry only; `homeward.lab.bounds` includes the errors of odometry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from homeward.drives.drive import Drive, Sightings
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
    scene: Scene
    """The camera's path from the camera at home, and the landmarks; those whose home bearing agrees
    with their position are `stored`."""
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
    rows, robot, path_from = _path(drive)
    sigma = drive.settings.sensor.bearing_sigma or LocalizerSettings().bearing_sigma
    given = [b.sigma for b in drive.home.values() if np.isfinite(b.sigma)]
    sigmas = sigma, float(np.median(given)) if given else sigma
    seen = drive.sightings.rows(rows)
    t, scene, unplaced = _scene(drive, seen, robot, sigma)
    step, end = window / OVERLAP, float(t[-1])
    begins = np.arange(0.0, max(end - window + step, 1e-9), step).tolist()
    windows = []
    for k, begin in enumerate(begins):
        windows.append(_window(scene, t, sigmas, begin, min(begin + window, end)))
        if progress is not None:
            progress((k + 1) / len(begins))
    whole = _window(scene, t, sigmas, 0.0, end)
    return DriveView(drive.name, path_from, *sigmas, t, scene, unplaced, tuple(windows), whole)


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


def _scene(
    drive: Drive, seen: Sightings, robot: Pose, sigma: float
) -> tuple[np.ndarray, Scene, tuple[str, ...]]:
    """Return the stamps of sightings with a pose (n,), their scene, and landmarks left out of it.

    Landmarks are triangulated from the path, and compared with the home bearings.
    """
    camera = between(drive.settings.home_mount.pose, compose(robot, drive.settings.sensor.pose))
    cameras = np.stack(camera, axis=1)
    t, at = np.unique(seen.t - seen.t[0], return_inverse=True)
    poses = np.zeros((t.size, POLAR))
    poses[at] = cameras
    places, visible, stored, unplaced = {}, [], [], []
    for name in sorted(set(seen.landmark.tolist()), key=natural):
        mine = seen.landmark == name
        of_each = np.full(int(mine.sum()), sigma)
        parallax = LocalizerSettings().parallax
        found = triangulate(cameras[mine], seen.bearing[mine], of_each, parallax)
        if found is None:
            unplaced.append(str(name))
            continue
        places[str(name)] = found[0]
        visible.append(np.isin(np.arange(t.size), at[mine]))
        home, true = drive.home.get(str(name)), bearing(Pose(0.0, 0.0, 0.0), *found[0])
        stored.append(home is not None and abs(wrap(home.bearing - true)) < MOVED)
    if not places:
        raise HomewardError(f"{drive.name}: no landmark has enough parallax for a position")
    scene = Scene(
        tuple(places),
        np.zeros(POLAR),
        np.array([*places.values()]),
        poses,
        np.array(visible).T,
        np.array(stored, bool),
        axis="home's x-axis",
    )
    return t, scene, tuple(unplaced)


def _window(
    scene: Scene, t: np.ndarray, sigmas: tuple[float, float], begin: float, end: float
) -> Window:
    """Return the observability in a window; `sigmas` are those of bearings now and at home."""
    rows = np.flatnonzero((t >= begin) & (t <= end))
    which = np.flatnonzero(scene.visible[rows].any(axis=0) & scene.stored)
    rows = rows[scene.visible[np.ix_(rows, which)].any(axis=1)]
    if not rows.size:
        words = ("no landmark with a home bearing was in view",)
        return Window(begin, end, 0, (), 0, POLAR, np.full((3, 3), np.inf), words)
    names, visible = tuple(scene.names[i] for i in which), scene.visible[np.ix_(rows, which)]
    marks, stored = scene.landmarks[which], scene.stored[which]
    part = replace(
        scene, names=names, landmarks=marks, poses=scene.poses[rows], visible=visible, stored=stored
    )
    size = int(visible.sum())
    each = np.repeat(sigmas, [size, which.size])
    found = rank(part.jacobian() / each[:, None], part.worth)
    covariance, weakest = _covariance_and_weakest(part, found.null, each)
    unknowns = len(part.truth)
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
