"""Settings of a live session; the defaults suit a small robot with a camera at 15 Hz."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from homeward.control.limits import Limits
from homeward.drives.settings import Positive
from homeward.errors import InputError
from homeward.io.checks import Field
from homeward.io.models import Strict
from homeward.io.settings import read_settings
from homeward.registry import DEFAULT

STOPS_WITHIN_S = 0.2
"""A robot without sensor data or commands stops within this time [s]."""


class LiveSettings(Strict):
    """Settings of a live session."""

    estimator: str = DEFAULT
    limits: Limits = Limits()
    rate: Annotated[float, Field(ge=20, le=200)] = 50.0
    """Rate of commands [Hz]."""
    odometry_timeout: Positive = 0.15
    """The robot stops after this time without odometry [s]; to stop within `STOPS_WITHIN_S`, leave
    room for one command's period and the transmission."""
    bearings_timeout: Positive = 0.15
    """The robot stops after this time without a bearings message, which may be empty [s]; use more
    for cameras slower than 10 Hz."""
    largest_lag: Positive = 0.5
    """The robot stops if bearings, or their answers, are older than odometry by more [s]."""
    smoothed_lag: Positive | None = None
    """Each estimate is also sent as a message `smoothed`, at most this time late, smoothed with the
    data up to then [s]; None: no such messages. Only the estimator robust can."""
    queue: Annotated[int, Field(ge=10)] = 200
    """Maximum number of samples that wait for the estimator; the oldest bearings are dropped."""


def read_live_settings(file: Path) -> LiveSettings:
    """Read the settings of a live session; `InputError` also where they name Python code."""
    settings = read_settings(file, LiveSettings)
    if ":" in settings.estimator:
        raise InputError(
            f"estimator: {settings.estimator} is Python code outside homeward, and a file cannot "
            "choose it; install it as a package with an entry point of homeward.estimators, and "
            "give its name",
            file,
        )
    return settings
