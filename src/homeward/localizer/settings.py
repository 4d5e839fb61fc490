"""Settings of the robust localiser; the defaults serve every drive."""

from __future__ import annotations

from typing import Annotated

from homeward.drives.settings import NonNegative, OdometryDefaults, Positive
from homeward.io.checks import Field
from homeward.io.models import Strict
from homeward.localizer.tunables import GATE

Probability = Annotated[float, Field(gt=0, lt=1)]


class LocalizerSettings(Strict):
    """Settings of the robust localiser."""

    bearing_sigma: Positive = 0.02
    """Initial standard deviation of bearings whose noise is not given [rad]; then estimated from
    residuals."""
    home_sigma: Positive | None = None
    """Standard deviation of home bearings that come without one [rad]; None: as of any other
    bearing."""
    odometry: OdometryDefaults = OdometryDefaults()
    delay_sigma: NonNegative = 0.2
    """Prior standard deviation of the delay of odometry behind the camera, around zero [s]."""
    time_constant_sigma: NonNegative = 0.2
    """Prior standard deviation of the time constant with which the robot follows its odometry,
    around zero and not negative [s]; 0.1 to 0.2 s where odometry is the commanded twist."""
    camera_yaw_sigma: NonNegative = 0.01
    """Prior standard deviation of the camera's yaw on the robot [rad]."""
    keyframe_interval: Positive = 0.5
    """Shortest time between keyframes of a moving robot [s]."""
    window: Annotated[int, Field(ge=5)] = 40
    """Keyframes in the smoother's window."""
    longest_window: Annotated[int, Field(ge=5)] = 250
    """Largest window: older keyframes stay in it while a landmark that they saw has too little
    parallax."""
    mature_parallax: Positive = 1.0
    """Parallax from which a landmark no longer keeps keyframes in the window [rad]."""
    gate: Positive = round(GATE, 2)
    """Innovation gate: bearings with larger innovations are rejected [standard deviations]."""
    parallax: Positive = 0.06
    """Parallax from which a landmark is triangulated [rad]."""
    moved_prior: Probability = 0.1
    """Prior probability that a landmark moved since home was stored."""
    sure: Probability = 0.95
    """Posterior probability of the inlier home bearings from which a pose is `localised`."""
    largest_sigma: Positive = 0.5
    """Largest standard deviation of a pose that is published [median distance of home's landmarks].
    """
