"""Everything that makes a simulated drive, as one validated model in SI units.

Room coordinates are those in which the room, its shelves, home and way points are given; without a
room they are any frame, and home sits at its origin by default.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from homeward.control.laws import STOP_RADIUS
from homeward.drives.settings import Finite, Mount, NonNegative, Positive
from homeward.geometry.frames import Polar, Pose, between, from_polar
from homeward.io.keys import Strict

SMALLEST_SIDE = 1e-3
"""Rooms and shelves are at least this wide and deep [m]."""


def _ordered(rectangle: tuple[float, ...]) -> tuple[float, ...]:
    x_min, y_min, x_max, y_max = rectangle
    if x_max - x_min < SMALLEST_SIDE or y_max - y_min < SMALLEST_SIDE:
        raise ValueError(
            "must be [x_min, y_min, x_max, y_max] with x_min < x_max and y_min < y_max"
        )
    return rectangle


def ascending(interval: tuple[float, float]) -> tuple[float, float]:
    """Return an interval as it is, or raise ValueError when its ends are the wrong way round."""
    if interval[0] > interval[1]:
        raise ValueError("must be [least, most]")
    return interval


Rectangle = Annotated[tuple[Finite, Finite, Finite, Finite], AfterValidator(_ordered)]
"""x_min, y_min, x_max, y_max [m]."""
Interval = Annotated[tuple[NonNegative, NonNegative], AfterValidator(ascending)]
"""Least and most."""
Point = tuple[Finite, Finite]
"""x, y [m]."""
Rate = Annotated[float, Field(gt=0, le=400)]
"""[Hz]; stamps are whole milliseconds, so they must be a few apart."""


class Room(Strict):
    """A rectangular room with shelves that hide what is behind them."""

    bounds: Rectangle
    """The walls."""
    shelves: tuple[Rectangle, ...] = ()
    """As seen from above."""

    def free(self, x: float, y: float) -> bool:
        """Say whether the point (x, y) [m] lies within the walls and in no shelf."""
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
    """Landmarks all round home, as in the paper: at angles 2 pi i / count, more or less."""

    layout: Literal["ring"] = "ring"
    count: Annotated[int, Field(ge=1)] = 7
    jitter: NonNegative = 0.3
    """Each angle is off by at most this, uniformly [rad]."""
    distance: Interval = (1.0, 2.0)
    """From home, uniform [m]."""


class OnSurfaces(Strict):
    """Landmarks on the walls and shelf faces of the room, at random."""

    layout: Literal["room"] = "room"
    count: Annotated[int, Field(ge=1)] = 15
    spacing: NonNegative = 0.5
    """Least distance between two of them [m]."""


class Listed(Strict):
    """Landmarks at given places."""

    layout: Literal["listed"] = "listed"
    at: Annotated[dict[str, Point], Field(min_length=1)]
    """Id to (x, y) in room coordinates [m]."""

    @property
    def count(self) -> int:
        """How many."""
        return len(self.at)


class Moved(Strict):
    """Landmarks that stood elsewhere when home was stored: drawn (`count`) or named (`faults`)."""

    count: Annotated[int, Field(ge=0)] = 0
    fault: Interval = (0.2, 0.5)
    """Size of a drawn fault, uniform, of either sign [rad]."""
    faults: dict[str, Finite] = Field(default_factory=dict)
    """Id to fault: stored minus true bearing at the home camera [rad]."""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.count and self.faults:
            raise ValueError("either count or faults, not both")
        return self


class Visibility(Strict):
    """Which landmarks the camera sees."""

    probability: Annotated[float, Field(ge=0, le=1)] = 1.0
    """That a landmark in view is seen, each time anew; home saw all that were in view."""
    at_least: Annotated[int, Field(ge=0)] = 0
    """The paper's multi-rate p: when chance leaves fewer, more of those in view are seen."""
    field_of_view: Annotated[float, Field(gt=0, le=2 * math.pi + 1e-9)] = 2 * math.pi
    """Full opening angle around the camera's axis [rad]."""
    range: Interval = (0.0, 1000.0)
    """Least and greatest distance from the camera [m]."""
    occlusion: bool = True
    """Whether shelves hide what is behind them."""


class Noise(Strict):
    """What is wrong with the bearings."""

    bearing_sigma: NonNegative = 0.0
    """Of each sighting [rad]."""
    home_sigma: NonNegative = 0.0
    """Of each stored home bearing [rad]."""
    wrong_ids: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of sightings that carry the id of another landmark."""


class Rates(Strict):
    """How often samples are taken."""

    odometry: Rate = 20.0
    bearings: Rate = 5.0
    truth: Rate = 10.0
    jitter: NonNegative = 0.0
    """Odometry and bearings are taken, and stamped, off their regular time by at most this [s]."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.jitter > 0.4 / max(self.odometry, self.bearings):
            raise ValueError("jitter must be at most 0.4 of the shortest period")
        return self


class OdometryErrors(Strict):
    """What is wrong with the odometry: white noise, and errors that are constant in one drive."""

    speed_sigma: NonNegative = 0.0
    """[m/s/sqrt(Hz)]; times the root of the odometry rate, it is the noise of one sample."""
    turn_sigma: NonNegative = 0.0
    """[rad/s/sqrt(Hz)]"""
    speed_scale_sigma: NonNegative = 0.0
    """The constant relative error of the speed is drawn with this, unless given."""
    turn_scale_sigma: NonNegative = 0.0
    """The constant relative error of the turn rate is drawn with this, unless given."""
    turn_bias_sigma: NonNegative = 0.0
    """The constant error of the turn rate is drawn with this, unless given [rad/s]."""
    speed_scale: Finite | None = None
    turn_scale: Finite | None = None
    turn_bias: Finite | None = None


class StartPose(Strict):
    """Where the drive begins: (R, theta, alpha) from home, or (x, y, heading) in the room."""

    R: NonNegative | None = None
    theta: Finite | None = None
    alpha: Finite | None = None
    x: Finite | None = None
    y: Finite | None = None
    heading: Finite | None = None
    prior: bool = True
    """Whether the drive tells a start prior, drawn around the truth with these sigmas."""
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

    def in_home_frame(self, home: Pose) -> Pose:
        """Return the start in the frame of `home`, which is given in room coordinates."""
        if self.R is not None:
            return from_polar(Polar(self.R, self.theta, self.alpha))
        return between(home, Pose(self.x, self.y, self.heading))


class Trajectory(Strict):
    """What all ways to drive share."""

    speed: Positive = 0.3
    """[m/s]"""
    duration: Annotated[float, Field(gt=0, le=1e6)] = 600.0
    """The drive ends then, if not before [s]."""
    spin: Annotated[float, Field(ge=-math.pi, le=math.pi)] | None = None
    """It begins with a full turn on the spot at this rate [rad/s]; None: without one."""


class Homing(Trajectory):
    """Drive home by a homing law."""

    kind: Literal["homing"] = "homing"
    law: str = "lyapunov"
    """lyapunov: down the squared distance, with a proof, as `homeward live` drives; paper: turn by
    the error, at constant speed, without limits of acceleration and certainty. Both need a pose. By
    bearings and a compass (the heading of the pose) alone: alv, the average landmark vector; tron,
    the squared angles of Tron and Daniilidis; or one of another package,
    ``package.module:function`` or an entry point of homeward.laws."""
    max_turn_rate: Positive = 1.0
    """[rad/s]"""
    landmark_distance: Positive = 1.5
    """About how far landmarks are from home [m]; laws that see no distance tell by it where they
    are near enough to stop."""
    stop_radius: Positive = STOP_RADIUS
    """The drive ends where the robot is localised within this distance of home [m]."""
    drives_unlocalised: bool = False
    """Whether the robot drives by any pose; else it searches while it is not localised, or less
    certain than the limits of `homeward live` demand. The paper's law always does."""


class Circle(Trajectory):
    """Drive with constant speed and turn rate, open loop."""

    kind: Literal["circle"] = "circle"
    omega: Finite = 0.2
    """[rad/s]"""


class ByPoints(Trajectory):
    """What ways through given points share."""

    kind: Literal["waypoints", "teach"]
    points: Annotated[tuple[Point, ...], Field(min_length=1)]
    """In room coordinates [m]."""
    max_turn_rate: Positive = 1.0
    """[rad/s]"""
    end_at_home: bool = False
    """Whether home is the last point."""


class Waypoints(ByPoints):
    """Drive along the line through some points, cutting its corners smoothly."""

    kind: Literal["waypoints"] = "waypoints"
    stop_radius: Positive = STOP_RADIUS
    """The drive ends within this distance of the last point [m]."""


class Teach(ByPoints):
    """Drive from point to point by hand, and wait at each, so that it can be kept as a way point.

    The hand is `homeward.control.following`.
    """

    kind: Literal["teach"] = "teach"
    dwell: NonNegative = 3.0
    """How long to wait [s]."""


class Push(Strict):
    """Somebody carries the robot off, which its odometry does not notice."""

    at: NonNegative
    """When that happens [s]."""
    x: Finite = 0.0
    """Ahead [m]."""
    y: Finite = 0.0
    """To the left [m]."""
    turn: Finite = 0.0
    """Anti-clockwise [rad]."""


class Repeat(Trajectory):
    """Drive along a route of a place, from the closest point of entry."""

    kind: Literal["repeat"] = "repeat"
    place: str
    """The place's folder; its first home must be the scenario's."""
    version: Annotated[int, Field(ge=1)] | None = None
    """Of the place; None: the newest."""
    when: Finite | None = None
    """The day of the repeat [days since 1970]; None: the one after the place's last visit."""
    route: str
    """The route's name."""
    max_turn_rate: Positive = 1.0
    """[rad/s]"""
    push: Push | None = None
    blocked: Interval | None = None
    """When something is in the way, and the robot is told so [s]."""


class Course(Strict):
    """What is driven, whatever the robot sees on the way: every simulated drive has one."""

    name: str = "simulated"
    seed: Annotated[int, Field(ge=0)] = 0
    home: RoomPose = RoomPose()
    rates: Rates = Rates()
    odometry: OdometryErrors = OdometryErrors()
    sensor: Mount = Mount()
    home_sensor: Mount | None = None
    """The camera when home was stored; None: as `sensor`."""
    start: StartPose
    trajectory: Annotated[Homing | Circle | Waypoints | Teach | Repeat, Field(discriminator="kind")]
    estimator: str = "truth"
    """Whose pose steers the robot: the word for an estimator, or the truth."""

    @property
    def home_mount(self) -> Mount:
        """The camera's place on the robot when home was stored."""
        return self.sensor if self.home_sensor is None else self.home_sensor

    @property
    def view(self) -> float:
        """The full opening angle of the camera [rad]."""
        return math.tau


class Scenario(Course):
    """Everything that makes a simulated drive; the same scenario always makes the same drive."""

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
            raise ValueError("moved.count: more than there are landmarks")
        if self.room is not None:
            if not self.room.free(self.home.x, self.home.y):
                raise ValueError("home: outside the room or in a shelf")
            points = self.trajectory.points if isinstance(self.trajectory, ByPoints) else ()
            for i, (x, y) in enumerate(points):
                if not self.room.free(x, y):
                    raise ValueError(f"trajectory.points.{i}: outside the room or in a shelf")
        return self
