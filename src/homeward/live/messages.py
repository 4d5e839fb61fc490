"""The schema of a live session, version 1: one JSON object a line, ``type`` says what it is.

Times are seconds on the robot's clock, whatever its epoch; units and signs are as everywhere in
homeward. `schema` returns all of it as a JSON Schema.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, Field, TypeAdapter

from homeward.drives.settings import Mount, Surveyed
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.io.keys import Strict
from homeward.io.table import is_identifier
from homeward.io.validation_messages import message

VERSION = 1
LONGEST_LINE = 2**16
"""Of a message [byte]."""
MOST_LANDMARKS = 500
"""In a message."""
MAX_LENGTH = 1e4
"""Of a distance or a coordinate [m], and of an angle [rad]; the squares of the squares of larger
numbers lose the last digits of a double."""
MAX_SPEED = 100.0
"""Of a robot [m/s], [rad/s]; a larger number has another unit."""
MIN_SIGMA, MAX_SIGMA = 1e-6, 1e4
"""Of a standard deviation [m], [rad]: no sensor is better, and a worse one measures nothing."""
MAX_TIME = 1e11
"""A double resolves larger stamps to more than 15 us [s]; a larger number has another unit."""


def _identifier(text: str) -> str:
    if not is_identifier(text):
        raise ValueError("cannot be a name: printable text, trimmed")
    return text


Time = Annotated[float, Field(gt=-MAX_TIME, lt=MAX_TIME, allow_inf_nan=False)]
Bounded = Annotated[float, Field(ge=-MAX_LENGTH, le=MAX_LENGTH, allow_inf_nan=False)]
"""[m] or [rad]"""
Speed = Annotated[float, Field(ge=-MAX_SPEED, le=MAX_SPEED, allow_inf_nan=False)]
"""[m/s] or [rad/s]"""
Sigma = Annotated[float, Field(ge=MIN_SIGMA, le=MAX_SIGMA, allow_inf_nan=False)]
"""[m] or [rad]"""
Id = Annotated[str, Field(max_length=200), AfterValidator(_identifier)]
Name = Annotated[str, Field(max_length=200), AfterValidator(_identifier)]
"""Of a home, or a route."""
Bearings = Annotated[dict[Id, Bounded], Field(max_length=MOST_LANDMARKS)]
Sigmas = Annotated[dict[Id, Sigma], Field(max_length=MOST_LANDMARKS)]


class Hello(Strict):
    """The first message, both ways."""

    type: Literal["hello"] = "hello"
    version: Literal[1] = 1
    token: str | None = None
    """Where the server asks for one."""


class OdometryIn(Strict):
    """A twist that holds from `t` [s] on."""

    type: Literal["odometry"] = "odometry"
    t: Time
    v: Speed
    """Forward [m/s]."""
    omega: Speed
    """Anti-clockwise [rad/s]."""
    pose: tuple[Surveyed, Surveyed, Bounded] | None = None
    """In the robot's own odometry frame, if it has one: x [m], y [m], heading [rad]."""


class BearingsIn(Strict):
    """What the camera saw at `t` [s], nothing at all included."""

    type: Literal["bearings"] = "bearings"
    t: Time
    bearings: Bearings
    """Id to bearing from the camera's axis, anti-clockwise [rad]."""
    sigmas: Sigmas = {}
    """Standard deviations of some [rad]."""


class SetHome(Strict):
    """What the camera saw at home; the map begins anew."""

    type: Literal["home"] = "home"
    bearings: Bearings
    sigmas: Sigmas = {}
    name: Name = "home"


class StoreHome(Strict):
    """Home is here: what is seen now, standing, is stored, or what was seen since `LookRound`.

    The map begins anew.

    In a place it is one home more, stored without standing, and the map goes on.
    """

    type: Literal["store_home"] = "store_home"
    name: Name = "home"


class LookRound(Strict):
    """Home is here: what is seen until `StoreHome` is home's; the robot turns, but stays."""

    type: Literal["look_round"] = "look_round"


class TurnHome(Strict):
    """Home is here: turn round once, and store what is seen meanwhile; the map begins anew."""

    type: Literal["turn_home"] = "turn_home"
    name: Name = "home"


class GoHome(Strict):
    """Drive home; to one of another name, the map begins anew, but in a place."""

    type: Literal["go_home"] = "go_home"
    name: Name | None = None


class GoTo(Strict):
    """Drive to a point of the home frame."""

    type: Literal["go_to"] = "go_to"
    x: Bounded
    """[m]"""
    y: Bounded
    """[m]"""


class GoToLandmark(Strict):
    """Drive to a landmark, until it is so near."""

    type: Literal["go_to_landmark"] = "go_to_landmark"
    name: Id
    standoff: Annotated[float, Field(ge=0, le=MAX_LENGTH, allow_inf_nan=False)] = 0.5
    """[m]"""


class BeginRoute(Strict):
    """A route begins here; else it begins with the visit."""

    type: Literal["begin_route"] = "begin_route"


class StoreRoute(Strict):
    """The way since a route was begun is one of the place, and ends here."""

    type: Literal["store_route"] = "store_route"
    name: Name


class FollowRoute(Strict):
    """Drive along a route of the place, from the closest point of entry."""

    type: Literal["follow_route"] = "follow_route"
    name: Name


class SavePlace(Strict):
    """Merge what came since the map was begun into the place, now and not at the end only."""

    type: Literal["save_place"] = "save_place"


class Cancel(Strict):
    """Stand, and think no more of driving home."""

    type: Literal["cancel"] = "cancel"


class EStop(Strict):
    """Emergency stop; while engaged nothing moves, and after it `GoHome` must be said anew."""

    type: Literal["estop"] = "estop"
    engaged: bool


class Obstacle(Strict):
    """How far the way ahead is free; once told, it must be told on."""

    type: Literal["obstacle"] = "obstacle"
    distance: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    """[m]"""


class StartIn(Strict):
    """About where the robot is in the home frame; the map begins anew."""

    type: Literal["start"] = "start"
    x: Bounded
    y: Bounded
    heading: Bounded
    sigma: Sigma = 0.1
    """Of x and y [m]."""
    sigma_heading: Sigma = 0.1
    """[rad]"""


class MountIs(Mount):
    """Camera extrinsics on the robot; the map begins again."""

    type: Literal["mount"] = "mount"
    x: Bounded = 0.0
    y: Bounded = 0.0
    yaw: Bounded = 0.0


class Reset(Strict):
    """The map begins anew, anywhere."""

    type: Literal["reset"] = "reset"


class Answer(Strict):
    """The answer to bearings, an `Estimate`."""

    type: Literal["estimate"] = "estimate"
    t: float
    status: Status
    reason: str
    pose: tuple[float, float, float] | None = None
    """x [m], y [m], heading [rad] in the home frame."""
    covariance: tuple[float, ...] | None = None
    """Of x, y, heading: xx, xy, xh, yy, yh, hh."""


class Command(Strict):
    """What to drive; a robot that hears none for `hold` must stand."""

    type: Literal["command"] = "command"
    v: float
    """[m/s]"""
    omega: float
    """[rad/s]"""
    state: Literal["driving", "held", "arrived", "turned", "failed"]
    reason: str
    """In words that stay the same while the reason lasts."""
    value: float | None = None
    """The number that goes with the reason: a time [s], or a distance or standard deviation [m]."""
    hold: float
    """[s]"""


class LandmarkOut(Strict):
    """A landmark, as `LandmarkEstimate`; None where nothing is known."""

    landmark: str
    x: float | None = None
    y: float | None = None
    moved_probability: float | None = None


class LandmarksOut(Strict):
    """What is known of all landmarks, once a second."""

    type: Literal["landmarks"] = "landmarks"
    landmarks: tuple[LandmarkOut, ...]


class Diagnostics(Strict):
    """How the session is, once a second."""

    type: Literal["diagnostics"] = "diagnostics"
    status: Status
    reason: str
    homing: str
    """State and reason."""
    faults: tuple[str, ...]
    """What keeps the robot from driving by itself."""
    values: dict[str, float] = {}
    """The number that goes with a fault, in the unit of its limit."""
    counts: dict[str, int]
    """Samples not used, by reason."""
    waiting: int
    """Samples in the queue."""
    work_ms: float
    """The longest of the last second's samples took the estimator so long [ms]."""


class EventOut(Strict):
    """Something was done, in words, or could not be."""

    type: Literal["event", "error"]
    text: str


Input = (
    Hello
    | OdometryIn
    | BearingsIn
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
    | StartIn
    | MountIs
    | Reset
)
Departure = GoHome | GoTo | GoToLandmark | FollowRoute
"""What sends the robot somewhere."""
Output = Hello | Answer | Command | LandmarksOut | Diagnostics | EventOut
Message = TypeVar("Message")
_IN: TypeAdapter[Input] = TypeAdapter(Annotated[Input, Field(discriminator="type")])
_OUT: TypeAdapter[Output] = TypeAdapter(Annotated[Output, Field(discriminator="type")])


def parse(line: bytes | str) -> Input:
    """Return the message in a line; `InputError` says in one line what is wrong with it."""
    return _parsed(_IN, line)


def parse_output(line: bytes | str) -> Output:
    """Return what a session said in a line; errors as `parse`."""
    return _parsed(_OUT, line)


def line_of(message: Input | Output) -> str:
    """Return a message as a line; every float comes back to the last bit."""
    return message.model_dump_json(exclude_none=True) + "\n"


def schema() -> dict[str, Any]:
    """Return the JSON Schema of everything that goes in and comes out."""
    return {"version": VERSION, "in": _IN.json_schema(), "out": _OUT.json_schema()}


def _parsed(adapter: TypeAdapter[Message], line: bytes | str) -> Message:
    if len(line) > LONGEST_LINE:
        raise InputError(f"a message of more than {LONGEST_LINE:,} bytes")
    return message(adapter, line)
