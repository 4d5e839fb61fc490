"""Direction voting: refused comparisons agree on the direction home.

A refused comparison has a motion, mostly from three or four matches, which may be chance. But
chance finds another one each time. If several from different positions agree in heading and
direction, and their matches are spread all round, the robot may drive by them until home is
recognised. The result stays unverified: a moved object, or two equal ones, give the same vote each
time.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from homeward.geometry.angles import wrap
from homeward.odometry.history import TwistHistory
from homeward.vision.comparison import Comparison
from homeward.vision.geometry.a_contrario import too_narrow
from homeward.vision.homing.fix import DIRECTION_HOLD_S
from homeward.vision.homing.resection import Direction

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
class Vote:
    """The motion of one refused comparison."""

    angles: np.ndarray
    """(2,): direction from home, and heading minus that of odometry [rad]."""
    matched: np.ndarray
    """(k, 2): azimuth and elevation at home of its inliers [rad]."""


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
        self._votes: deque[Vote] = deque(maxlen=MAX_VOTES)
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
        self._votes.append(Vote(angles, seen.pairs.home[agrees]))
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
        angles = np.array([vote.angles for vote in self._votes])
        off = wrap(angles - angles[-1])
        alike = np.flatnonzero((np.abs(off) < ALIKE).all(axis=1))
        if alike.size < MIN_ALIKE:
            return None
        azimuth, elevation = np.vstack([self._votes[i].matched for i in alike]).T
        if too_narrow(azimuth, elevation=elevation):
            return None
        theta, alpha = wrap(angles[-1] + off[alike].mean(axis=0)).tolist()
        covariance = np.cov(off[alike].T) + COMMON_SIGMA**2 * np.eye(2)
        return Consensus(t, Direction(theta, alpha, covariance), alike.size)
