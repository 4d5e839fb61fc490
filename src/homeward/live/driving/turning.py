"""A turn on the spot, so that a camera that sees a part of home sees all of it."""

from __future__ import annotations

import math
from typing import NamedTuple

from homeward.angles import wrap
from homeward.control import Twist
from homeward.live.driving.goals import Belief, Drive, State, Step
from homeward.live.driving.homing import Homing
from homeward.live.settings import Limits

ROUND = 1.05 * math.tau
"""Odometry that nobody calibrated may turn by 5 % less than it says [rad]."""
RATE = 0.5
"""A camera of 60 degrees at 15 Hz sees each landmark thirty times then [rad/s]."""


class Turning(Homing):
    """Turns round once, by odometry alone, within the limits of a drive home.

    The pose that it is told is that of the robot in its odometry frame.
    """

    def go(self, now: float) -> None:
        """Begin to turn."""
        super().go(now)
        self.aim(Round())

    def _doubt(self, now: float, belief: Belief) -> str:
        return "" if belief.pose is not None else "no odometry"


class Round(NamedTuple):
    """To have turned once round."""

    def drive(self, limits: Limits) -> Drive:
        """Return the turn."""
        return _Turn(limits)


class _Turn:
    def __init__(self, limits: Limits) -> None:
        self.patience, self._rate = limits.patience, min(RATE, limits.turn_rate)
        self._left, self._heading = ROUND, math.nan

    def step(self, now: float, belief: Belief, hindrance: str) -> Step:
        """Return what to do; see `Drive`."""
        if hindrance or belief.pose is None:
            return Step(State.HELD, hindrance)
        heading = float(belief.pose.heading)
        if math.isfinite(self._heading):
            self._left -= float(wrap(heading - self._heading))
        self._heading = heading
        if self._left <= 0.0:
            return Step(State.TURNED, "once round")
        return Step(State.DRIVING, "", Twist(0.0, self._rate))
