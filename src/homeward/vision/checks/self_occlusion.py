"""Self-occlusion: image regions that turn with the camera, such as a deck, a mast or a time stamp.

When the robot turns, static objects move in the image. Features that remain in the same position
belong to the robot, or to the image itself, and should be masked.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from homeward.geometry.angles import wrap
from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.comparison import Comparison
from homeward.vision.features.detection import Features
from homeward.vision.features.matching import match
from homeward.vision.geometry.a_contrario import assess
from homeward.vision.geometry.ransac import estimate_motion

MIN_TURN = math.radians(30.0)
"""Minimum rotation between two compared frames [rad]."""
SAME = math.radians(0.5)
"""A match that moved by less than this [rad], or less than a pixel, has turned with the camera."""
STATIC_TOLERANCE = MIN_TURN / 2
"""Maximum error of a static match's position predicted from the rotation [rad]."""
FRAMES = 6
"""Number of earlier frames that a frame is compared with: odometry errors grow with more."""
MIN_MATCHES, MIN_SHARE = 5, 0.01
"""Minimum number of matches that turn with the camera, and minimum share of static matches.
Rendered rooms without a robot had none among 30,000, with thin legs 2 % and more."""
MIN_STATIC = 0.1
"""Minimum ratio of static matches to matches that turn with the camera: with fewer, the robot is
stuck, and odometry is wrong."""


@dataclass(frozen=True)
class SelfOcclusion:
    """Matches that turn with the camera."""

    matches: int
    """Number of matches."""
    lowest: float
    """5th percentile of their elevation [rad]."""
    highest: float
    """95th percentile of their elevation [rad]."""

    @property
    def words(self) -> str:
        """Message that follows the number of matches."""
        low, high = math.floor(math.degrees(self.lowest)), math.ceil(math.degrees(self.highest))
        return (
            f"matches at elevations of {low} to {high} deg turn with the camera: they show "
            "the robot itself, or a time stamp; add a mask"
        )


class SelfOcclusionDetector:
    """Detects self-occlusion along a drive; the rotation is taken from odometry."""

    def __init__(self) -> None:
        self._before: deque[tuple[Features, float]] = deque(maxlen=FRAMES)
        """Frames `MIN_TURN` apart, and the heading of each [rad]."""
        self._elevations: list[np.ndarray] = []
        """Elevations of matches that turned with the camera [rad]."""
        self._static = 0
        """Number of static matches."""

    def see(self, view: Features, heading: float) -> None:
        """Process the features of the next frame, with the heading from odometry [rad]."""
        if self._before and abs(wrap(heading - self._before[-1][1])) < MIN_TURN:
            return
        for before, heading_then in self._before:
            turned = float(wrap(heading - heading_then))
            if abs(turned) >= MIN_TURN:
                self._compare(before, view, turned)
        self._before.append((view, heading))

    @property
    def found(self) -> SelfOcclusion | None:
        """Detected self-occlusion; None if nothing turns with the camera."""
        elevation = np.concatenate([np.empty(0), *self._elevations])
        return _significant(elevation, self._static)

    def _compare(self, before: Features, now: Features, turned: float) -> None:
        """Count the matches that turned with the camera and the static ones, after a turn [rad]."""
        i, j = match(before.descriptor, now.descriptor)[0].T
        then, here = (
            np.column_stack([view.azimuth[rows], view.elevation[rows]])
            for view, rows in ((before, i), (now, j))
        )
        pixel = 2 * math.pi / now.shape[1]
        along = _stays(then, here, max(SAME, pixel))
        off = np.abs(wrap(here - then + [turned, 0.0]))
        static = int((off < STATIC_TOLERANCE).all(axis=1).sum())
        if static < max(MIN_MATCHES, MIN_STATIC * along.sum()):
            return
        self._elevations.append(here[along, 1])
        self._static += static


def find_self_occlusion(seen: Comparison, camera: Panorama) -> SelfOcclusion | None:
    """Detect self-occlusion from the comparison of two panoramas of a camera; None if unknown.

    Without odometry, the rotation is that of the other matches, if these are accepted on their own
    and their rotation is at least `MIN_TURN`.
    """
    pairs = seen.pairs
    along = _stays(pairs.home, pairs.now, SAME)
    rest = pairs[~along]
    fit = estimate_motion(rest, np.zeros(len(rest)), camera.tilt_sigma)
    if fit is None or abs(fit.motion.alpha) < MIN_TURN or not assess(fit, rest).accepted:
        return None
    return _significant(pairs.now[along, 1], int(fit.inlier.sum()))


def _stays(then: np.ndarray, now: np.ndarray, max_angle: float) -> np.ndarray:
    """Return which directions, (n, 2), differ by at most an angle [rad]."""
    return np.asarray((np.abs(wrap(now - then)) <= max_angle).all(axis=1))


def _significant(elevation: np.ndarray, num_static: int) -> SelfOcclusion | None:
    """Return the self-occlusion of matches at elevations, (n,) [rad]; None if it may be chance."""
    if elevation.size < max(MIN_MATCHES, MIN_SHARE * num_static):
        return None
    lowest, highest = np.percentile(elevation, [5, 95])
    return SelfOcclusion(elevation.size, float(lowest), float(highest))
