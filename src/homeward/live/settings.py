"""What a live session can be told; the defaults suit a small robot with a camera at 15 Hz."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from homeward.drives.drive import NonNegative, Positive, Strict
from homeward.registry import DEFAULT

STOPS_WITHIN_S = 0.2
"""A robot whose sensors die, or that hears no command, stands after this [s]."""


class Limits(Strict):
    """How a robot may drive home."""

    speed: Positive = 0.25
    """The most [m/s]."""
    turn_rate: Positive = 1.0
    """The most [rad/s]."""
    acceleration: Positive = 0.5
    """Of the speed, up and down; what is unsafe stops at once [m/s^2]."""
    turn_acceleration: Positive = 3.0
    """Of the turn rate [rad/s^2]."""
    radius: Positive = 0.03
    """Home is reached where the robot is localised within this distance [m]."""
    largest_sigma: Positive = 0.25
    """With a less certain position it stands [m]; the larger axis of the 1-sigma ellipse."""
    coast: NonNegative = 1.0
    """It drives on for this long while not localised, as long as it has a pose; also for this long
    without a landmark in view, unless the noise of odometry is given [s]."""
    patience: Positive = 10.0
    """After standing so long for one reason after another it gives up [s]."""
    obstacle_distance: NonNegative = 0.3
    """It stands before anything nearer, where something tells how far the way is free [m]."""


class LiveSettings(Strict):
    """Settings of a live session."""

    estimator: str = DEFAULT
    limits: Limits = Limits()
    rate: Annotated[float, Field(ge=20, le=200)] = 50.0
    """Of commands [Hz]."""
    odometry_timeout: Positive = 0.15
    """Without odometry for so long the robot stands [s]; and it stands within `STOPS_WITHIN_S` if
    this is at most that less one command's period and the way there."""
    bearings_timeout: Positive = 0.15
    """Likewise for bearings, were there none in sight; more for cameras slower than 10 Hz [s]."""
    largest_lag: Positive = 0.5
    """It stands where bearings, or the answer to them, are older than odometry by more [s]."""
    queue: Annotated[int, Field(ge=10)] = 200
    """So many samples may wait for the estimator; then the oldest bearings are thrown away."""
