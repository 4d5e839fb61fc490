"""What turns with the camera, and should be left out by a mask: a deck, a mast, a burnt-in stamp.

One picture does not show it. But where the robot has turned, what stands in the room lies elsewhere
in the picture; what lies where it lay before belongs to the robot, or to the picture itself.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from homeward.angles import wrap
from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.comparison import Comparison
from homeward.vision.features.detection import View
from homeward.vision.features.matching import match
from homeward.vision.geometry.a_contrario import assess
from homeward.vision.geometry.ransac import estimate_motion

TURN = math.radians(30.0)
"""After so much of a turn [rad] it can be told."""
SAME = math.radians(0.5)
"""A match lies where it lay when it is within this of it [rad], or within a pixel."""
OF_THE_ROOM = (0.35, 0.2)
"""What stands in the room lies within this of where the turn alone takes it, azimuth and elevation
[rad]; the first is less than `TURN`, so that what lies where it lay never does."""
FRAMES = 6
"""A frame is compared with so many before it, a turn apart: over more, odometry's own error of the
turn adds up."""
FEWEST, LEAST_SHARE = 5, 0.01
"""So many matches must turn along, and be such a share of those of the room. In rendered rooms
without anything that does there was none among 30,000, and among those of a robot's thin legs, 2 %
and more."""
LEAST_OF_ROOM = 0.1
"""As many matches must be of the room, and be such a share of those that turn along: else it is the
odometry that is wrong, of a robot that is stuck."""


@dataclass(frozen=True)
class SelfOcclusion:
    """That something turns with the camera."""

    matches: int
    """How many lay where they had lain."""
    lowest: float
    """Elevation of the lowest of them, but for a few [rad]."""
    highest: float
    """And of the highest [rad]."""

    @property
    def words(self) -> str:
        """What to do about it; `matches` is to stand in front."""
        low, high = math.floor(math.degrees(self.lowest)), math.ceil(math.degrees(self.highest))
        return (
            f"matches at elevations of {low} to {high} deg turn with the camera, as the robot's "
            "own parts do, or a time stamp in the picture: leave them out by a mask"
        )


class SelfOcclusionDetector:
    """Looks for what turns with the camera along a drive."""

    def __init__(self) -> None:
        self._before: deque[tuple[View, float]] = deque(maxlen=FRAMES)
        """Frames a turn apart, and the heading of each [rad]."""
        self._elevations: list[np.ndarray] = []
        """Of what lay where it had lain [rad]."""
        self._of_room = 0
        """How many matches lay where they should."""

    def see(self, view: View, heading: float) -> None:
        """Take the next frame.

        Parameters
        ----------
        view : View
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
        """What was found so far; None where nothing turns along."""
        elevation = np.concatenate([np.empty(0), *self._elevations])
        return _told(elevation, self._of_room)

    def _compare(self, before: View, now: View, turned: float) -> None:
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
        if of_room < max(FEWEST, LEAST_OF_ROOM * along.sum()):
            return
        self._elevations.append(here[along, 1])
        self._of_room += of_room


def find_self_occlusion(seen: Comparison, camera: Panorama) -> SelfOcclusion | None:
    """Return what turned with the camera between two panoramas; None where nothing is known of it.

    There is no odometry to tell the turn. But where the matches that do not lie where they lay are
    enough to be accepted by themselves, and say that the camera has turned by `TURN`, the others
    should not lie there, whatever was accepted of all.

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
    if elevation.size < max(FEWEST, LEAST_SHARE * of_room):
        return None
    lowest, highest = np.percentile(elevation, [5, 95])
    return SelfOcclusion(elevation.size, float(lowest), float(highest))
