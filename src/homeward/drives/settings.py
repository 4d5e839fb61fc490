"""Settings of a drive: drive.yaml, and the default odometry noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Self, TypedDict, TypeVar, cast

import numpy as np

from homeward.errors import InputError
from homeward.geometry.frames import Polar, Pose, between
from homeward.geometry.statistics import MAX_SIGMA_M
from homeward.io.checks import AfterValidator, Field
from homeward.io.models import Strict, model_validator
from homeward.io.settings import validated

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
PositiveOrInf = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Delay = Annotated[float, Field(ge=-5, le=5)]
"""[s], up to `homeward.drives.plausibility.MAX_CLOCK_OFFSET_S`."""
Scale = Annotated[float, Field(ge=0.5, le=2)]
"""True value over the measured one [1]; a larger error is a wrong unit or geometry."""
Offset = Annotated[float, Field(ge=-20, le=20)]
"""[m]; one beyond the size of vehicles is in another unit."""
MAX_TURN = 2 * math.pi + 1e-3
"""[rad]; a turn may be rounded up, as 6.2832, and more is in degrees."""
Turn = Annotated[float, Field(ge=-MAX_TURN, le=MAX_TURN)]
"""[rad]"""
Number = TypeVar("Number", float, np.ndarray)


def _share_or_inf(value: float) -> float:
    """Return a share; a ValueError if it is above 1 and not infinite."""
    if 1.0 < value < math.inf:
        raise ValueError("must be at most 1 (100 %), or .inf")
    return value


RangeSigma = Annotated[float, Field(gt=0), AfterValidator(_share_or_inf)]


class Mount(Strict):
    """Camera extrinsics: the pose of the camera on the robot."""

    x: Finite = 0.0
    """Ahead of the robot's centre [m]."""
    y: Finite = 0.0
    """To the left of it [m]."""
    yaw: Finite = 0.0
    """Yaw of the camera's axis relative to the robot's heading [rad]."""

    @property
    def pose(self) -> Pose:
        """The camera's pose in the robot's frame."""
        return Pose(self.x, self.y, self.yaw)


class OtherCamera(Mount):
    """A further camera, next to that of `sensor`."""

    x_sigma: NonNegative | None = None
    """Standard deviation of x [m]; None: 0 where x is given."""
    y_sigma: NonNegative | None = None
    """That of y [m]."""
    yaw_sigma: NonNegative | None = None
    """That of the yaw [rad]; None: as the estimator's settings specify, or 0 for a further camera.
    Those of a further camera are relative to the first, and widen its bearings."""

    def bearing_sigma_at(self, distance: float) -> float:
        """Return the standard deviation of a bearing by these [rad], at a distance [m]."""
        shift = math.hypot(self.x_sigma or 0.0, self.y_sigma or 0.0) / math.sqrt(2.0)
        return math.hypot(shift / distance, self.yaw_sigma or 0.0)


class Sensor(OtherCamera):
    """The camera of the drive."""

    x: Offset = 0.0
    """Ahead of the robot's centre [m]."""
    y: Offset = 0.0
    """To the left of it [m]."""
    yaw: Turn = 0.0
    """Yaw of the camera's axis relative to the robot's heading [rad]."""
    bearing_sigma: Annotated[float, Field(gt=0, le=math.pi)] | None = None
    """Standard deviation of a bearing [rad]; None when unknown."""
    field_of_view: Annotated[float, Field(gt=0, le=MAX_TURN)] | None = None
    """Full opening angle around its axis [rad]; None when unknown."""
    range_sigma: RangeSigma | None = None
    """Relative standard deviation of a range without its own [1]; None: 0.05, and 0.05 m. ``.inf``:
    ranges are not used."""
    range_scale_sigma: Positive | None = None
    """Relative standard deviation of the scale that all ranges have in common, as of a tag's size
    [1]; None: unknown, so that ranges have no effect on the scale of the map."""


class OdometryNoise(Strict):
    """Corrections of the odometry, and standard deviations of its errors; None when unknown.

    Readers and live sessions apply the corrections; estimators get corrected twists.
    """

    speed_scale: Scale | None = None
    """True speed over that of the odometry [1]."""
    speed_scale_sigma: NonNegative | None = None
    """Constant relative error of the speed [1]."""
    sideways_scale: Scale | None = None
    """True sideways speed over that of the odometry times `speed_scale` [1]."""
    sideways_scale_sigma: NonNegative | None = None
    """Constant relative error of the sideways speed, beyond that of the speed [1]."""
    turn_scale: Scale | None = None
    """True yaw rate over that of the odometry [1]."""
    turn_scale_sigma: NonNegative | None = None
    """Constant relative error of the yaw rate [1]."""
    turn_bias: Finite | None = None
    """True yaw rate minus the scaled one while the robot moves [rad/s]."""
    turn_bias_sigma: NonNegative | None = None
    """Constant error of the yaw rate [rad/s]."""
    turn_slip: NonNegative | None = None
    """Distance lost by slip in each radian of rotation while the robot drives [m]."""
    turn_slip_sigma: NonNegative | None = None
    """Constant error of `turn_slip` [m]; None: 0 if `speed_scale_sigma` is given, else unknown."""
    speed_sigma: NonNegative | None = None
    """Density of the speed's white noise [m/s/sqrt(Hz)]."""
    sideways_sigma: NonNegative | None = None
    """Density of the sideways speed's white noise [m/s/sqrt(Hz)]; None: that of the speed, along
    the direction of motion."""
    turn_sigma: NonNegative | None = None
    """Density of the yaw rate's white noise [rad/s/sqrt(Hz)]."""
    time_constant: NonNegative | None = None
    """Time constant with which the robot follows its odometry as a first-order lag, as it does
    where odometry is the commanded twist [s]. Estimators include it; readers do not."""
    time_constant_sigma: NonNegative | None = None
    """Constant error of `time_constant` [s]."""
    delay_sigma: NonNegative | None = None
    """Error of `bearings_late` [s]."""

    @property
    def corrections(self) -> dict[str, float]:
        """The given corrections by key."""
        keys = {"speed_scale", "sideways_scale", "turn_scale", "turn_bias", "turn_slip"}
        return self.model_dump(include=keys, exclude_none=True)

    def corrected(self, v: Number, omega: Number, vy: Number) -> tuple[Number, Number, Number]:
        """Return `v` [m/s], `omega` [rad/s], `vy` [m/s], numbers or (n,), with the corrections."""
        bias = (self.turn_bias or 0.0) * ((v != 0.0) | (omega != 0.0) | (vy != 0.0))
        scale = self.speed_scale or 1.0
        speed, rate = scale * v, (self.turn_scale or 1.0) * omega + bias
        lost = np.minimum((self.turn_slip or 0.0) * np.abs(rate), np.abs(speed))
        return speed - np.copysign(lost, speed), rate, (self.sideways_scale or 1.0) * scale * vy

    @property
    def lag(self) -> tuple[float, float] | None:
        """`time_constant` and its standard deviation [s]; None where neither is given."""
        if self.time_constant is None and self.time_constant_sigma is None:
            return None
        return self.time_constant or 0.0, self.time_constant_sigma or 0.0

    def slip_sigma(self, unknown: float) -> float:
        """Return the standard deviation of slip in bends, `unknown` where nothing is given [m]."""
        if self.turn_slip_sigma is not None:
            return self.turn_slip_sigma
        return unknown if self.speed_scale_sigma is None else 0.0


class Wheels(Strict):
    """Geometry of the wheels; the measurements determine which keys are required."""

    wheel_radius: Positive | None = None
    """[m]"""
    track_width: Positive | None = None
    """Distance between left and right wheels [m]."""
    ticks_per_turn: Positive | None = None
    """Encoder counts in one turn of a wheel, with the gear; None: wheel angles are in radians."""
    wheelbase: Positive | None = None
    """Distance between the axles of a car-like (Ackermann) robot, or of a mecanum drive [m]."""
    roller_angle: Annotated[float, Field(gt=0, lt=math.pi / 2)] | None = None
    """Angle of the rollers of mecanum wheels against the axles [rad]; None: 45 degrees. A
    JointState is of mecanum wheels where it is given."""
    omni_radius: Positive | None = None
    """Distance of omni wheels from the centre of the robot [m]."""
    omni_angle: Finite | None = None
    """Direction of the first omni wheel from the centre, anti-clockwise from ahead [rad]; None: 60
    degrees for three wheels, 45 degrees for four."""
    modules: tuple[tuple[Finite, Finite], ...] = Field((), examples=[[[0.25, 0.25], [-0.25, 0.0]]])
    """Positions of swerve modules from the centre, ahead and to the left, in the order of their
    states [m]."""

    def missing(self, unit: str, steers: bool = False, omni: bool = False) -> list[str]:
        """Return the missing keys for wheels in a unit: ticks, rad or m, or these per second."""
        base = unit.removesuffix("/s")
        keys = ["wheel_radius"] * (base != "m") + ["ticks_per_turn"] * (base == "ticks")
        keys.append("omni_radius" if omni else "wheelbase" if steers else "track_width")
        return [key for key in keys if getattr(self, key) is None]

    @property
    def without_turns(self) -> Wheels:
        """The geometry of which the speed alone is computed, where a gyroscope gives yaw rates."""
        return self.model_copy(update=dict.fromkeys(("track_width", "wheelbase", "omni_radius")))

    def turn(self, unit: str) -> float | None:
        """Return one turn of a wheel in a unit, as `missing`; None without a radius."""
        turns = {"ticks": self.ticks_per_turn, "rad": math.tau}
        if self.wheel_radius is None:
            return None
        return turns.get(unit.removesuffix("/s"), math.tau * self.wheel_radius)

    def metres(self, unit: str) -> float:
        """Return the distance of one unit [m], as `missing`."""
        turn = self.turn(unit)
        if unit.removesuffix("/s") == "m" or turn is None:
            return 1.0
        return math.tau * (self.wheel_radius or math.nan) / turn


class RobotSettings(Strict):
    """The keys of robot.yaml: the calibration of a robot, which its drives share."""

    sensor: Sensor = Sensor()
    cameras: dict[str, OtherCamera] = Field({}, examples=[{"rear": {"x": -0.2, "yaw": 3.1416}}])
    """Extrinsics of further cameras by name, where bearings have a column `camera`; `sensor` is the
    camera that is not among them."""
    odometry: OdometryNoise = OdometryNoise()
    bearings_late: Delay | None = None
    """Delay of the stamps of bearings, on odometry's clock [s]; None: 0. Readers subtract it, so a
    drive that was read has None."""
    covariance_scale: Annotated[float, Field(ge=0.01, le=100)] | None = None
    """Factor of the covariances of poses, fitted to errors on other drives of the robot [1]; None:
    1. The robust localiser uses it."""
    largest_sigma: PositiveOrInf = MAX_SIGMA_M
    """Largest standard deviation of a position, along its worst direction, with which the robot
    drives; a run reports the time within it [m]."""
    wheels: Wheels | None = Field(None, examples=[{"wheel_radius": 0.1, "track_width": 0.4}])
    """Geometry with which the odometry was computed, which the corrections refer to."""

    @property
    def uncorrected(self) -> Self:
        """These settings for odometry and stamps that are corrected already."""
        update: dict[str, Any] = {"bearings_late": None}
        if given := self.odometry.corrections:
            rest = self.odometry.model_copy(update=dict.fromkeys(given))
            update |= {"odometry": rest, "wheels": None}
        return self.model_copy(update=update)


class Start(Strict):
    """Start prior: the robot's pose at the beginning of the drive, in the home frame."""

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
        """Return the prior with a mean (R, theta, alpha) and three standard deviations."""
        return cls(**dict(zip(cls.model_fields, map(float, (*polar, *sigmas)), strict=True)))

    @property
    def polar(self) -> Polar:
        """The mean as (R, theta, alpha)."""
        return Polar(self.R, self.theta, self.alpha)


class Robot(TypedDict, total=False):
    """Keyword arguments of every estimator for the robot, as models or as their values."""

    sensor: Sensor | dict[str, Any]
    """The camera; of several cameras the first, to which the calibration refers."""
    cameras: Mapping[str, OtherCamera | dict[str, Any]]
    """Extrinsics of the other cameras by name."""
    home_sensor: Mount | dict[str, Any] | None
    """The camera extrinsics when home was stored, if different."""
    odometry: OdometryNoise | dict[str, Any]
    """Noise of the odometry."""
    start: Start | dict[str, Any] | None
    """Prior of the initial pose."""
    together: Sequence[Sequence[str]]
    """Groups of landmarks that move together."""
    covariance_scale: float | None
    """Factor of the covariances of poses [1]."""


def _in_order(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] >= span[1]:
        raise ValueError("must be [from, until]")
    return span


Span = Annotated[tuple[NonNegative, NonNegative], AfterValidator(_in_order)]
"""An interval, from the first sample of the drive on [s]."""


HOME_TIMES = (
    "--home during:FROM,TO [s] (at rest at home), spin:FROM,TO [s] (turned on the spot there) or "
    "at:T [s] (its pose at time T; 0: the first)"
)
"""Ways to give home by a time of the drive."""


class HomeWhen(Strict):
    """Time at which the robot was at home during the drive: one of these."""

    during: Span | None = None
    """Interval in which the robot was stationary at home."""
    spin: Span | None = None
    """Interval in which it turned on the spot at home; home is its pose at the beginning."""
    at: NonNegative | None = None
    """Time of the pose that is home, from the first sample of the drive on [s]; 0: the first."""

    @property
    def times(self) -> tuple[float, float] | None:
        """First and last time at home [s]; None where no time is given."""
        return self.during or self.spin or (None if self.at is None else (self.at, self.at))

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum(value is not None for _, value in self) != 1:
            raise ValueError(f"give one of {', '.join(type(self).model_fields)}")
        return self


def home_when(
    home_during: tuple[float, float] | None = None,
    home_spin: tuple[float, float] | None = None,
    home_at: float | None = None,
) -> HomeWhen | None:
    """Return the time at home from options, of which at most one is given."""
    given = {"during": home_during, "spin": home_spin, "at": home_at}
    chosen = {key: value for key, value in given.items() if value is not None}
    if len(chosen) > 1:
        raise InputError(f"give one of {', '.join(f'home_{key}' for key in given)}, not several")
    return validated(HomeWhen, chosen) if chosen else None


class TruthFrame(Strict):
    """The frame of the ground truth."""

    home: tuple[Finite, Finite, Finite]
    """Home in that frame: x [m], y [m], heading [rad]."""


class DriveSettings(RobotSettings):
    """The keys of drive.yaml; all are optional."""

    home: HomeWhen | None = Field(None, examples=[{"during": [0, 5]}, {"spin": [0, 20]}, {"at": 0}])
    """Time at which the robot was at home [s from the start]; None: home bearings are given
    instead."""
    home_sensor: Mount | None = Field(None, examples=[Mount()])
    """The camera extrinsics when home was stored; None: as `sensor`."""
    start: Start | None = Field(None, examples=[{"R": 2.0, "theta": 0.0, "alpha": 3.14}])
    """Start prior: distance from home [m], direction from home [rad], heading [rad]; None: none."""
    together: tuple[Annotated[tuple[str, ...], Field(min_length=1)], ...] = ()
    """Groups of ids of landmarks that move together, as tags on one box; an id alone moves alone.
    Others within 0.5 m of each other may."""
    truth: TruthFrame | None = Field(None, examples=[{"home": [0.0, 0.0, 0.0]}])
    """None: the home frame. `open_drive` transforms ground truth to it, and then sets None."""
    check_senses: bool = True
    """Whether the rotation of the odometry is compared with the bearings, and a run is refused if
    these are in a fixed frame or another unit."""
    signs_changed: Annotated[int, Field(ge=0)] = 0
    """Number of bearings of which `homeward import` changed the sign; each run has a note on it."""
    epoch: int | None = None
    """Whole seconds to add to the times of the drive for the clock of its log; None: 0. The times
    of logs with Unix stamps count from their first whole second, since a double resolves Unix time
    to 0.2 microseconds only."""

    @property
    def robot(self) -> Robot:
        """Keyword arguments of an estimator: ``Localizer(home, **settings.robot)``."""
        return cast(Robot, {key: getattr(self, key) for key in Robot.__annotations__})

    def mount_of(self, camera: str) -> Mount:
        """Return the extrinsics of a camera; those under `sensor` for all names but others."""
        return self.cameras.get(camera, self.sensor)

    def in_first(self, camera: str) -> np.ndarray | None:
        """Return the pose (3,) of a camera in the frame of the first one; None for the first."""
        own = self.cameras.get(camera)
        return None if own is None else np.array(between(self.sensor.pose, own.pose))

    def offsets(self, cameras: Sequence[str]) -> np.ndarray | None:
        """Return the poses (k, 3) of cameras in the frame of the first one; None: all are it."""
        known = {name: self.in_first(name) for name in set(cameras)}
        if all(offset is None for offset in known.values()):
            return None
        return np.array([np.zeros(3) if (o := known[n]) is None else o for n in cameras])

    @property
    def home_mount(self) -> Mount:
        """Camera extrinsics when home was stored."""
        return self.sensor if self.home_sensor is None else self.home_sensor


class OdometryDefaults(Strict):
    """Default odometry errors: those of an uncalibrated wheeled robot."""

    distance: Positive = 0.05
    """Diffusion along the path, and sideways to a third of it, in a room [m per root of a metre];
    times the root of k among landmarks at k times the distance, if nearer."""
    turn_by_turning: Positive = 0.05
    """Diffusion of the heading from rotation [rad per root of a radian]."""
    turn_by_driving: Positive = 0.03
    """Diffusion of the heading from translation [rad per root of a metre]."""
    turn_scale: Positive = 0.05
    """Constant relative error of the yaw rate [1]."""
    turn_bias: Positive = 0.003
    """Constant error of the yaw rate while the robot moves [rad/s]."""
    turn_slip: Positive = 0.05
    """Slip in bends, the speed lost per yaw rate [m]; see `OdometryNoise.turn_slip_sigma`."""
    sideways_scale: Positive = 0.2
    """Constant relative error of the sideways speed, beyond that of the speed [1]: rollers slip."""
    speed_scale: Positive = 0.04
    """Constant relative error of the speed [1]; not observable from bearings. The calibrations of
    seven real drives have an RMS of 0.039."""


def noise_rates(given: OdometryNoise, default: OdometryDefaults) -> np.ndarray:
    """Return the growth rates of white noise, (3, 3): as specified, or in proportion to the motion.

    Rows: variances along [m^2/s], across [m^2/s] and of the heading [rad^2/s]. Columns: constant,
    in proportion to the speed [m/s], and to the yaw rate [rad/s].
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
    rates[1, 0] = (given.sideways_sigma or 0.0) ** 2
    return rates
