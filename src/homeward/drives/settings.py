"""Settings of a drive: drive.yaml, landmarks.yaml, and the default noise of odometry."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self, TypedDict

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, model_validator

from homeward.geometry.frames import Polar, Pose
from homeward.io.keys import Strict

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


Finite = Annotated[float, Field(allow_inf_nan=False)]


Surveyed = Annotated[float, Field(ge=-1e7, le=1e7)]


Sigma = Annotated[float, Field(ge=1e-4, le=1e3)]


Late = Annotated[float, Field(ge=-5, le=5)]
"""[s]; clocks farther apart than `homeward.drives.one_clock.MAX_CLOCK_OFFSET_S` make no drive."""


class Mount(Strict):
    """Where a camera sits on the robot."""

    x: Finite = 0.0
    """Ahead of the robot's centre [m]."""
    y: Finite = 0.0
    """To the left of it [m]."""
    yaw: Finite = 0.0
    """Of the camera's axis from the robot's heading [rad]."""

    @property
    def pose(self) -> Pose:
        """The camera in the robot's frame."""
        return Pose(self.x, self.y, self.yaw)


class Sensor(Mount):
    """The camera of the drive."""

    bearing_sigma: Annotated[float, Field(gt=0, le=math.pi)] | None = None
    """Standard deviation of a bearing [rad]; None when unknown."""
    field_of_view: Annotated[float, Field(gt=0, le=2 * math.pi + 1e-9)] | None = None
    """Full opening angle around its axis [rad]; None when unknown."""


class OdometryNoise(Strict):
    """What is known of the odometry's errors; None when unknown."""

    speed_sigma: NonNegative | None = None
    """White noise of the speed [m/s/sqrt(Hz)]."""
    turn_sigma: NonNegative | None = None
    """White noise of the turn rate [rad/s/sqrt(Hz)]."""
    speed_scale_sigma: NonNegative | None = None
    """Constant relative error of the speed [1]."""
    turn_scale_sigma: NonNegative | None = None
    """Constant relative error of the turn rate [1]."""
    turn_bias_sigma: NonNegative | None = None
    """Constant error of the turn rate [rad/s]."""


class Start(Strict):
    """A start prior: where the robot was when the drive began, in the home frame."""

    R: NonNegative
    """Distance from home [m]."""
    theta: Finite
    """Direction of the robot seen from home [rad]."""
    alpha: Finite
    """Heading [rad]."""
    sigma_R: Positive = 0.05
    """[m]"""
    sigma_theta: Positive = 0.1
    """[rad]"""
    sigma_alpha: Positive = 0.1
    """[rad]"""

    @classmethod
    def about(cls, polar: Polar, *sigmas: float) -> Start:
        """Return the prior of a mean (R, theta, alpha) and its three standard deviations."""
        return cls(**dict(zip(cls.model_fields, map(float, (*polar, *sigmas)), strict=True)))

    @property
    def polar(self) -> Polar:
        """The mean as (R, theta, alpha)."""
        return Polar(self.R, self.theta, self.alpha)


class Robot(TypedDict, total=False):
    """What is known of a robot: the keywords of every estimator, as models or as their values."""

    sensor: Sensor | dict[str, Any]
    """The camera."""
    home_sensor: Mount | dict[str, Any] | None
    """The camera as it sat when home was stored, if otherwise."""
    odometry: OdometryNoise | dict[str, Any]
    """How far odometry may be off."""
    start: Start | dict[str, Any] | None
    """Where the robot is at first."""


def _in_order(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] >= span[1]:
        raise ValueError("must be [from, until]")
    return span


Span = Annotated[tuple[NonNegative, NonNegative], AfterValidator(_in_order)]
"""From so many seconds after the drive's first sample until so many [s]."""


class HomeWhen(Strict):
    """When the robot was at home, in a drive that saw home itself: one of these."""

    during: Span | None = None
    """It stood there."""
    spin: Span | None = None
    """It turned there on the spot; home is its pose when it began."""

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum(value is not None for _, value in self) != 1:
            raise ValueError(f"give one of {', '.join(type(self).model_fields)}")
        return self


class TruthFrame(Strict):
    """The frame of the ground truth."""

    home: tuple[Finite, Finite, Finite]
    """Home in that frame: x [m], y [m], heading [rad]."""


class DriveSettings(Strict):
    """Everything that drive.yaml may say; every key may be absent."""

    sensor: Sensor = Sensor()
    home: HomeWhen | None = None
    """When the robot was at home, instead of what the camera saw there; None: that is told."""
    home_sensor: Mount | None = None
    """The camera as it sat when home was stored; None: as `sensor`."""
    odometry: OdometryNoise = OdometryNoise()
    bearings_late: Late | None = None
    """Bearings are stamped so long after they were taken [s], by odometry's clock; None: 0. Readers
    take it out of the stamps (`without_bearing_delay`), and a drive that was read has None."""
    start: Start | None = None
    truth: TruthFrame | None = None
    """None: the home frame. `open_drive` transforms the truth; then a drive has None."""
    epoch: int | None = None
    """Whole seconds to be added to every time of the drive to have its log's clock; None: 0. Logs
    with Unix stamps are counted from their first whole second, since a double holds Unix time to
    0.2 microseconds only."""

    @property
    def robot(self) -> Robot:
        """What is known of the robot, for an estimator: ``Localizer(home, **settings.robot)``."""
        return {
            "sensor": self.sensor,
            "home_sensor": self.home_sensor,
            "odometry": self.odometry,
            "start": self.start,
        }

    @property
    def home_mount(self) -> Mount:
        """The camera's place on the robot when home was stored."""
        return self.sensor if self.home_sensor is None else self.home_sensor


class SurveyedLandmark(Strict):
    """Where a landmark was surveyed."""

    x: Surveyed
    """[m]"""
    y: Surveyed
    """[m]"""
    sigma: Sigma | None = None
    """Standard deviation of each of the two [m]; None: as of all."""
    stays: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Probability that it still stands there; None: as the estimator's settings say."""


class KnownDistance(Strict):
    """How far two landmarks are apart."""

    between: Annotated[tuple[str, ...], Field(min_length=2, max_length=2)]
    """Their ids."""
    distance: Annotated[float, Field(gt=0, le=1e7)]
    """[m]"""
    sigma: Sigma | None = None
    """Its standard deviation [m]; None: as of all."""


class KnownLandmarks(Strict):
    """Everything that landmarks.yaml may say: a survey of landmarks, and distances of pairs."""

    frame: Literal["own", "home"] = "own"
    """Of the survey: home's, or one of its own, whose place in the map is found."""
    sigma: Sigma = 0.02
    """Standard deviation of coordinates and distances that come without one [m]."""
    landmarks: dict[str, SurveyedLandmark] = {}
    """The surveyed ones, by id."""
    distances: tuple[KnownDistance, ...] = ()
    """Of pairs."""
    _joint: np.ndarray | None = PrivateAttr(None)

    @classmethod
    def remembered(
        cls, landmarks: dict[str, SurveyedLandmark], covariance: np.ndarray
    ) -> KnownLandmarks:
        """Return landmarks in the home frame, given the covariance of x, y, x, y, ... [m^2]."""
        known = cls(frame="home", landmarks=landmarks)
        known._joint = covariance
        return known

    @property
    def names(self) -> set[str]:
        """Ids of all landmarks of which something is told."""
        return {*self.landmarks, *(name for d in self.distances for name in d.between)}

    @property
    def joint_covariance(self) -> np.ndarray:
        """(2 k, 2 k): of the coordinates of the landmarks, in order [m^2]."""
        if self._joint is not None:
            return self._joint
        sigmas = [s.sigma or self.sigma for s in self.landmarks.values()]
        return np.diag(np.repeat(np.square(sigmas), 2))

    @model_validator(mode="after")
    def _check(self) -> Self:
        if any(a == b for a, b in (d.between for d in self.distances)):
            raise ValueError("a distance is between two landmarks, not one")
        if len(self.landmarks) == 1 and self.frame == "own":
            raise ValueError("one landmark in a frame of its own tells nothing: survey two")
        return self

    @property
    def surveyed_from_home(self) -> bool:
        """Whether landmarks were surveyed in home's frame."""
        return self.frame == "home" and bool(self.landmarks)

    @property
    def is_given(self) -> bool:
        """Whether anything is known."""
        return bool(self.landmarks or self.distances)


class OdometryDefaults(Strict):
    """Errors of an odometry of which nothing is known: a wheeled robot's, uncalibrated."""

    distance: Positive = 0.05
    """Diffusion along the path, and sideways to a third of it, in a room [m per root of a metre];
    times the root of k among landmarks at k times the distance, if nearer."""
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


def noise_rates(given: OdometryNoise, default: OdometryDefaults) -> np.ndarray:
    """Return how fast white noise grows, (3, 3): as specified, or in proportion to the motion.

    Rows: variances along [m^2/s], across [m^2/s] and of the heading [rad^2/s]. Columns: constant,
    in proportion to the speed [m/s], and to the turn rate [rad/s].
    """
    rates = np.zeros((3, 3))
    if given.speed_sigma is None:
        rates[:2, 1] = default.distance**2, default.distance**2 / 9.0
    else:
        rates[0, 0] = given.speed_sigma**2
    if given.turn_sigma is None:
        rates[2, 1:] = default.turn_by_driving**2, default.turn_by_turning**2
    else:
        rates[2, 0] = given.turn_sigma**2
    return rates
