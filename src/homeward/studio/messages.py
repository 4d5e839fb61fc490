"""Requests of the page; anything else is an InputError."""

from __future__ import annotations

from typing import Annotated, Literal

from homeward.io.checks import Field
from homeward.io.models import Strict
from homeward.io.settings import parsed
from homeward.lab.simulation.scenario import Scenario

MAX_MESSAGE = 2**20
"""Length of a message [byte]; a whole scene is the longest."""
MAX_NUMBER = 1e4
"""Maximum of coordinates and lengths [m], and of other numbers of a scene, against overflow."""
Bounded = Annotated[float, Field(ge=-MAX_NUMBER, le=MAX_NUMBER)]
"""[m] or [rad]"""
Name = Annotated[str, Field(min_length=1, max_length=200)]


class Hello(Strict):
    """The first message."""

    do: Literal["hello"]
    token: str


class Move(Strict):
    """Move a landmark, home or the robot, in room coordinates."""

    do: Literal["move"]
    what: Literal["landmark", "home", "robot"]
    name: str = ""
    x: Bounded
    y: Bounded
    heading: Bounded | None = None
    """None: unchanged [rad]."""
    stroke: int = 0
    """Changes of one stroke are undone together."""


class Add(Strict):
    """Add a landmark with a home bearing; the drive restarts."""

    do: Literal["add"]
    x: Bounded
    y: Bounded


class Remove(Strict):
    """Remove a landmark; the drive restarts."""

    do: Literal["remove"]
    name: str


class Set(Strict):
    """Change a key of the scenario during the drive."""

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
    """Choose the control: keys, a law, the scene's path, or none."""

    do: Literal["steer"]
    by: Literal["keys", "law", "path", "nobody"]
    law: Literal["paper", "lyapunov", "alv", "tron"] = "paper"
    pose_source: str = "truth"
    """Pose for the law or path: an estimator's, or ``truth``."""


class Keys(Strict):
    """State of the keys, repeated while they are held."""

    do: Literal["keys"]
    v: Annotated[float, Field(ge=-1, le=1)]
    """Share of the scene's speed."""
    omega: Annotated[float, Field(ge=-1, le=1)]
    """Share of the maximum yaw rate."""


class Estimators(Strict):
    """Choose the estimators; the drive restarts."""

    do: Literal["estimators"]
    names: Annotated[tuple[Name, ...], Field(max_length=6)]


class Pace(Strict):
    """Set the speed as a multiple of real time; 0: pause."""

    do: Literal["pace"]
    pace: Annotated[float, Field(ge=0, le=10)]


class Open(Strict):
    """Open another scene."""

    do: Literal["open"]
    scene: Scenario


class Plain(Strict):
    """Restart, undo, or save."""

    do: Literal["again", "undo", "save"]


Request = Hello | Move | Add | Remove | Set | Steer | Keys | Estimators | Pace | Open | Plain
_REQUEST = Annotated[Request, Field(discriminator="do")]


def parse(text: str | bytes) -> Request:
    """Return the request in a message, or raise InputError."""
    request: Request = parsed(_REQUEST, text)
    return request
