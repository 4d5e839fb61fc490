"""Position fixes from home's picture, fused by covariance intersection.

Julier and Uhlmann, "A non-divergent estimation algorithm in the presence of unknown correlations",
American Control Conference 1997. Errors of successive fixes are correlated to an unknown degree;
covariance intersection is consistent for any correlation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, between, compose
from homeward.geometry.se2 import lever
from homeward.odometry.history import TwistHistory
from homeward.vision.geometry.epipolar import INLIER

POSE_HOLD_S, DIRECTION_HOLD_S = 2.0, 15.0
"""Validity of a fix [s]: of a pose, after which the map is more accurate, and of a direction."""
SLIP = 0.05
"""Error of odometry between images in addition to its noise, as a share of path and rotation."""
WEIGHTS = np.linspace(0.0, 1.0, 11)
"""Weights of the earlier fix that are tried; the new one has the rest."""


@dataclass(frozen=True)
class Fix:
    """Pose of the robot's centre in the home frame, from home's picture."""

    t: float
    """Stamp [s]."""
    pose: Pose
    covariance: np.ndarray
    """(3, 3), of x [m], y [m], heading [rad]."""
    has_distance: bool
    """Whether the distance from home is estimated, too."""
    is_verified: bool
    """Whether enough landmarks agree."""
    contradicted: bool
    """Whether the map contradicts home's picture."""
    reason: str
    """For the user."""


def propagated(fix: Fix, t: float, odometry: TwistHistory, noise_rates: np.ndarray) -> Fix:
    """Return a fix propagated to a later `t` [s] by odometry.

    `noise_rates` (3, 3) are those of `homeward.drives.settings.noise_rates`.
    """
    motion = between(odometry.pose(fix.t), odometry.pose(t))
    there = compose(fix.pose, motion)
    jacobian = lever(np.subtract(there, fix.pose))
    shift = math.hypot(motion.x, motion.y)
    slip = SLIP * np.array([shift, shift, motion.heading])
    driven = odometry.driven(t).since(odometry.driven(fix.t))
    along, _, turned = noise_rates @ np.array(driven)
    noise = np.diag(slip**2 + np.array([along, along, turned]))
    return replace(fix, pose=there, covariance=jacobian @ fix.covariance @ jacobian.T + noise)


def fused(before: Fix | None, fix: Fix) -> Fix:
    """Fuse a fix with the one before, propagated to the same time, if both are verified."""
    if before is None or not (before.is_verified and fix.is_verified):
        return fix
    off = np.array(before.pose) - np.array(fix.pose)
    off[2] = wrap(off[2])
    if off @ np.linalg.solve(before.covariance + fix.covariance, off) > INLIER**2:
        return fix
    old, new = (np.linalg.inv(f.covariance) for f in (before, fix))
    each = WEIGHTS[:, None, None] * old + (1.0 - WEIGHTS)[:, None, None] * new
    best = int(np.linalg.slogdet(each)[1].argmax())
    covariance = np.linalg.inv(each[best])
    x, y, heading = np.array(fix.pose) + WEIGHTS[best] * covariance @ old @ off
    return replace(fix, pose=Pose(float(x), float(y), float(wrap(heading))), covariance=covariance)
