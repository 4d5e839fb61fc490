"""A rendered room, its light and the drive through it, as one validated model in SI units."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator
from shapely import LinearRing, Polygon, contains_xy

from homeward.drives.settings import Finite, NonNegative, Positive
from homeward.io.keys import Strict
from homeward.lab.simulation.render.room.camera import RoomCamera
from homeward.lab.simulation.scenario import ByPoints, Course, Interval, Point, Rates

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


TextureName = Literal[
    "plaster", "carpet", "wood", "tiles", "cardboard", "painted", "print", "cloth"
]
Place = tuple[Where, Where]
"""x, y in room coordinates [m]."""


def _simple(outline: tuple[Point, ...]) -> tuple[Point, ...]:
    corners = np.array(outline, float)
    if np.any(np.hypot(*(corners - np.roll(corners, -1, axis=0)).T) < 0.01):
        raise ValueError("two corners in a row are the same")
    ring = LinearRing(corners)
    if not ring.is_simple:
        raise ValueError("the walls cross each other")
    return outline if ring.is_ccw else tuple(reversed(outline))


Outline = Annotated[tuple[Place, ...], Field(min_length=3, max_length=200), AfterValidator(_simple)]
"""Corners in turn, either way round; kept anti-clockwise."""


class Walls(Strict):
    """The room itself."""

    outline: Outline
    """Its corners as seen from above [m]."""
    height: Length = 2.5
    """[m]"""
    walls: TextureName = "plaster"
    floor: TextureName = "carpet"
    ceiling: TextureName = "plaster"

    @property
    def polygon(self) -> Polygon:
        """The floor."""
        return Polygon(self.outline)


class Stand(Strict):
    """Where a box stands."""

    at: Place
    """Its middle [m]."""
    yaw: Finite = 0.0
    """Of its length [rad]."""


class Box(Stand):
    """A box: furniture, a crate, a shelf that hangs."""

    size: tuple[Length, Length, Length]
    """Length, width, height [m]."""
    base: NonNegative = 0.0
    """Height of its underside [m]."""
    texture: TextureName = "cardboard"
    stood: Stand | None = None
    """Where it stood when home was stored, if it has been moved since."""

    def where(self, at_home: bool) -> Stand:
        """Return where it stands during the drive, or stood when home was stored."""
        return self.stood if at_home and self.stood is not None else self


class Poster(OnWall):
    """A picture on a wall."""

    size: tuple[Length, Length] = (0.6, 0.8)
    texture: TextureName = "print"


class Mover(Strict):
    """Someone who walks to and fro along a line, for ever."""

    path: Annotated[tuple[Place, ...], Field(min_length=1, max_length=200)]
    """Way points [m]; a single one: stands still."""
    speed: NonNegative = 0.8
    """[m/s]"""
    size: tuple[Length, Length] = (0.45, 1.75)
    """Width, height [m]."""
    texture: TextureName = "cloth"


class Furnish(Strict):
    """What is put into the room by chance, beside what is listed."""

    boxes: Annotated[int, Field(ge=0, le=100)] = 0
    """Along the walls."""
    posters: Annotated[int, Field(ge=0, le=100)] = 0
    movers: Annotated[int, Field(ge=0, le=20)] = 0
    """Each walks from one place at the walls to another."""
    moved: Annotated[int, Field(ge=0, le=100)] = 0
    """So many of the boxes stood elsewhere when home was stored."""
    shift: Interval = (0.4, 1.2)
    """How far from there, uniform [m]."""


class Tags(Strict):
    """Square tags on the sides of every box, each with a number of its own, and on the walls."""

    family: str = "36h11"
    """As `homeward see --tags` takes it."""
    size: Length = 0.16
    """Side of the black square, a little less on small boxes [m]."""
    walls: Annotated[int, Field(ge=0, le=200)] = 12
    """How many hang on the walls, all round at even distances."""
    height: Positive = 0.9
    """Of the middle of those [m]."""


class RenderScenario(Course, Lighting):
    """Everything that makes an image drive; the same one always makes the same images."""

    room: Walls
    furnish: Furnish = Furnish()
    boxes: dict[str, Box] = Field(default_factory=dict)
    posters: dict[str, Poster] = Field(default_factory=dict)
    movers: dict[str, Mover] = Field(default_factory=dict)
    tags: Tags | None = None
    home_light: Lighting | None = None
    """When home was stored; None: as now."""
    camera: RoomCamera = RoomCamera()
    home_time: Finite = -100.0
    """When the home image was taken [s]; movers were elsewhere then."""
    rates: Rates = Rates(odometry=20.0, bearings=5.0, truth=20.0)
    """`bearings` counts images."""

    def light(self, at_home: bool) -> Lighting:
        """Return the light of the drive, or that when home was stored."""
        return self.home_light if at_home and self.home_light is not None else self

    @property
    def view(self) -> float:
        """The full opening angle of the camera [rad]; a panorama's is all round."""
        return self.camera.view

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        outline, floor = np.array(self.room.outline, float), self.room.polygon
        if not contains_xy(floor, self.home.x, self.home.y):
            raise ValueError("home: outside the room")
        if self.camera.above_floor >= self.room.height:
            raise ValueError("camera.above_floor: through the ceiling")
        if self.trajectory.kind == "repeat":
            raise ValueError("trajectory.kind: a rendered drive repeats no route")
        points = self.trajectory.points if isinstance(self.trajectory, ByPoints) else ()
        for i, (x, y) in enumerate(points):
            if not contains_xy(floor, x, y):
                raise ValueError(f"trajectory.points.{i}: outside the room")
        names = [*self.boxes, *self.posters, *self.movers, "floor", "ceiling"]
        names += [f"wall {i}" for i in range(len(outline))]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"{twice[0]!r} is a name given twice")
        sides = np.hypot(*(np.roll(outline, -1, axis=0) - outline).T)
        for name, mover in self.movers.items():
            if not contains_xy(floor, mover.path).all():
                raise ValueError(f"movers.{name}: outside the room")
        hung: dict[str, OnWall] = {f"posters.{name}": p for name, p in self.posters.items()}
        times: dict[str, Lighting] = {"": self, "home_light.": self.light(at_home=True)}
        for key, light in times.items():
            for i, lamp in enumerate(light.lights):
                if not contains_xy(floor, *lamp.at[:2]) or not 0 < lamp.at[2] < self.room.height:
                    raise ValueError(f"{key}lights.{i}: outside the room")
            if light.sun is not None:
                hung[f"{key}sun"] = light.sun
        for key, on in hung.items():
            half_width, half_height = on.size[0] / 2, on.size[1] / 2
            if on.wall >= len(outline):
                raise ValueError(f"{key}.wall: the room has {len(outline)} walls")
            if not half_width <= on.along <= sides[on.wall] - half_width:
                raise ValueError(f"{key}: beyond the wall")
            if not half_height <= on.height <= self.room.height - half_height:
                raise ValueError(f"{key}: higher than the wall, or through the floor")
        return self
