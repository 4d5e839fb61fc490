"""Visual homing on a recorded drive, whose pictures were compared beforehand."""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from homeward.drives.drive import Drive
from homeward.estimator import Estimate, Estimator, guarded
from homeward.frames import Pose, bearing
from homeward.vision.comparison import LARGEST_DIRECTION_SIGMA, Comparison
from homeward.vision.homing.contradiction import Contradiction, contradiction, unanswered, unexpired
from homeward.vision.homing.fix import Fix
from homeward.vision.homing.visual_homing import VisualHoming

WAYS = (
    "ahead",
    "ahead to the left",
    "to the left",
    "behind to the left",
    "behind",
    "behind to the right",
    "to the right",
    "ahead to the right",
)
"""Directions of home, seen from the robot, anti-clockwise."""


@dataclass(frozen=True)
class ImageDrive(Drive):
    """A drive whose bearings were found in panoramas."""

    pictures: tuple[tuple[float, Comparison | None], ...] = ()
    """Stamp [s] of each picture, in order, and how it compares with home's; None where that was not
    tried. A comparison holds some 200 bytes a match, and nothing of the pictures themselves."""

    def seen_earlier(self, by: float) -> Self:
        """Return it with bearings and pictures stamped earlier by so long [s]."""
        pictures = tuple((t - by, compared) for t, compared in self.pictures)
        return dataclasses.replace(super().seen_earlier(by), pictures=pictures)


class RecordedVisualHoming(VisualHoming):
    """`VisualHoming` on a recorded drive: each picture counts when its time has come.

    No robot drives by its answers. So a direction home without a distance is told in words, not as
    a pose. Where map and picture contradict each other the surer one is told; where that is the
    map, it is unverified until a picture agrees with it.

    Parameters
    ----------
    estimator : Estimator
        Maps the landmarks.
    drive : ImageDrive
        What it will run on; of it, only pictures whose stamps have passed are looked at.
    """

    def __init__(self, estimator: Estimator, drive: ImageDrive) -> None:
        super().__init__(estimator, **drive.settings.robot)
        self._note = _note(drive)
        self._coming = deque(drive.pictures)
        self._doubt: Contradiction | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Those of the other estimator, and that home's picture was used."""
        return (*super().notes, self._note)

    @guarded
    def odometry(self, t: float, v: float, omega: float) -> None:
        """Take a twist that holds from `t` [s] on, and before it the pictures of earlier stamps."""
        self._look_before(t)
        super().odometry(t, v, omega)

    @guarded
    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Estimate:
        """Take all sightings of stamp `t` [s], and before them the pictures up to it."""
        self._look_before(math.nextafter(t, math.inf))
        return super().bearings(t, sightings, sigmas)

    def home(self, t: float, seen: Comparison | None) -> None:
        """Take how the picture of stamp `t` [s] compares with home's; None: it was not tried."""
        before = self._fix
        super().home(t, seen)
        fix = self._fix
        if fix is not None and fix is not before:
            now = contradiction(self._inner.estimate(t), fix, _words(fix))
            self._doubt = now or unanswered(self._doubt, fix)

    def _look_before(self, t: float) -> None:
        """Take the pictures before `t` [s] that were not yet taken."""
        while self._coming and self._coming[0][0] < t < math.inf:
            self.home(*self._coming.popleft())

    def _answer(self, mapped: Estimate, fix: Fix) -> Estimate:
        """Return a fix that tells the distance, too, unless a surer map contradicts it."""
        doubt = contradiction(mapped, fix, _words(fix))
        if fix.sure and (doubt is None or _off(fix.covariance) < _off(mapped.covariance)):
            return super()._answer(mapped, fix)
        if doubt is not None:
            return doubt.applied_to(mapped)
        return dataclasses.replace(mapped, reason=f"{mapped.reason}; {_words(fix)}")

    def _unless_refused(self, mapped: Estimate) -> Estimate:
        """Return what the map says; unsure where home's picture said otherwise, or is not seen."""
        said = super()._unless_refused(mapped)
        doubt = unexpired(self._doubt, self._clock.peek(mapped.t))
        return said if doubt is None else doubt.applied_to(said)


def way_home(pose: Pose, covariance: np.ndarray) -> str | None:
    """Say in words where home lies, seen from the robot.

    Parameters
    ----------
    pose : Pose
        Of the robot.
    covariance : ndarray, shape (3, 3)
        Of (x [m], y [m], heading [rad]).

    Returns
    -------
    str or None
        None where the direction is hardly known.
    """
    squared = pose.x**2 + pose.y**2
    if squared == 0.0:
        return None
    gradient = np.array([-pose.y / squared, pose.x / squared, -1.0])
    if gradient @ covariance @ gradient > LARGEST_DIRECTION_SIGMA**2:
        return None
    share = float(bearing(pose, 0.0, 0.0)) / math.tau
    return WAYS[round(share * len(WAYS)) % len(WAYS)]


def _words(fix: Fix) -> str:
    """Return what a fix says, with the way home where that is all it tells."""
    way = None if fix.sure else way_home(fix.pose, fix.covariance)
    return fix.reason if way is None else f"{fix.reason} (home lies {way})"


def _off(covariance: np.ndarray | None) -> float:
    """Return the mean square error of a position [m^2]; infinite where there is none."""
    return math.inf if covariance is None else float(covariance[0, 0] + covariance[1, 1])


def _note(drive: ImageDrive) -> str:
    """Say that home's picture was used."""
    known = sum(seen is not None and seen.accepted for _, seen in drive.pictures)
    return f"Home's picture was used, too: {known:,} of {len(drive.pictures):,} pictures match it."
