"""The Drive: everything that enters, whatever file or camera it came from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Annotated, Any, Literal, Self, TypedDict, cast

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, model_validator

from homeward.estimator import ByValue
from homeward.geometry.angles import interpolate, wrap
from homeward.geometry.frames import Polar, Pose, between
from homeward.io.strict import Strict

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
    take it out of the stamps (`on_time`), and a drive that was read has None."""
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
        """Return landmarks in home's frame whose coordinates are correlated.

        Parameters
        ----------
        landmarks : dict of str to SurveyedLandmark
            k of them; their deviations are not asked for.
        covariance : ndarray, shape (2 k, 2 k)
            Of their coordinates x, y, x, y, ... [m^2].
        """
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
    def _tells(self) -> Self:
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
    def tells(self) -> bool:
        """Whether anything is known."""
        return bool(self.landmarks or self.distances)


class Columns:
    """A table whose fields are columns of one length."""

    def rows(self, use: np.ndarray) -> Self:
        """Return some rows: a mask (n,), or their numbers."""
        return type(self)(*(getattr(self, f.name)[use] for f in fields(cast(Any, self))))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return the rows of several tables, one after another."""
        names = [f.name for f in fields(cast(Any, cls))]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


@dataclass(frozen=True)
class Odometry(Columns):
    """Twists; each holds from its stamp to the next. All arrays have shape (n,).

    Where both v and omega are NaN, the motion is unknown from that stamp to the next.
    """

    t: np.ndarray
    """Strictly increasing times [s]."""
    v: np.ndarray
    """Forward speed [m/s]."""
    omega: np.ndarray
    """Turn rate [rad/s]."""

    @property
    def bridged(self) -> Self:
        """The same with each unknown twist replaced by the last known one, at first by 0."""
        known = np.isfinite(self.v) & np.isfinite(self.omega)
        if known.all():
            return self
        last = np.maximum.accumulate(np.where(known, np.arange(known.size), -1))
        v, omega = (np.where(last < 0, 0.0, part[last]) for part in (self.v, self.omega))
        return type(self)(self.t, v, omega)


@dataclass(frozen=True)
class Sightings(Columns):
    """Bearings seen on the way. All arrays have shape (n,)."""

    t: np.ndarray
    """Times [s], never decreasing."""
    landmark: np.ndarray
    """Ids (str)."""
    bearing: np.ndarray
    """From the camera's axis [rad], in (-pi, pi]."""
    sigma: np.ndarray
    """[rad]; NaN where not given."""

    @classmethod
    def of_rows(cls, rows: Sequence[tuple[float, str, float, float]]) -> Self:
        """Return those of rows (t, landmark, bearing, sigma), in order of time."""
        ids = np.array([landmark for _, landmark, _, _ in rows], object)
        numbers = np.array([(t, b, s) for t, _, b, s in rows], float).reshape(-1, 3)
        return cls(numbers[:, 0], ids, numbers[:, 1], numbers[:, 2])

    def stamps(self) -> Iterator[tuple[float, dict[str, float], dict[str, float]]]:
        """Yield (t, {id: bearing}, {id: sigma}) for each stamp; of equal ids the last counts."""
        edges = np.flatnonzero(self.t[1:] != self.t[:-1]) + 1
        for a, b in pairwise(np.unique([0, *edges, self.t.size])):
            ids = [str(i) for i in self.landmark[a:b]]
            seen = dict(zip(ids, self.bearing[a:b].tolist(), strict=True))
            sigma = dict(zip(ids, self.sigma[a:b].tolist(), strict=True))
            yield float(self.t[a]), seen, {i: s for i, s in sigma.items() if math.isfinite(s)}


@dataclass(frozen=True, eq=False)
class HomeBearing(ByValue):
    """What the camera saw of one landmark at home."""

    bearing: float
    """From the camera's axis there [rad], in (-pi, pi]."""
    sigma: float = math.nan
    """[rad]; NaN where not given."""


TRUTH_GAP_S = 0.5
"""Ground truth is not interpolated across a longer gap [s]."""


def is_slow(t: np.ndarray) -> bool:
    """Return whether most intervals between the stamps of ground truth [s] are such gaps."""
    return t.size > 1 and float(np.median(np.diff(t))) > TRUTH_GAP_S


@dataclass(frozen=True)
class Truth(Columns):
    """True poses in the home frame, for scoring alone. All arrays have shape (n,)."""

    t: np.ndarray
    """Strictly increasing times [s]."""
    x: np.ndarray
    """[m]"""
    y: np.ndarray
    """[m]"""
    heading: np.ndarray
    """[rad]"""

    def at(self, t: np.ndarray) -> Pose:
        """Interpolate the pose at times `t` [s], shape (m,); held still beyond either end."""
        return Pose(
            np.interp(t, self.t, self.x),
            np.interp(t, self.t, self.y),
            interpolate(t, self.t, self.heading),
        )

    def seen_from(self, home: Pose) -> Truth:
        """Return the truth in the frame of a home, given in the present frame."""
        return Truth(self.t, *between(home, Pose(self.x, self.y, self.heading)))


@dataclass(frozen=True)
class Drive:
    """One drive of a robot, ready for any estimator."""

    name: str
    odometry: Odometry
    sightings: Sightings
    home: dict[str, HomeBearing]
    settings: DriveSettings = field(default_factory=DriveSettings)
    truth: Truth | None = None
    remarks: dict[str, int] = field(default_factory=dict)
    """What the reader counted on the way, by reason in words: equal stamps, unknown ids."""
    known: KnownLandmarks = field(default_factory=KnownLandmarks)
    """What is known of landmarks beforehand."""

    def home_bearings(self) -> dict[str, float]:
        """Return beta* of each landmark in the robot's own home frame [rad].

        The yaw of the camera at home is taken out here; its offset from the centre is not.
        """
        yaw = self.settings.home_mount.yaw
        return {i: float(wrap(b.bearing + yaw)) for i, b in self.home.items()}

    def seen_earlier(self, by: float) -> Self:
        """Return it with all that the camera saw stamped earlier by so long [s]."""
        return replace(self, sightings=replace(self.sightings, t=self.sightings.t - by))

    @property
    def remark_lines(self) -> tuple[str, ...]:
        """The remarks for a terminal, each with its number in front."""
        return tuple(f"{number:,} {reason}" for reason, number in self.remarks.items())

    @property
    def span(self) -> tuple[float, float]:
        """First and last time [s] of odometry and sightings; (nan, nan) when there are none."""
        ends = [a[i] for a in (self.odometry.t, self.sightings.t) if a.size for i in (0, -1)]
        return (float(min(ends)), float(max(ends))) if ends else (math.nan, math.nan)
