"""Settings of the robust localiser; the defaults serve every drive."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from homeward.drives.drive import NonNegative, Positive, Strict
from homeward.drives.odometry_noise import OdometryDefaults
from homeward.localizer.tunables import GATE

Probability = Annotated[float, Field(gt=0, lt=1)]
Count = Annotated[int, Field(ge=1)]


class LocalizerSettings(Strict):
    """Settings of the robust localiser."""

    bearing_sigma: Positive = 0.02
    """Of a bearing whose noise nobody gave, at first [rad]; then scaled by its own residuals."""
    home_sigma: Positive | None = None
    """Of a home bearing that comes without one [rad]; None: as of any other bearing."""
    odometry: OdometryDefaults = OdometryDefaults()
    lag_sigma: NonNegative = 0.2
    """Of the unknown lag of the odometry behind the camera, which has mean zero [s]."""
    camera_yaw_sigma: NonNegative = 0.01
    """Of the unknown part of the camera's yaw on the robot [rad]."""
    keyframe_interval: Positive = 0.5
    """A moving robot gets a keyframe this often [s]."""
    window: Annotated[int, Field(ge=5)] = 40
    """Keyframes whose poses are always open to correction."""
    longest_window: Annotated[int, Field(ge=5)] = 250
    """Older ones stay open, up to this many, while a landmark that they saw is not `mature`."""
    mature_parallax: Positive = 1.0
    """Angle between the sight lines of a landmark that is safely placed [rad]."""
    gate: Positive = round(GATE, 2)
    """Sightings whose innovation is larger are rejected [standard deviations]."""
    parallax: Positive = 0.06
    """Angle between two sight lines that a landmark needs to enter the map [rad]."""
    moved_prior: Probability = 0.1
    """That a landmark was moved since home was stored, before anything was seen."""
    sure: Probability = 0.95
    """Posterior probability that the pose's set of right home bearings needs to be relied on."""
    largest_sigma: Positive = 0.5
    """A pose less certain than this is not given [median distance of home's landmarks]."""
