"""Messages of a live session, version 1: one JSON object per line, of kind ``type``.

Times are seconds on the robot's clock with any epoch; units and signs are those of homeward.
`schema` returns the JSON Schema.
"""

from __future__ import annotations

import inspect
from typing import Annotated, Any, Literal

from homeward.drives.landmarks import Surveyed
from homeward.drives.settings import Mount, Offset, Turn
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.io.checks import AfterValidator, BeforeValidator, Field, json_schema
from homeward.io.models import Strict
from homeward.io.settings import parsed
from homeward.io.table import is_identifier
from homeward.sighting_keys import keyed

VERSION = 1
MAX_LINE = 2**16
"""Maximum length of a message [byte]."""
MAX_LANDMARKS = 500
"""Maximum number of landmarks in a message."""
MAX_LENGTH = 1e4
"""Maximum distance or coordinate [m], and angle [rad]; fourth powers of larger numbers lose the
last digits of a double."""
MAX_SPEED = 100.0
"""Maximum speed of a robot [m/s], [rad/s]; a larger number is in another unit."""
MIN_SIGMA, MAX_SIGMA = 1e-6, 1e4
"""Limits of a standard deviation [m], [rad]: no sensor is better, and a worse one is useless."""
MAX_TIME = 1e11
"""Maximum stamp [s]: doubles resolve larger ones to more than 15 us; they are in another unit."""


def _identifier(text: str) -> str:
    if not is_identifier(text):
        raise ValueError("not a name: must be printable, without spaces at its ends")
    return text


Time = Annotated[float, Field(gt=-MAX_TIME, lt=MAX_TIME, allow_inf_nan=False)]
Bounded = Annotated[float, Field(ge=-MAX_LENGTH, le=MAX_LENGTH, allow_inf_nan=False)]
"""[m] or [rad]"""
Speed = Annotated[float, Field(ge=-MAX_SPEED, le=MAX_SPEED, allow_inf_nan=False)]
"""[m/s] or [rad/s]"""
Sigma = Annotated[float, Field(ge=MIN_SIGMA, le=MAX_SIGMA, allow_inf_nan=False)]
"""[m] or [rad]"""
Range = Annotated[float, Field(gt=0, le=MAX_LENGTH, allow_inf_nan=False)]
"""[m]"""
Id = Annotated[str, Field(max_length=200), AfterValidator(_identifier)]
Name = Annotated[str, Field(max_length=200), AfterValidator(_identifier)]
"""Name of a home or a route."""
_LIMITS = Field(max_length=MAX_LANDMARKS), BeforeValidator(keyed)
Bearings = Annotated[dict[Id, Bounded], *_LIMITS]
"""By landmark id; of landmarks without ids lists, by ``class:NAME`` or an empty key."""
Ranges = Annotated[dict[Id, Range], *_LIMITS]
Sigmas = Annotated[dict[Id, Sigma], *_LIMITS]


class LiveMessage(Strict):
    """A message; the class has the value of its key `type`."""

    type: str

    def __init_subclass__(cls, type: str = "", **options: Any) -> None:
        if type:
            cls.__annotations__ = {"type": Literal[type]} | inspect.get_annotations(cls)
            cls.type = type
        super().__init_subclass__(**options)


class Hello(LiveMessage, type="hello"):
    """First message in both directions."""

    version: Literal[1] = 1
    token: str | None = None
    """Required if the server has a token."""


class OdometryIn(LiveMessage, type="odometry"):
    """Twist that is valid from `t` [s] on."""

    t: Time
    v: Speed
    """Forward [m/s]."""
    omega: Speed
    """Anti-clockwise [rad/s]."""
    vy: Speed = 0.0
    """To the left [m/s]."""
    pose: tuple[Surveyed, Surveyed, Bounded] | None = None
    """Pose in the robot's own odometry frame, if it has one: x [m], y [m], heading [rad]."""


class BearingsIn(LiveMessage, type="bearings"):
    """Bearings at `t` [s]; send an empty one if no landmark is in view."""

    t: Time
    bearings: Bearings
    """Bearing from the camera's axis, anti-clockwise, by landmark id [rad]; of landmarks without
    ids a list by ``class:NAME``, or by an empty key."""
    sigmas: Sigmas = {}
    """Standard deviations of some bearings [rad]."""
    ranges: Ranges = {}
    """Measured distances of some landmarks from the camera, a hint [m]."""
    range_sigmas: Sigmas = {}
    """Standard deviations of some ranges [m]."""
    elevations: Bearings = {}
    """Elevations of some landmarks above the horizontal plane of the camera, for `TiltIn` [rad]."""
    camera: Name | Literal[""] = ""
    """Name of one of several cameras, as under `cameras` of the robot; empty for the first."""


class TiltIn(LiveMessage, type="tilt"):
    """Roll and pitch of the robot at `t` [s], for which bearings are corrected."""

    t: Time
    roll: Bounded
    """Positive: its left side is raised [rad]."""
    pitch: Bounded
    """Positive: its front is lowered [rad]."""


class SetHome(LiveMessage, type="home"):
    """Home bearings; the map begins again."""

    bearings: Bearings
    sigmas: Sigmas = {}
    name: Name = "home"


class StoreHome(LiveMessage, type="store_home"):
    """Store home here: bearings of a robot at rest, or those since `LookRound`; a new map begins.

    In a place it is a further home, stored also while driving, and the map continues.
    """

    name: Name = "home"


class LookRound(LiveMessage, type="look_round"):
    """Home is here: capture bearings until `StoreHome`; the robot may turn on the spot."""


class TurnHome(LiveMessage, type="turn_home"):
    """Home is here: turn once on the spot and store the bearings; the map begins again."""

    name: Name = "home"


class GoHome(LiveMessage, type="go_home"):
    """Drive home; to another home the map begins again, except in a place."""

    name: Name | None = None
    dock: bool = False
    """Whether to reach its heading, too, along its axis."""


class GoTo(LiveMessage, type="go_to"):
    """Drive to a point in the home frame."""

    x: Bounded
    """[m]"""
    y: Bounded
    """[m]"""


class GoToLandmark(LiveMessage, type="go_to_landmark"):
    """Drive to a landmark, up to a distance of `standoff`."""

    name: Id
    standoff: Annotated[float, Field(ge=0, le=MAX_LENGTH, allow_inf_nan=False)] = 0.5
    """[m]"""


class BeginRoute(LiveMessage, type="begin_route"):
    """Begin a route here, instead of at the begin of the visit."""


class StoreRoute(LiveMessage, type="store_route"):
    """Store the path since the begin of the route as a route of the place."""

    name: Name


class FollowRoute(LiveMessage, type="follow_route"):
    """Drive along a route of the place, from its closest point."""

    name: Name


class SavePlace(LiveMessage, type="save_place"):
    """Merge the visit since the map was begun into the place now, not only at the end."""


class Cancel(LiveMessage, type="cancel"):
    """Stop, and cancel the goal."""


class EStop(LiveMessage, type="estop"):
    """Emergency stop: no motion while engaged; afterwards a goal must be sent again."""

    engaged: bool


class Obstacle(LiveMessage, type="obstacle"):
    """Free distance ahead; after the first message the robot needs them continuously to drive."""

    distance: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    """[m]"""


class SetStart(LiveMessage, type="start"):
    """Approximate pose of the robot in the home frame; the map begins again."""

    x: Bounded
    y: Bounded
    heading: Bounded
    sigma: Sigma = 0.1
    """Standard deviation of x and y [m]."""
    sigma_heading: Sigma = 0.1
    """[rad]"""


class SetExtrinsics(Mount, LiveMessage, type="mount"):
    """Extrinsics of a camera on the robot; the map is reset, unless it is a new camera."""

    x: Offset = 0.0
    y: Offset = 0.0
    yaw: Turn = 0.0
    camera: Name | Literal[""] = ""
    """As in `BearingsIn`."""


class Reset(LiveMessage, type="reset"):
    """Begin the map again, with the robot anywhere."""


class EstimateOut(LiveMessage):
    """An `Estimate`."""

    t: float
    status: Status
    reason: str
    pose: tuple[float, float, float] | None = None
    """x [m], y [m], heading [rad] in the home frame."""
    covariance: tuple[float, ...] | None = None
    """Covariance of x, y, heading: xx, xy, xh, yy, yh, hh."""
    accuracy: tuple[float, float, float] | None = None
    """Standard deviations of position [m] and heading [rad], and the radius that contains the
    position with a probability of 99.9 % [m]."""


class Answer(EstimateOut, type="estimate"):
    """Answer to bearings: the causal estimate."""


class Smoothed(EstimateOut, type="smoothed"):
    """Estimate of an earlier answer, with its stamp, smoothed with later data."""


class Command(LiveMessage, type="command"):
    """Velocity command; a robot that receives no command for `hold` must stop."""

    v: float
    """[m/s]"""
    omega: float
    """[rad/s]"""
    vy: float = 0.0
    """To the left, where `limits.sideways` is given [m/s]."""
    state: Literal["driving", "held", "arrived", "turned", "failed"]
    reason: str
    """Text that is constant while the reason lasts."""
    value: float | None = None
    """Value that belongs to the reason: a time [s], or a distance or standard deviation [m]."""
    hold: float
    """[s]"""


class LandmarkOut(Strict):
    """Estimate of a landmark, as `LandmarkEstimate`; None where unknown."""

    landmark: str
    x: float | None = None
    y: float | None = None
    moved_probability: float | None = None


class LandmarksOut(LiveMessage, type="landmarks"):
    """Estimates of all landmarks, once a second."""

    landmarks: tuple[LandmarkOut, ...]


class Diagnostics(LiveMessage, type="diagnostics"):
    """State of the session, once a second."""

    status: Status
    reason: str
    homing: str
    """State and reason."""
    is_accurate: bool
    """Whether there is a pose, and its standard deviation is within `largest_sigma`."""
    can_home: bool
    """Whether a drive home could begin now."""
    cannot_home: str = ""
    """Why it could not; empty if it could."""
    advice: str = ""
    """Motion that brings a pose soonest, for the driver; empty where there is a pose."""
    faults: tuple[str, ...]
    """Reasons why the robot is held."""
    values: dict[str, float] = {}
    """Value of each fault, in the unit of its limit."""
    notes: tuple[str, ...] = ()
    """Assumptions and findings of the estimator that the user must read."""
    counts: dict[str, int]
    """Samples not used, by reason."""
    waiting: int
    """Number of samples in the queue."""
    work_ms: float
    """Maximum time of the estimator for one sample in the last second [ms]."""


class PlaceChanged(LiveMessage, type="place_changed"):
    """Not a message of a client: other robots changed the place, or its server is lost."""

    text: str
    is_error: bool = False


class EventOut(LiveMessage):
    """Report of an action, or of an error."""

    type: Literal["event", "error"]
    text: str


Input = (
    Hello
    | OdometryIn
    | BearingsIn
    | TiltIn
    | SetHome
    | StoreHome
    | LookRound
    | TurnHome
    | GoHome
    | GoTo
    | GoToLandmark
    | BeginRoute
    | StoreRoute
    | FollowRoute
    | SavePlace
    | Cancel
    | EStop
    | Obstacle
    | SetStart
    | SetExtrinsics
    | Reset
)
GoalMessage = GoHome | GoTo | GoToLandmark | FollowRoute
"""Messages that give the robot a goal."""
Output = Hello | Answer | Smoothed | Command | LandmarksOut | Diagnostics | EventOut
_IN = Annotated[Input, Field(discriminator="type")]
_OUT = Annotated[Output, Field(discriminator="type")]


def parse(line: bytes | str) -> Input:
    """Return the message in a line; `InputError` with a one-line text where it is invalid."""
    message: Input = _parsed(_IN, line)
    return message


def parse_output(line: bytes | str) -> Output:
    """Return the output message in a line; errors as `parse`."""
    message: Output = _parsed(_OUT, line)
    return message


def line_of(message: Strict) -> str:
    """Return a message as a line; floats are exact."""
    return message.model_dump_json(exclude_none=True) + "\n"


def schema() -> dict[str, Any]:
    """Return the JSON Schema of all input and output messages."""
    return {"version": VERSION, "in": json_schema(_IN), "out": json_schema(_OUT)}


def _parsed(kind: Any, line: bytes | str) -> Any:
    if len(line) > MAX_LINE:
        raise InputError(f"a message of more than {MAX_LINE:,} bytes")
    return parsed(kind, line)
