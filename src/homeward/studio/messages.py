"""What the page may ask for; anything else is refused in one line."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, TypeAdapter

from homeward.drives.settings import Delay
from homeward.io.keys import Strict
from homeward.io.validation_messages import message
from homeward.lab.simulation.scenario import Scenario

LONGEST = 2**20
"""Of a message [byte]; a whole scene is the longest."""
LARGEST = 1e4
"""Of a place or a length [m], and of any other number of a scene; larger ones overflow."""
Bounded = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
"""[m] or [rad]"""
Name = Annotated[str, Field(min_length=1, max_length=200)]


class Hello(Strict):
    """The first message."""

    do: Literal["hello"]
    token: str


class Move(Strict):
    """Put a landmark, home or the robot somewhere, in room coordinates."""

    do: Literal["move"]
    what: Literal["landmark", "home", "robot"]
    name: str = ""
    x: Bounded
    y: Bounded
    heading: Bounded | None = None
    """None: as it was [rad]."""
    stroke: int = 0
    """Moves of one stroke are undone together."""


class Add(Strict):
    """Put up a landmark that home knew; the drive begins again."""

    do: Literal["add"]
    x: Bounded
    y: Bounded


class Remove(Strict):
    """Take a landmark away; the drive begins again."""

    do: Literal["remove"]
    name: str


class Set(Strict):
    """Give a key of the scenario another value, at once."""

    do: Literal["set"]
    key: Literal[
        "noise.bearing_sigma",
        "noise.wrong_ids",
        "visibility.probability",
        "visibility.field_of_view",
        "visibility.range",
        "sensor.x",
        "sensor.y",
        "sensor.yaw",
    ]
    value: Bounded | tuple[Bounded, Bounded]
    stroke: int = 0


class Steer(Strict):
    """Say who drives: keys, a law, the scene's path, or nobody."""

    do: Literal["steer"]
    by: Literal["keys", "law", "path", "nobody"]
    law: Literal["paper", "lyapunov", "alv", "tron"] = "paper"
    believing: str = "truth"
    """Whose pose a law or a path steers by: the word for an estimator, or the truth."""


class Keys(Strict):
    """What the keys say now; to be repeated while they are held."""

    do: Literal["keys"]
    v: Annotated[float, Field(ge=-1, le=1)]
    """Of the scene's speed."""
    omega: Annotated[float, Field(ge=-1, le=1)]
    """Of the fastest turn by keys."""


class Estimators(Strict):
    """Let others run side by side; the drive begins again."""

    do: Literal["estimators"]
    names: Annotated[tuple[Name, ...], Field(max_length=6)]


class Pace(Strict):
    """Play so many times as fast as time goes by; 0: stand still."""

    do: Literal["pace"]
    pace: Annotated[float, Field(ge=0, le=10)]


class Open(Strict):
    """Play another scene."""

    do: Literal["open"]
    scene: Scenario


class Plain(Strict):
    """Begin again, undo, show the worlds that look the same, or save."""

    do: Literal["again", "undo", "worlds", "save"]


class Adjust(Strict):
    """Run an opened drive otherwise."""

    do: Literal["adjust"]
    x: Bounded = 0.0
    y: Bounded = 0.0
    yaw: Bounded = 0.0
    bearings_late: Delay = 0.0
    bearing_sigma: Annotated[float, Field(gt=0, le=1)] | None = None
    moved: tuple[str, ...] = ()
    stroke: int = 0


Asked = Hello | Move | Add | Remove | Set | Steer | Keys | Estimators | Pace | Open | Plain | Adjust
_ASKED: TypeAdapter[Asked] = TypeAdapter(Annotated[Asked, Field(discriminator="do")])


def parse(text: str | bytes) -> Asked:
    """Return what a message asks for; else raise InputError."""
    return message(_ASKED, text)
