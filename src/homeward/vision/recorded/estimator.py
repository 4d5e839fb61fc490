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
from homeward.estimator import Estimate, Estimator, Status, guarded
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing
from homeward.vision.comparison import MAX_DIRECTION_SIGMA, Comparison
from homeward.vision.homing.fix import DIRECTION_HOLD_S, Fix
from homeward.vision.homing.visual_homing import VisualHoming, agree

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

    def with_earlier_sightings(self, by: float) -> Self:
        """Return it with bearings and pictures stamped earlier by so long [s]."""
        pictures = tuple((t - by, compared) for t, compared in self.pictures)
        return dataclasses.replace(super().with_earlier_sightings(by), pictures=pictures)


@dataclass(frozen=True)
class Contradiction:
    """Home's picture says that the robot is not where the map says."""

    t: float
    """When the picture was taken [s]."""
    tells_distance: bool
    """Whether it concerns the distance from home, too, and not the direction alone."""
    spread: np.ndarray
    """(3, 3): added to the covariance of the map's pose, it covers the picture's, too; of x [m],
    y [m], heading [rad]."""
    reason: str
    """In words."""

    def applied_to(self, mapped: Estimate) -> Estimate:
        """Return the map's estimate as unverified."""
        if mapped.covariance is None:
            return mapped
        covariance = mapped.covariance + self.spread
        return dataclasses.replace(
            mapped, status=Status.UNVERIFIED, reason=self.reason, covariance=covariance
        )


def contradiction(mapped: Estimate, fix: Fix) -> Contradiction | None:
    """Compare a fix with a map's pose: where they contradict each other, either may be right.

    Parameters
    ----------
    mapped : Estimate
        What the map says.
    fix : Fix
        What home's picture told.

    Returns
    -------
    Contradiction or None
        None where they do not contradict each other, or the map tells no pose.
    """
    if mapped.pose is None or (agree(mapped, fix) and not fix.contradicted):
        return None
    off = np.array(fix.pose) - np.array(mapped.pose)
    off[2] = wrap(off[2])
    spread = (fix.covariance + np.outer(off, off)) / 2
    words = f"{_words(fix)}; the map contradicts that"
    return Contradiction(fix.t, fix.tells_distance or fix.contradicted, spread, words)


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
            doubt, told = contradiction(self._inner.estimate(t), fix), self._doubt
            # One about the distance is not resolved by a direction.
            lasts = told is not None and told.tells_distance and not fix.tells_distance
            self._doubt = doubt or (told if lasts else None)

    def _look_before(self, t: float) -> None:
        """Take the pictures before `t` [s] that were not yet taken."""
        while self._coming and self._coming[0][0] < t < math.inf:
            self.home(*self._coming.popleft())

    def _answer(self, mapped: Estimate, fix: Fix) -> Estimate:
        """Return a fix that tells the distance, too, unless a surer map contradicts it."""
        doubt = contradiction(mapped, fix)
        if fix.sure and (doubt is None or _off(fix.covariance) < _off(mapped.covariance)):
            return super()._answer(mapped, fix)
        if doubt is not None:
            return doubt.applied_to(mapped)
        said = fix.reason if mapped.pose is not None else _words(fix)
        return dataclasses.replace(mapped, reason=f"{mapped.reason}; {said}")

    def _unless_refused(self, mapped: Estimate) -> Estimate:
        """Return what the map says; unsure where home's picture said otherwise, or is not seen."""
        said, doubt = super()._unless_refused(mapped), self._doubt
        if doubt is None or not self._clock.peek(mapped.t) - doubt.t <= DIRECTION_HOLD_S:
            return said
        return doubt.applied_to(said)


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
    if gradient @ covariance @ gradient > MAX_DIRECTION_SIGMA**2:
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
