"""A turn on the spot, so that a camera that sees a part of home sees all of it."""

from __future__ import annotations

import math

from homeward.angles import wrap
from homeward.control import Twist
from homeward.live.homing import Belief, Homing, State

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
        self._left, self._heading = ROUND, math.nan

    def _doubt(self, now: float, belief: Belief) -> str | None:
        return None if belief.pose is not None else "no odometry"

    def _act(self, now: float, dt: float, belief: Belief) -> Twist:
        assert belief.pose is not None
        heading = float(belief.pose.heading)
        if math.isfinite(self._heading):
            self._left -= float(wrap(heading - self._heading))
        self._heading = heading
        if self._left <= 0.0:
            return self._stand(State.TURNED, "once round", now)
        return self._drive(Twist(0.0, min(RATE, self._limits.turn_rate)), now, dt)
