"""What pictures that were not recognised say together of the way home.

Of each of them something was guessed, mostly from three or four matches, which may be chance. But
chance guesses something else each time: where several pictures, taken from different places, guess
the same heading and the same direction, and what they matched stands all round, it is a hint that
the robot may drive by, until home is recognised. It is no more than that: a thing that was moved,
or one that is there twice, gives the same hint again and again.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from homeward.angles import wrap
from homeward.drives.clock import LATE_S
from homeward.estimator import HOLD_S
from homeward.vision.comparison import Comparison
from homeward.vision.geometry.a_contrario import too_narrow
from homeward.vision.homing.resection import Direction

FEWEST_MATCHES = 3
"""A guess must stand on so many."""
FEWEST_ALIKE, MOST = 5, 60
"""So many guesses must be alike, among so many at most: of more, some are by chance, ..."""
ALIKE = (0.2, 0.1)
"""... which they are when direction and heading differ by less than this [rad]."""
ANOTHER_PLACE_M = 0.04
"""From nearer to the last one than this [m] a picture would guess the same again."""
HOLD_VOTES_S = 15.0
"""A hint is no more where no picture has guessed the same for so long [s]."""
LEAST_SIGMA = 0.05
"""Guesses that are alike may be alike wrong by this [rad]."""


@dataclass(frozen=True)
class Vote:
    """What one picture guessed."""

    angles: np.ndarray
    """(2,): direction from home, and heading less what odometry has turned by [rad]."""
    matched: np.ndarray
    """(k, 2): azimuth and elevation at home of what it stands on [rad]."""


@dataclass(frozen=True)
class Consensus:
    """What several pictures guess alike."""

    t: float
    """When one last did [s]."""
    direction: Direction
    """What they guess on the whole."""
    guesses: int
    """That are alike."""


class Twist(NamedTuple):
    """What odometry said, and how far the robot had gone by then."""

    t: float
    """[s]"""
    v: float
    """[m/s]"""
    omega: float
    """[rad/s]"""
    gone: np.ndarray
    """(2,): way and turn [m, rad]."""


class DirectionVoting:
    """Remembers what was guessed, and how far the robot has turned since."""

    def __init__(self) -> None:
        self._twists: deque[Twist] = deque()
        """The last one, and those since a picture may yet come late."""
        self._voted_at = -math.inf
        """Way at the last guess [m]."""
        self._votes: deque[Vote] = deque(maxlen=MOST)
        self._consensus: Consensus | None = None
        """Its heading is less what odometry has turned by."""

    def odometry(self, t: float, v: float, omega: float) -> None:
        """Take a twist that holds from `t` [s] on: `v` [m/s] forward, `omega` [rad/s]."""
        self._twists.append(Twist(t, v, omega, self._gone_at(t)))
        while len(self._twists) > 1 and self._twists[1].t <= t - LATE_S:
            self._twists.popleft()

    def add(self, t: float, seen: Comparison) -> None:
        """Take what was guessed of a picture of stamp `t` [s] that was not recognised.

        It may be late by `LATE_S`: of longer ago it is not known how far the robot had turned.
        """
        motion, agrees = seen.motion, seen.agrees
        way, turned = self._gone_at(t).tolist()
        too_near = way < self._voted_at + ANOTHER_PLACE_M
        if motion is None or too_near or agrees.sum() < FEWEST_MATCHES:
            return
        self._voted_at = way
        angles = np.array([motion.theta, motion.alpha - turned])
        self._votes.append(Vote(angles, seen.pairs.home[agrees]))
        self._consensus = self._agreed(t) or self._consensus

    def forget(self) -> None:
        """Forget it all: now it is known."""
        self._votes.clear()
        self._consensus = None

    def at(self, t: float) -> Consensus | None:
        """Return the hint there is at `t` [s], its heading turned on by odometry."""
        if self._consensus is None:
            return None
        t, there = max(self._consensus.t, t), self._consensus.direction
        if t - self._consensus.t > HOLD_VOTES_S:
            return None
        alpha = float(wrap(there.alpha + self._gone_at(t)[1]))
        return replace(self._consensus, direction=replace(there, alpha=alpha))

    def _gone_at(self, t: float) -> np.ndarray:
        """Return way and turn by odometry up to `t` [s], (2,) [m, rad]."""
        if not self._twists:
            return np.zeros(2)
        held = next((twist for twist in reversed(self._twists) if twist.t <= t), self._twists[0])
        rates = np.array([abs(held.v), held.omega])
        return held.gone + rates * min(max(t - held.t, 0.0), HOLD_S)

    def _agreed(self, t: float) -> Consensus | None:
        """Return what guesses like the newest say; None if these are too few, or of one thing."""
        guessed = np.array([guess.angles for guess in self._votes])
        off = wrap(guessed - guessed[-1])
        alike = np.flatnonzero((np.abs(off) < ALIKE).all(axis=1))
        if alike.size < FEWEST_ALIKE:
            return None
        azimuth, elevation = np.vstack([self._votes[i].matched for i in alike]).T
        if too_narrow(azimuth, elevation=elevation):
            return None
        theta, alpha = wrap(guessed[-1] + off[alike].mean(axis=0)).tolist()
        covariance = np.cov(off[alike].T) + LEAST_SIGMA**2 * np.eye(2)
        return Consensus(t, Direction(theta, alpha, covariance), alike.size)
