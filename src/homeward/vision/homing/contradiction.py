"""Contradiction between the map's pose and home's picture."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from homeward.angles import wrap
from homeward.estimator import Estimate, Status
from homeward.vision.homing.fix import DIRECTION_HOLD_S, Fix
from homeward.vision.homing.visual_homing import agree


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


def contradiction(mapped: Estimate, fix: Fix, words: str) -> Contradiction | None:
    """Compare a fix with a map's pose: where they contradict each other, either may be right.

    Parameters
    ----------
    mapped : Estimate
        What the map says.
    fix : Fix
        What home's picture told.
    words : str
        The same in words.

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
    return Contradiction(
        fix.t, fix.tells_distance or fix.contradicted, spread, f"{words}; the map contradicts that"
    )


def unanswered(before: Contradiction | None, fix: Fix) -> Contradiction | None:
    """Return what is left of a contradiction after a fix that agrees with the map.

    One about the distance is not resolved by a direction.
    """
    lasts = before is not None and before.tells_distance and not fix.tells_distance
    return before if lasts else None


def unexpired(before: Contradiction | None, t: float) -> Contradiction | None:
    """Return a contradiction while it lasts, at `t` [s]: as long as a direction."""
    return before if before is not None and t - before.t <= DIRECTION_HOLD_S else None
