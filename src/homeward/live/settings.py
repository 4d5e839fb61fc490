"""What a live session can be told; the defaults suit a small robot with a camera at 15 Hz."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from homeward.control.limits import Limits
from homeward.drives.settings import Positive
from homeward.io.keys import Strict
from homeward.registry import DEFAULT

STOPS_WITHIN_S = 0.2
"""A robot whose sensors die, or that hears no command, stands after this [s]."""


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
