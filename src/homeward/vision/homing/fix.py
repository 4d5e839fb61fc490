"""Fixes from home's picture: poses, fused by covariance intersection, and votes for a direction.

Julier and Uhlmann, "A non-divergent estimation algorithm in the presence of unknown correlations",
American Control Conference 1997. Errors of successive fixes are correlated to an unknown degree;
covariance intersection is consistent for any correlation.

Votes: refused comparisons that agree on the direction home. A refused comparison has a motion,
mostly from three or four matches, which may be chance. But chance finds another one each time. If
several from different positions agree in heading and direction, and their matches are spread all
round, the robot may drive by them until home is recognised. The result stays unverified: a moved
object, or two equal ones, give the same vote each time.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, between, compose
from homeward.geometry.se2 import lever
from homeward.odometry.history import TwistHistory
from homeward.vision.comparison import Comparison
from homeward.vision.geometry.a_contrario import too_narrow
from homeward.vision.geometry.epipolar import INLIER
from homeward.vision.homing.resection import Direction

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


MIN_ALIKE, MAX_VOTES = 5, 60
"""Minimum number of votes that agree, and number of the latest votes that count: four others of 59
agree with the newest by chance once in 100,000 times."""
ALIKE = (0.2, 0.1)
"""Maximum differences in direction and heading of votes that agree [rad]."""
MIN_PATH_M = 0.04
"""Minimum path between two votes [m]: at the same position, a picture votes the same again."""
COMMON_SIGMA = 0.05
"""Standard deviation of the common error of votes that agree [rad]."""


@dataclass(frozen=True)
class Consensus:
    """A motion on which several votes agree."""

    t: float
    """Time of the latest of them [s]."""
    direction: Direction
    """Their mean, and its covariance."""
    votes: int
    """Number of votes."""


class DirectionVoting:
    """Collects votes; odometry propagates their heading."""

    def __init__(self, odometry: TwistHistory) -> None:
        self._odometry = odometry
        self._voted_at = -math.inf
        """Path at the last vote [m]."""
        self._votes: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=MAX_VOTES)
        """Direction from home, and heading minus that of odometry, (2,) [rad]; azimuth and
        elevation at home of the inliers, (k, 2) [rad]."""
        self._consensus: Consensus | None = None
        """Its heading is relative to that of odometry."""

    def add(self, t: float, seen: Comparison) -> None:
        """Add the vote of a refused comparison of stamp `t` [s], at most `MAX_DELAY_S` late."""
        motion, agrees = seen.motion, seen.agrees
        path = self._odometry.driven(t).path
        too_near = path < self._voted_at + MIN_PATH_M
        if motion is None or too_near or agrees.sum() < 3:
            return
        self._voted_at = path
        angles = np.array([motion.theta, motion.alpha - self._odometry.heading(t)])
        self._votes.append((angles, seen.pairs.home[agrees]))
        self._consensus = self._agreed(t) or self._consensus

    def clear(self) -> None:
        """Drop all votes: home was recognised."""
        self._votes.clear()
        self._consensus = None

    def at(self, t: float) -> Consensus | None:
        """Return the consensus at `t` [s], its heading propagated by odometry."""
        if self._consensus is None:
            return None
        t, there = max(self._consensus.t, t), self._consensus.direction
        if t - self._consensus.t > DIRECTION_HOLD_S:
            return None
        alpha = float(wrap(there.alpha + self._odometry.heading(t)))
        return replace(self._consensus, direction=replace(there, alpha=alpha))

    def _agreed(self, t: float) -> Consensus | None:
        """Return the mean of votes like the newest; None if they are too few or too narrow."""
        angles = np.array([each for each, _ in self._votes])
        off = wrap(angles - angles[-1])
        alike = np.flatnonzero((np.abs(off) < ALIKE).all(axis=1))
        if alike.size < MIN_ALIKE:
            return None
        azimuth, elevation = np.vstack([self._votes[i][1] for i in alike]).T
        if too_narrow(azimuth, elevation=elevation):
            return None
        theta, alpha = wrap(angles[-1] + off[alike].mean(axis=0)).tolist()
        covariance = np.cov(off[alike].T) + COMMON_SIGMA**2 * np.eye(2)
        return Consensus(t, Direction(theta, alpha, covariance), alike.size)
