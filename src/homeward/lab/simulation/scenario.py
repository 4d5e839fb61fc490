"""Settings of a simulated drive, as one validated model in SI units.

Room coordinates are the frame of the room, its shelves, home and way points. Home is at the origin
by default.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np

from homeward.control.laws import STOP_RADIUS
from homeward.drives.settings import Finite, Mount, NonNegative, Positive
from homeward.geometry.frames import Polar, Pose, between, from_polar
from homeward.io.checks import AfterValidator, Field
from homeward.io.models import Strict, model_validator

MIN_SIDE_M = 1e-3
"""Minimum width and depth of rooms and shelves."""


def _ordered(rectangle: tuple[float, ...]) -> tuple[float, ...]:
    x_min, y_min, x_max, y_max = rectangle
    if x_max - x_min < MIN_SIDE_M or y_max - y_min < MIN_SIDE_M:
        raise ValueError(
            "must be [x_min, y_min, x_max, y_max] with x_min < x_max and y_min < y_max"
        )
    return rectangle


def ascending(interval: tuple[float, float]) -> tuple[float, float]:
    """Return an interval, or raise ValueError when its minimum exceeds its maximum."""
    if interval[0] > interval[1]:
        raise ValueError("must be [minimum, maximum]")
    return interval


Rectangle = Annotated[tuple[Finite, Finite, Finite, Finite], AfterValidator(_ordered)]
"""x_min, y_min, x_max, y_max [m]."""
Interval = Annotated[tuple[NonNegative, NonNegative], AfterValidator(ascending)]
"""Minimum and maximum."""
Point = tuple[Finite, Finite]
"""x, y [m]."""
Rate = Annotated[float, Field(gt=0, le=400)]
"""[Hz]; stamps are whole milliseconds, and must differ by more than that."""


class Room(Strict):
    """A rectangular room with opaque shelves."""

    bounds: Rectangle
    """The walls."""
    shelves: tuple[Rectangle, ...] = ()
    """Seen from above."""

    def free(self, x: float, y: float) -> bool:
        """Whether the point (x, y) [m] is within the walls and in no shelf."""
        return _inside(self.bounds, x, y) and not any(_inside(s, x, y) for s in self.shelves)


def _inside(rectangle: tuple[float, float, float, float], x: float, y: float) -> bool:
    x_min, y_min, x_max, y_max = rectangle
    return x_min <= x <= x_max and y_min <= y <= y_max


class RoomPose(Strict):
    """A pose in room coordinates."""

    x: Finite = 0.0
    y: Finite = 0.0
    heading: Finite = 0.0
    """[rad]"""

    @property
    def pose(self) -> Pose:
        """As (x [m], y [m], heading [rad])."""
        return Pose(self.x, self.y, self.heading)


class Ring(Strict):
    """Landmarks all round home at angles of about 2 pi i / count, as in the paper."""

    layout: Literal["ring"] = "ring"
    count: Annotated[int, Field(ge=1)] = 7
    jitter: NonNegative = 0.3
    """Maximum error of each angle, uniform [rad]."""
    distance: Interval = (1.0, 2.0)
    """From home, uniform [m]."""


class OnSurfaces(Strict):
    """Landmarks on the walls and shelf faces of the room, at random."""

    layout: Literal["room"] = "room"
    count: Annotated[int, Field(ge=1)] = 15
    spacing: NonNegative = 0.5
    """Minimum distance between two of them [m]."""


class Listed(Strict):
    """Landmarks at given positions."""

    layout: Literal["listed"] = "listed"
    at: Annotated[dict[str, Point], Field(min_length=1)]
    """Id to (x, y) in room coordinates [m]."""

    @property
    def count(self) -> int:
        """Number of landmarks."""
        return len(self.at)


class Moved(Strict):
    """Landmarks that have moved since home was stored: drawn (`count`) or named (`faults`)."""

    count: Annotated[int, Field(ge=0)] = 0
    fault: Interval = (0.2, 0.5)
    """Size of a drawn fault, uniform, with random sign [rad]."""
    faults: dict[str, Finite] = {}
    """Id to fault: stored minus true bearing at the home camera [rad]."""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.count and self.faults:
            raise ValueError("either count or faults, not both")
        return self


class Visibility(Strict):
    """Which landmarks the camera sees."""

    probability: Annotated[float, Field(ge=0, le=1)] = 1.0
    """Of a sighting of a landmark in view, in each frame; home saw all landmarks in view."""
    at_least: Annotated[int, Field(ge=0)] = 0
    """Minimum number of sightings in a frame, if that many are in view: the paper's p."""
    field_of_view: Annotated[float, Field(gt=0, le=2 * math.pi + 1e-9)] = 2 * math.pi
    """Full opening angle around the camera's axis [rad]."""
    range: Interval = (0.0, 1000.0)
    """Minimum and maximum distance from the camera [m]."""
    occlusion: bool = True
    """Whether shelves hide landmarks behind them."""


class Noise(Strict):
    """Errors of the bearings."""

    bearing_sigma: NonNegative = 0.0
    """Of each sighting [rad]."""
    home_sigma: NonNegative = 0.0
    """Of each stored home bearing [rad]."""
    wrong_ids: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of sightings with the id of another landmark."""


class Rates(Strict):
    """Rates of the samples."""

    odometry: Rate = 20.0
    bearings: Rate = 5.0
    truth: Rate = 10.0
    jitter: NonNegative = 0.0
    """Maximum offset of odometry and bearings from their regular stamps [s]."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.jitter > 0.4 / max(self.odometry, self.bearings):
            raise ValueError("jitter must be at most 0.4 of the shortest period")
        return self


class OdometryErrors(Strict):
    """Errors of the odometry: white noise, and errors that are constant in one drive."""

    speed_sigma: NonNegative = 0.0
    """[m/s/sqrt(Hz)]; one sample has this times the root of the odometry rate."""
    turn_sigma: NonNegative = 0.0
    """[rad/s/sqrt(Hz)]"""
    speed_scale_sigma: NonNegative = 0.0
    """Of the constant relative error of the speed, which is drawn unless given."""
    turn_scale_sigma: NonNegative = 0.0
    """Of the constant relative error of the yaw rate, which is drawn unless given."""
    turn_bias_sigma: NonNegative = 0.0
    """Of the constant error of the yaw rate, which is drawn unless given [rad/s]."""
    sideways_sigma: NonNegative | None = None
    """As `speed_sigma`, of the speed to the left of a robot that moves sideways; None: the same."""
    sideways_scale_sigma: NonNegative | None = None
    """Of the constant relative error of that speed, in addition to that of the speed; None: 0."""
    speed_scale: Finite | None = None
    turn_scale: Finite | None = None
    turn_bias: Finite | None = None
    sideways_scale: Finite | None = None


class StartPose(Strict):
    """Start of the drive: (R, theta, alpha) from home, or (x, y, heading) in the room."""

    R: NonNegative | None = None
    theta: Finite | None = None
    alpha: Finite | None = None
    x: Finite | None = None
    y: Finite | None = None
    heading: Finite | None = None
    prior: bool = True
    """Whether the drive has a start prior, drawn around the true start with these sigmas."""
    sigma_R: Positive = 0.05
    sigma_theta: Positive = 0.1
    sigma_alpha: Positive = 0.1

    @model_validator(mode="after")
    def _one_triple(self) -> Self:
        polar, room = (self.R, self.theta, self.alpha), (self.x, self.y, self.heading)
        whole, empty = (polar, room) if None not in polar else (room, polar)
        if None in whole or any(value is not None for value in empty):
            raise ValueError("give R, theta and alpha, or x, y and heading")
        return self

    @property
    def sigmas(self) -> np.ndarray:
        """Standard deviations of the prior's R [m], theta, alpha [rad], (3,)."""
        return np.array([self.sigma_R, self.sigma_theta, self.sigma_alpha])

    def in_home_frame(self, home: Pose) -> Pose:
        """Return the start in the frame of `home`, which is given in room coordinates."""
        if self.R is not None:
            return from_polar(Polar(self.R, self.theta, self.alpha))
        return between(home, Pose(self.x, self.y, self.heading))


class Trajectory(Strict):
    """Settings of all trajectories."""

    speed: Positive = 0.3
    """[m/s]"""
    duration: Annotated[float, Field(gt=0, le=1e6)] = 600.0
    """Maximum duration of the drive [s]."""
    spin: Annotated[float, Field(ge=-math.pi, le=math.pi)] | None = None
    """Rate of a full rotation on the spot at the start [rad/s]; None: without one."""


class Homing(Trajectory):
    """Drive home by a homing law."""

    kind: Literal["homing"] = "homing"
    law: str = "lyapunov"
    """With a pose: lyapunov, the law of `homeward live` with proved convergence; paper, at constant
    speed without limits of acceleration and uncertainty. With bearings and a compass (the heading
    of the pose) only: alv, the average landmark vector; tron, the squared angles of Tron and
    Daniilidis; ``package.module:function``, or an entry point of homeward.laws."""
    max_turn_rate: Positive = 1.0
    """[rad/s]"""
    landmark_distance: Positive = 1.5
    """Approximate distance of landmarks from home [m], from which bearing-only laws derive where
    to stop."""
    stop_radius: Positive = STOP_RADIUS
    """The drive ends when the robot is localised within this distance of home [m]."""
    drives_unlocalised: bool = False
    """Whether the robot drives with any pose, as the paper's law always does; otherwise it searches
    while it is not localised, or while the covariance exceeds the limits of `homeward live`."""


class Circle(Trajectory):
    """Drive with constant speed and yaw rate, open loop."""

    kind: Literal["circle"] = "circle"
    omega: Finite = 0.2
    """[rad/s]"""


class ByPoints(Trajectory):
    """Settings of trajectories through given points."""

    kind: Literal["waypoints", "teach"]
    points: Annotated[tuple[Point, ...], Field(min_length=1)]
    """In room coordinates [m]."""
    max_turn_rate: Positive = 1.0
    """[rad/s]"""
    end_at_home: bool = False
    """Whether home is the last point."""


class Waypoints(ByPoints):
    """Drive along the line through the points, with smoothly cut corners."""

    kind: Literal["waypoints"] = "waypoints"
    stop_radius: Positive = STOP_RADIUS
    """The drive ends within this distance of the last point [m]."""


class Teach(ByPoints):
    """Drive from point to point with `homeward.control.following`, and wait at each point.

    Each stop becomes a way point of the taught route.
    """

    kind: Literal["teach"] = "teach"
    dwell: NonNegative = 3.0
    """Waiting time at each point [s]."""


class Push(Strict):
    """The robot is carried elsewhere (kidnapped); odometry does not measure it."""

    at: NonNegative
    """Time [s]."""
    x: Finite = 0.0
    """Ahead [m]."""
    y: Finite = 0.0
    """To the left [m]."""
    turn: Finite = 0.0
    """Anti-clockwise [rad]."""


class Repeat(Trajectory):
    """Drive along a route of a place, from its closest point."""

    kind: Literal["repeat"] = "repeat"
    place: str
    """The place's folder; its first home must be the scenario's."""
    version: Annotated[int, Field(ge=1)] | None = None
    """Version of the place; None: the newest."""
    when: Finite | None = None
    """The day of the repeat [days since 1970]; None: the one after the place's last visit."""
    route: str
    """The route's name."""
    max_turn_rate: Positive = 1.0
    """[rad/s]"""
    push: Push | None = None
    blocked: Interval | None = None
    """Interval in which an obstacle is reported [s]."""


class Robot(Strict):
    """The robot's chassis. One that moves sideways drives the same path with another heading."""

    drive: Literal["differential", "mecanum", "omni"] = "differential"
    """With differential drive the robot looks where it drives; with mecanum wheels it keeps its
    first heading, so that it strafes; with omni wheels or a swerve drive it turns as it drives."""
    yaw_rate: Finite = 0.2
    """Yaw rate of a robot with omni wheels as it drives [rad/s]."""
    sway: NonNegative = 0.0
    """Amplitude of a sideways speed to and fro twice a second, as of legs [m/s]."""


class Course(Strict):
    """Settings of every simulated drive, independent of the camera model."""

    name: str = "simulated"
    seed: Annotated[int, Field(ge=0)] = 0
    home: RoomPose = RoomPose()
    rates: Rates = Rates()
    robot: Robot = Robot()
    odometry: OdometryErrors = OdometryErrors()
    sensor: Mount = Mount()
    home_sensor: Mount | None = None
    """The camera when home was stored; None: as `sensor`."""
    start: StartPose
    trajectory: Annotated[Homing | Circle | Waypoints | Teach | Repeat, Field(discriminator="kind")]
    estimator: str = "truth"
    """Source of the pose that steers the robot: an estimator, or ``truth``."""

    @property
    def home_mount(self) -> Mount:
        """The camera extrinsics when home was stored."""
        return self.sensor if self.home_sensor is None else self.home_sensor

    @property
    def view(self) -> float:
        """The full opening angle of the camera [rad]."""
        return math.tau


class Scenario(Course):
    """Settings of a simulated drive; the same scenario always gives the same drive."""

    room: Room | None = None
    landmarks: Annotated[Ring | OnSurfaces | Listed, Field(discriminator="layout")]
    moved: Moved = Moved()
    visibility: Visibility = Visibility()
    noise: Noise = Noise()

    @property
    def view(self) -> float:
        """The full opening angle of the camera [rad]."""
        return self.visibility.field_of_view

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.landmarks.layout == "room" and self.room is None:
            raise ValueError("landmarks.layout: room needs a room")
        if self.moved.count > self.landmarks.count:
            raise ValueError("moved.count: larger than landmarks.count")
        if self.room is not None:
            if not self.room.free(self.home.x, self.home.y):
                raise ValueError("home: outside the room or in a shelf")
            points = self.trajectory.points if isinstance(self.trajectory, ByPoints) else ()
            for i, (x, y) in enumerate(points):
                if not self.room.free(x, y):
                    raise ValueError(f"trajectory.points.{i}: outside the room or in a shelf")
        return self
