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
    """Stamp [s] of each picture, in order, and its comparison with home's; None if not made. A
    comparison takes about 200 bytes per match, and contains no pixels."""

    def with_earlier_sightings(self, by: float) -> Self:
        """Return the drive with bearings and pictures stamped earlier by `by` [s]."""
        pictures = tuple((t - by, compared) for t, compared in self.pictures)
        return dataclasses.replace(super().with_earlier_sightings(by), pictures=pictures)


@dataclass(frozen=True)
class Contradiction:
    """Disagreement between home's picture and the map about the robot's pose."""

    t: float
    """Stamp of the picture [s]."""
    has_distance: bool
    """Whether it concerns the distance from home, too, and not only the direction."""
    spread: np.ndarray
    """(3, 3): added to the covariance of the map's pose (x [m], y [m], heading [rad]), so that it
    covers the picture's pose, too."""
    reason: str
    """For the user."""

    def applied_to(self, mapped: Estimate) -> Estimate:
        """Return the map's estimate as unverified."""
        if mapped.covariance is None:
            return mapped
        covariance = mapped.covariance + self.spread
        return dataclasses.replace(
            mapped, status=Status.UNVERIFIED, reason=self.reason, covariance=covariance
        )


def contradiction(mapped: Estimate, fix: Fix) -> Contradiction | None:
    """Return the contradiction between the map's estimate and a fix from home's picture.

    Either may be correct. None if they agree, or the map has no pose.
    """
    if mapped.pose is None or (agree(mapped, fix) and not fix.contradicted):
        return None
    off = np.array(fix.pose) - np.array(mapped.pose)
    off[2] = wrap(off[2])
    spread = (fix.covariance + np.outer(off, off)) / 2
    words = f"{_words(fix)}; the map disagrees"
    return Contradiction(fix.t, fix.has_distance or fix.contradicted, spread, words)


class RecordedVisualHoming(VisualHoming):
    """`VisualHoming` on a recorded drive: each picture counts from its stamp on.

    No robot is driven by its estimates. So a direction home without a distance is reported in the
    reason, not as a pose. Where map and picture contradict each other, the one with the smaller
    covariance is reported; the map is then unverified until a picture agrees with it.
    """

    def __init__(self, estimator: Estimator, drive: ImageDrive) -> None:
        super().__init__(estimator, **drive.settings.robot)
        self._note = _note(drive)
        self._coming = deque(drive.pictures)
        self._doubt: Contradiction | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the inner estimator, and that home's picture was used."""
        return (*super().notes, self._note)

    @guarded
    def odometry(self, t: float, v: float, omega: float, vy: float = 0.0) -> None:
        """Process a twist that is valid from `t` [s] on, after the pictures of earlier stamps."""
        self._process_pictures_before(t)
        super().odometry(t, v, omega, vy)

    @guarded
    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Estimate:
        """Process all sightings of stamp `t` [s], after the pictures up to this stamp."""
        self._process_pictures_before(math.nextafter(t, math.inf))
        return super().bearings(t, sightings, sigmas)

    def home(self, t: float, seen: Comparison | None) -> None:
        """Process the comparison of the picture of stamp `t` [s] with home's; None: not made."""
        before = self._fix
        super().home(t, seen)
        fix = self._fix
        if fix is not None and fix is not before:
            doubt, earlier = contradiction(self._inner.estimate(t), fix), self._doubt
            # A direction does not resolve a contradiction about the distance.
            lasts = earlier is not None and earlier.has_distance and not fix.has_distance
            self._doubt = doubt or (earlier if lasts else None)

    def _process_pictures_before(self, t: float) -> None:
        """Process the remaining pictures before `t` [s]."""
        while self._coming and self._coming[0][0] < t < math.inf:
            self.home(*self._coming.popleft())

    def _answer(self, mapped: Estimate, fix: Fix) -> Estimate:
        """Return a verified fix, unless a more accurate map contradicts it; else the map's."""
        doubt = contradiction(mapped, fix)
        if fix.is_verified and (
            doubt is None or _mean_square(fix.covariance) < _mean_square(mapped.covariance)
        ):
            return super()._answer(mapped, fix)
        if doubt is not None:
            return doubt.applied_to(mapped)
        reason = fix.reason if mapped.pose is not None else _words(fix)
        return dataclasses.replace(mapped, reason=f"{mapped.reason}; {reason}")

    def _unless_refused(self, mapped: Estimate) -> Estimate:
        """Return the map's estimate; unverified if home's picture contradicts or does not match."""
        estimate, doubt = super()._unless_refused(mapped), self._doubt
        if doubt is None or not self._clock.peek(mapped.t) - doubt.t <= DIRECTION_HOLD_S:
            return estimate
        return doubt.applied_to(estimate)


def way_home(pose: Pose, covariance: np.ndarray) -> str | None:
    """Return the direction of home from the robot as text; None if it is too uncertain.

    `pose` is the robot's, with `covariance` (3, 3) of x [m], y [m] and heading [rad].
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
    """Return the reason of a fix, with the direction home if it is not verified."""
    way = None if fix.is_verified else way_home(fix.pose, fix.covariance)
    return fix.reason if way is None else f"{fix.reason} (home lies {way})"


def _mean_square(covariance: np.ndarray | None) -> float:
    """Return the mean square error of a position [m^2]; infinite without a covariance."""
    return math.inf if covariance is None else float(covariance[0, 0] + covariance[1, 1])


def _note(drive: ImageDrive) -> str:
    """Return the note that home's picture was used."""
    matching = sum(seen is not None and seen.accepted for _, seen in drive.pictures)
    return f"Home's picture was used: {matching:,} of {len(drive.pictures):,} pictures match it."
