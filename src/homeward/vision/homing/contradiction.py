"""What a map's pose is worth that home's picture contradicts."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from homeward.angles import wrap
from homeward.estimator import Estimate, Status
from homeward.vision.homing.fix import Fix
from homeward.vision.homing.visual_homing import DIRECTION_HOLD_S, agree


@dataclass(frozen=True)
class Contradiction:
    """That the robot is where the map says, since home's picture says otherwise."""

    t: float
    """When the picture was taken [s]."""
    tells_distance: bool
    """Whether it is about the distance from home, too, and not the direction alone."""
    spread: np.ndarray
    """(3, 3): added to the covariance of the map's pose, it covers the picture's, too; of x [m],
    y [m], heading [rad]."""
    reason: str
    """In words."""

    def cast_on(self, mapped: Estimate) -> Estimate:
        """Return the map's estimate, unsure."""
        if mapped.covariance is None:
            return mapped
        covariance = mapped.covariance + self.spread
        return dataclasses.replace(
            mapped, status=Status.UNVERIFIED, reason=self.reason, covariance=covariance
        )


def contradiction(mapped: Estimate, fix: Fix, words: str) -> Contradiction | None:
    """Return the doubt that a fix casts on a map's pose: either may be the right one.

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


def unanswered(doubt: Contradiction | None, fix: Fix) -> Contradiction | None:
    """Return what is left of a doubt after a fix that agrees with the map.

    Where the distance was in doubt, a direction does not answer for it.
    """
    return doubt if doubt is not None and doubt.tells_distance and not fix.tells_distance else None


def unexpired(doubt: Contradiction | None, t: float) -> Contradiction | None:
    """Return a doubt as it is at `t` [s]: as a direction, it is not remembered for ever."""
    return doubt if doubt is not None and t - doubt.t <= DIRECTION_HOLD_S else None
