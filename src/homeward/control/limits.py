"""Limits within which a robot is driven; the defaults suit a small robot."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field

from homeward.drives.settings import NonNegative, Positive
from homeward.geometry.frames import Twist
from homeward.io.keys import Strict

PositiveOrInf = Annotated[float, Field(gt=0)]
NonNegativeOrInf = Annotated[float, Field(ge=0)]


class Limits(Strict):
    """Limits of a drive to a goal; an infinite one does not limit."""

    speed: Positive = 0.25
    """The most [m/s]."""
    turn_rate: Positive = 1.0
    """The most [rad/s]."""
    acceleration: PositiveOrInf = 0.5
    """Of the speed, up and down; what is unsafe stops at once [m/s^2]."""
    turn_acceleration: PositiveOrInf = 3.0
    """Of the turn rate [rad/s^2]."""
    radius: Positive = 0.03
    """Home is reached where the robot is localised within this distance [m]."""
    largest_sigma: PositiveOrInf = 0.25
    """With a less certain position it stands [m]; the larger axis of the 1-sigma ellipse."""
    coast: NonNegativeOrInf = 1.0
    """It drives on for this long while not localised, as long as it has a pose; also for this long
    without a landmark in view, unless the noise of odometry is given [s]."""
    patience: PositiveOrInf = 10.0
    """After standing so long for one reason after another it gives up [s]."""
    obstacle_distance: NonNegative = 0.3
    """The robot stands if an obstacle is nearer, where a free distance is reported [m]."""

    def accelerated(self, last: Twist, wanted: Twist, dt: float) -> Twist:
        """Return the twist nearest to the wanted one that is reached from the last in `dt` [s]."""
        limits = self.acceleration, self.turn_acceleration
        dv, domega = (a if math.isinf(a) else a * dt for a in limits)
        return Twist(
            max(last.v - dv, min(last.v + dv, wanted.v)),
            max(last.omega - domega, min(last.omega + domega, wanted.omega)),
        )
