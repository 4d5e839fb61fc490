"""Self-occlusion: image regions that turn with the camera, such as a deck, a mast or a time stamp.

Where the robot has turned, what stands in the room lies elsewhere in the image. What lies where it
lay before belongs to the robot, or to the image itself, and should be masked.
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

TURN = math.radians(30.0)
"""Least turn between two frames that are compared [rad]."""
SAME = math.radians(0.5)
"""A match that moved by less than this [rad], or a pixel, has turned with the camera."""
OF_THE_ROOM = TURN / 2
"""What stands in the room lies within this of where the turn takes it [rad]."""
FRAMES = 6
"""A frame is compared with so many before it: over more turns, the error of odometry adds up."""
MIN_MATCHES, MIN_SHARE = 5, 0.01
"""Least number of matches that turn with the camera, and least share of those of the room. Rendered
rooms without a robot had none among 30,000, with thin legs 2 % and more."""
MIN_OF_ROOM = 0.1
"""Matches of the room must be such a share of those that turn along: else the robot is stuck, and
odometry is wrong."""


@dataclass(frozen=True)
class SelfOcclusion:
    """Matches that turn with the camera."""

    matches: int
    """How many."""
    lowest: float
    """Their fifth percentile of elevation [rad]."""
    highest: float
    """Their 95th percentile [rad]."""

    @property
    def words(self) -> str:
        """What to do about it, in words that follow the number of matches."""
        low, high = math.floor(math.degrees(self.lowest)), math.ceil(math.degrees(self.highest))
        return (
            f"matches at elevations of {low} to {high} deg turn with the camera: they show "
            "the robot itself, or a time stamp; mask them out"
        )


class SelfOcclusionDetector:
    """Detects self-occlusion along a drive, the turn being known from odometry."""

    def __init__(self) -> None:
        self._before: deque[tuple[Features, float]] = deque(maxlen=FRAMES)
        """Frames a turn apart, and the heading of each [rad]."""
        self._elevations: list[np.ndarray] = []
        """Of what lay where it had lain [rad]."""
        self._of_room = 0
        """How many matches lay where they should."""

    def see(self, view: Features, heading: float) -> None:
        """Take the next frame.

        Parameters
        ----------
        view : Features
            Of the frame.
        heading : float
            Of the robot by odometry, from wherever it counts [rad].
        """
        if self._before and abs(wrap(heading - self._before[-1][1])) < TURN:
            return
        for before, heading_then in self._before:
            turned = float(wrap(heading - heading_then))
            if abs(turned) >= TURN:
                self._compare(before, view, turned)
        self._before.append((view, heading))

    @property
    def found(self) -> SelfOcclusion | None:
        """What was found so far; None where nothing turns with the camera."""
        elevation = np.concatenate([np.empty(0), *self._elevations])
        return _told(elevation, self._of_room)

    def _compare(self, before: Features, now: Features, turned: float) -> None:
        """Count what lies where it lay, and what lies where it should after a turn [rad]."""
        i, j = match(before.descriptor, now.descriptor)[0].T
        then, here = (
            np.column_stack([view.azimuth[rows], view.elevation[rows]])
            for view, rows in ((before, i), (now, j))
        )
        pixel = 2 * math.pi / now.shape[1]
        along = _stays(then, here, max(SAME, pixel))
        off = np.abs(wrap(here - then + [turned, 0.0]))
        of_room = int((off < OF_THE_ROOM).all(axis=1).sum())
        if of_room < max(MIN_MATCHES, MIN_OF_ROOM * along.sum()):
            return
        self._elevations.append(here[along, 1])
        self._of_room += of_room


def find_self_occlusion(seen: Comparison, camera: Panorama) -> SelfOcclusion | None:
    """Detect self-occlusion by two panoramas alone; None where nothing is known of it.

    Without odometry, the turn is that of the other matches, where these suffice to be accepted by
    themselves and tell one of `TURN` at least.

    Parameters
    ----------
    seen : Comparison
        Of the two.
    camera : Panorama
        That took them.
    """
    pairs = seen.pairs
    along = _stays(pairs.home, pairs.now, SAME)
    rest = pairs[~along]
    fit = estimate_motion(rest, np.zeros(len(rest)), camera.tilt_sigma)
    if fit is None or abs(fit.motion.alpha) < TURN or not assess(fit, rest).accepted:
        return None
    return _told(pairs.now[along, 1], int(fit.inlier.sum()))


def _stays(then: np.ndarray, now: np.ndarray, most: float) -> np.ndarray:
    """Return which directions, (n, 2), are the same to within an angle [rad]."""
    return np.asarray((np.abs(wrap(now - then)) <= most).all(axis=1))


def _told(elevation: np.ndarray, of_room: int) -> SelfOcclusion | None:
    """Return what is to be said of matches at elevations, (n,) [rad]; None if it may be chance."""
    if elevation.size < max(MIN_MATCHES, MIN_SHARE * of_room):
        return None
    lowest, highest = np.percentile(elevation, [5, 95])
    return SelfOcclusion(elevation.size, float(lowest), float(highest))
