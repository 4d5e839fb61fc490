"""What home's picture told of the robot's pose, joined from one picture to the next.

What errs in pictures errs alike, to a degree that nobody knows, and falls with the distance from
home. So they are joined by covariance intersection, which is honest whatever errors have in common
(Julier and Uhlmann, "A non-divergent estimation algorithm in the presence of unknown correlations",
American Control Conference 1997): on the whole the surer of the two counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from homeward.angles import wrap
from homeward.frames import Pose

SHARES = np.linspace(0.0, 1.0, 11)
"""What of its information the fix before may count; the rest is the share of the new one's."""
SAME = 3.0
"""Fixes farther apart than so many sigmas are not joined: the new one counts."""


@dataclass(frozen=True)
class Fix:
    """What home's picture told, of the robot's centre in the home frame."""

    t: float
    """When [s]."""
    pose: Pose
    covariance: np.ndarray
    """(3, 3), of x [m], y [m], heading [rad]."""
    tells_distance: bool
    """Whether it tells the distance from home, too."""
    sure: bool
    """Whether enough landmarks agree with it."""
    contradicted: bool
    """Whether the map contradicts home's picture."""
    reason: str
    """In words."""


def fused(before: Fix | None, fix: Fix) -> Fix:
    """Return a fix joined with the one before, carried to the same time; sure ones alone are."""
    if before is None or not (before.sure and fix.sure):
        return fix
    off = np.array(before.pose) - np.array(fix.pose)
    off[2] = wrap(off[2])
    if off @ np.linalg.solve(before.covariance + fix.covariance, off) > SAME**2:
        return fix
    old, new = (np.linalg.inv(f.covariance) for f in (before, fix))
    each = SHARES[:, None, None] * old + (1.0 - SHARES)[:, None, None] * new
    best = int(np.linalg.slogdet(each)[1].argmax())
    covariance = np.linalg.inv(each[best])
    x, y, heading = np.array(fix.pose) + SHARES[best] * covariance @ old @ off
    return replace(fix, pose=Pose(float(x), float(y), float(wrap(heading))), covariance=covariance)
