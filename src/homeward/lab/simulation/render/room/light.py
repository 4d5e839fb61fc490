"""Light in a rendered room: lamps, what comes from everywhere, and the sun through a window."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field

from homeward.drives.drive import Finite, NonNegative, Positive
from homeward.io.strict import Strict

Length = Annotated[float, Field(ge=0.01, le=1000.0)]
"""[m]"""
Where = Annotated[float, Field(ge=-1e4, le=1e4)]


class Light(Strict):
    """A lamp without a shape."""

    at: tuple[Where, Where, Where]
    """x, y, height [m]."""
    power: Positive = 1.0


class OnWall(Strict):
    """Something flat on a wall."""

    wall: Annotated[int, Field(ge=0)]
    """From corner number `wall` of the outline (taken anti-clockwise) to the next."""
    along: NonNegative
    """From that corner to its middle [m]."""
    height: Positive = 1.4
    """Of its middle [m]."""
    size: tuple[Length, Length]
    """Width, height [m]."""


class Sun(OnWall):
    """The sun, which comes in by a window on a wall; the window itself is not drawn."""

    size: tuple[Length, Length] = (1.2, 1.2)
    azimuth: Finite
    """Where the sun stands [rad]."""
    elevation: Annotated[float, Field(gt=0, lt=math.pi / 2)] = 0.6
    """And how high [rad]."""
    power: Positive = 2.0


class Lighting(Strict):
    """All light of a time."""

    lights: tuple[Light, ...] = ()
    """None: one under the middle of the ceiling."""
    ambient: NonNegative = 0.45
    """Light from everywhere, beside which one lamp gives up to about 1."""
    sun: Sun | None = None
