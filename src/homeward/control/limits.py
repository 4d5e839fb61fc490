"""Limits within which a robot is driven; the defaults suit a small robot."""

from __future__ import annotations

import math
from typing import Annotated

from homeward.drives.settings import NonNegative, Positive, PositiveOrInf, RobotSettings
from homeward.geometry.frames import Twist
from homeward.geometry.statistics import MAX_SIGMA_M, AccuracyLimit
from homeward.io.checks import Field
from homeward.io.models import Strict

NonNegativeOrInf = Annotated[float, Field(ge=0)]


class Limits(Strict):
    """Limits of a drive to a goal; infinity means no limit."""

    speed: Positive = 0.25
    """Maximum speed [m/s]."""
    sideways: Positive | None = None
    """Maximum speed to the left and right of a robot that moves sideways: it drives straight to its
    goal with any heading [m/s]; None: it does not move sideways."""
    turn_rate: Positive = 1.0
    """Maximum turn rate [rad/s]."""
    acceleration: PositiveOrInf = 0.5
    """Maximum acceleration and deceleration; safety stops are immediate [m/s^2]."""
    turn_acceleration: PositiveOrInf = 3.0
    """Maximum acceleration of the turn rate [rad/s^2]."""
    radius: Positive = 0.03
    """Home is reached when the robot is localised within this distance [m]."""
    largest_sigma: PositiveOrInf | None = None
    """The robot stops if the standard deviation of its position, along the worst direction, exceeds
    this, and drives on below 0.8 of it [m]; None: `largest_sigma` of robot.yaml."""
    coast: NonNegativeOrInf = 1.0
    """The robot drives on for this time with a pose but not localised. Also the maximum time
    without a landmark in view, 2 s more if the noise of odometry is given [s]. Turns on the spot do
    not count."""
    search: NonNegative = 0.5
    """Rate at which the robot turns on the spot to see a landmark when none is in view, or to find
    its pose when it is lost; 0: it does not, for robots that need more room to turn [rad/s]."""
    patience: PositiveOrInf = 10.0
    """The robot gives up after being stopped for this time, for any reasons [s]."""
    obstacle_distance: NonNegative = 0.3
    """The robot stops if a reported obstacle is nearer [m]."""

    def of(self, robot: RobotSettings) -> Limits:
        """Return these limits with those that the settings of the robot give."""
        if self.largest_sigma is not None:
            return self
        return self.model_copy(update={"largest_sigma": robot.largest_sigma})

    def accuracy(self) -> AccuracyLimit:
        """Return a new test of poses by `largest_sigma`."""
        return AccuracyLimit(self.largest_sigma or MAX_SIGMA_M)

    def accelerated(
        self, last: Twist, wanted: Twist, dt: float, sideways: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[Twist, float]:
        """Return the twist nearest to the wanted one that is reachable in `dt` [s].

        And the speed to the left [m/s]; `sideways` has the last and the wanted one.
        """
        limits = self.acceleration, self.turn_acceleration
        dv, domega = (a if math.isinf(a) else a * dt for a in limits)
        v, vy = wanted.v, sideways[1]
        change = math.hypot(v - last.v, vy - sideways[0])
        if change > dv:
            share = dv / change
            v, vy = last.v + share * (v - last.v), sideways[0] + share * (vy - sideways[0])
        return Twist(v, max(last.omega - domega, min(last.omega + domega, wanted.omega))), vy

    def towards(self, x: float, y: float, heading: float) -> tuple[float, float]:
        """Return speeds ahead and to the left [m/s], straight along (x, y) [m] with any heading.

        For a robot with `sideways`; it slows down within 1 s of the end.
        """
        assert self.sideways is not None
        c, s = math.cos(heading), math.sin(heading)
        ahead, left = c * x + s * y, c * y - s * x
        share = 1.0 / max(math.hypot(ahead / self.speed, left / self.sideways), 1.0)
        return share * ahead, share * left
