"""What the robust localiser can be told; the defaults serve every drive alike."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from homeward.drives.drive import NonNegative, Positive, Strict

Probability = Annotated[float, Field(gt=0, lt=1)]
Count = Annotated[int, Field(ge=1)]


class OdometryDefaults(Strict):
    """Errors of an odometry of which nothing is known: a wheeled robot's, uncalibrated."""

    distance: Positive = 0.05
    """Diffusion along the path, and sideways to a third of it [m per root of a metre]."""
    turn_by_turning: Positive = 0.05
    """Diffusion of the heading by turning [rad per root of a radian]."""
    turn_by_driving: Positive = 0.03
    """Diffusion of the heading by driving [rad per root of a metre]."""
    turn_scale: Positive = 0.05
    """Constant relative error of the turn rate [1]."""
    turn_bias: Positive = 0.003
    """Constant error of the turn rate while the robot moves [rad/s]."""
    turn_slip: Positive = 0.05
    """Speed lost in bends, per turn rate [m]; none when the drive tells its speed scale."""
    speed_scale: Positive = 0.03
    """Constant relative error of the speed [1]; bearings cannot tell it, so it is only carried."""


class LocalizerSettings(Strict):
    """Settings of the robust localiser."""

    bearing_sigma: Positive = 0.02
    """Of a bearing whose noise nobody gave, at first [rad]; then scaled by its own residuals."""
    home_sigma: Positive = 0.01
    """Of a home bearing whose noise nobody gave [rad]."""
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
    gate: Positive = 4.0
    """Sightings whose innovation is larger are rejected [standard deviations]."""
    parallax: Positive = 0.06
    """Angle between two sight lines that a landmark needs to enter the map [rad]."""
    moved_prior: Probability = 0.1
    """That a landmark was moved since home was stored, before anything was seen."""
    sure: Probability = 0.95
    """Posterior probability that the pose's set of right home bearings needs to be relied on."""
    largest_sigma: Positive = 0.5
    """A pose less certain than this is not given [median distance of home's landmarks]."""
