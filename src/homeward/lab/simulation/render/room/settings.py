"""A rendered room, its camera and the drive through it, as one validated model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

import numpy as np
from shapely import LinearRing, Polygon, contains_xy

from homeward.drives.cameras.lens import Lens
from homeward.drives.settings import Finite, NonNegative, Positive
from homeward.io.checks import AfterValidator, Field
from homeward.io.models import Strict, model_validator
from homeward.io.reading import shipped_or_file
from homeward.io.settings import read_settings
from homeward.lab.simulation.scenario import ByPoints, Course, Point, Rates
from homeward.lab.simulation.simulate import changed_scenario, require_own_code
from homeward.vision.cameras.panoramic import Cylindrical, Equirectangular, Panorama
from homeward.vision.cameras.ring import Ring

MIN_TILT_SIGMA = 0.002
"""Minimum tilt noise that a front-end assumes [rad]."""
LENSES = {"pinhole": "plumb_bob", "fisheye": "equidistant"}
RIM = 2.0
"""Distance of a ring from the image edge [px]."""
INNER = 0.3
"""Inner radius as a share of the outer one."""


class RoomCamera(Strict):
    """A panoramic camera, or one that looks ahead (pinhole, fisheye)."""

    projection: Literal["equirectangular", "cylindrical", "ring", "pinhole", "fisheye"] = (
        "equirectangular"
    )
    width: Annotated[int, Field(ge=64, le=4096)] = 512
    """Columns; those of a panorama cover the full circle."""
    field_of_view: Annotated[float, Field(ge=0.1, le=6.2)] = 1.2
    """Across the image width of a pinhole (at most 2.6) or a fisheye [rad]."""
    height: Annotated[int, Field(ge=16, le=2048)] = 128
    """Rows; the horizon is in the middle, where pixels are square."""
    distortion: tuple[Finite, ...] = ()
    """Coefficients of a pinhole (plumb_bob) or a fisheye (equidistant), as of `Lens`."""
    elevations: tuple[Finite, Finite] = (-0.7, 0.5)
    """Elevations of a ring at its inner and outer edge [rad]."""
    above_floor: Positive = 0.5
    """[m]"""
    roll: Annotated[float, Field(ge=-0.5, le=0.5)] = 0.0
    """About the robot's axis [rad]."""
    pitch: Annotated[float, Field(ge=-0.5, le=0.5)] = 0.0
    """Nose down [rad]."""
    tilt_sigma: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    """Standard deviation of additional roll and pitch of each image [rad]."""
    noise: Annotated[float, Field(ge=0, le=100)] = 2.0
    """Standard deviation of each pixel [grey levels of 255]."""
    exposure_sigma: Annotated[float, Field(ge=0, le=1)] = 0.05
    """Relative standard deviation of the brightness of each image."""

    @property
    def view(self) -> float:
        """Field of view [rad]; 2 pi for a panorama."""
        return self.field_of_view if self.projection in LENSES else math.tau

    @property
    def pixel_angle(self) -> float:
        """Angle of a pixel in the middle [rad]."""
        known = self.known
        if isinstance(known, Lens):
            return 1 / known.fx
        around = math.pi * (known.inner + known.outer) if isinstance(known, Ring) else self.width
        return math.tau / around

    @property
    def known(self) -> Panorama | Lens:
        """Camera model for a front-end: mean tilt, but not the tilt of each image."""
        tilt = {"roll": self.roll, "pitch": self.pitch}
        tilt["tilt_sigma"] = max(MIN_TILT_SIGMA, self.tilt_sigma)
        middle = (self.width - 1) / 2, (self.height - 1) / 2
        if self.projection == "equirectangular":
            return Equirectangular(**tilt)
        if self.projection == "cylindrical":
            return Cylindrical(**tilt)
        if self.projection == "ring":
            outer = min(middle) - RIM
            radii = {"inner": INNER * outer, "outer": outer}
            return Ring(centre=middle, elevations=self.elevations, **radii, **tilt)
        lens = {"model": LENSES[self.projection], "distortion": self.distortion}
        # Image position at half the field of view, for a focal length of 1.
        edge, _ = Lens(fx=1, fy=1, cx=0, cy=0, **lens).pixels(
            np.array([-self.field_of_view / 2]), np.zeros(1)
        )
        focal = self.width / 2 / float(edge[0])
        if not 0 < focal < math.inf:
            raise ValueError("field_of_view: larger than the lens model can image")
        size = {"width": self.width, "height": self.height}
        return Lens(fx=focal, fy=focal, cx=middle[0], cy=middle[1], **lens, **size, **tilt)

    def directions(self, columns: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return azimuth and elevation [rad] of pixels, (n,), in the frame of the camera itself.

        NaN where the lens has no ray.
        """
        untilted = self.known.model_copy(update={"roll": 0.0, "pitch": 0.0})
        if isinstance(untilted, Ring):
            return untilted.ring_directions(columns, rows)
        return untilted.directions(columns, rows, (self.height, self.width))

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.projection == "equirectangular" and 2 * self.height > self.width:
            raise ValueError("height: at most half the width (the full range of elevations)")
        if self.height > 8 * self.width:
            raise ValueError("height: at most 8 times the width")
        if self.projection == "pinhole" and self.field_of_view > 2.6:
            raise ValueError("field_of_view: at most 2.6 rad for a pinhole; use a fisheye")
        if self.distortion and self.projection not in LENSES:
            raise ValueError(f"distortion: {self.projection} has none")
        _ = self.known  # validates the camera model
        return self


Length = Annotated[float, Field(ge=0.01, le=1000.0)]
"""[m]"""
Where = Annotated[float, Field(ge=-1e4, le=1e4)]


TextureName = Literal["plaster", "carpet", "wood", "tiles", "cardboard", "painted", "print"]
Place = tuple[Where, Where]
"""x, y in room coordinates [m]."""


def _simple(outline: tuple[Point, ...]) -> tuple[Point, ...]:
    corners = np.array(outline, float)
    if np.any(np.hypot(*(corners - np.roll(corners, -1, axis=0)).T) < 0.01):
        raise ValueError("two consecutive corners are equal")
    ring = LinearRing(corners)
    if not ring.is_simple:
        raise ValueError("the walls cross each other")
    return outline if ring.is_ccw else tuple(reversed(outline))


Outline = Annotated[tuple[Place, ...], Field(min_length=3, max_length=200), AfterValidator(_simple)]
"""Corners in order, stored anti-clockwise."""


class Walls(Strict):
    """The room itself."""

    outline: Outline
    """Corners, seen from above [m]."""
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
    """Pose of a box."""

    at: Place
    """Centre [m]."""
    yaw: Finite = 0.0
    """Of its length [rad]."""


class Box(Stand):
    """A box: furniture, a package, a shelf or a picture on a wall."""

    size: tuple[Length, Length, Length]
    """Length, width, height [m]."""
    base: NonNegative = 0.0
    """Height of the lower side [m]."""
    texture: TextureName = "cardboard"
    stood: Stand | None = None
    """Pose when home was stored, if the box has been moved since."""

    def where(self, at_home: bool) -> Stand:
        """Return the pose during the drive, or when home was stored."""
        return self.stood if at_home and self.stood is not None else self


class Tags(Strict):
    """Square tags with unique numbers, on the sides of all boxes and on the walls."""

    family: str = "36h11"
    """As in `homeward see --tags`."""
    size: Length = 0.16
    """Side of the black square, smaller on small boxes [m]."""
    walls: Annotated[int, Field(ge=0, le=200)] = 12
    """Number of tags on the walls, evenly spaced."""
    height: Positive = 0.9
    """Height of the centre of tags on walls [m]."""


class RenderScenario(Course):
    """Settings of an image drive; the same scenario always gives the same images."""

    room: Walls
    boxes: dict[str, Box] = {}
    tags: Tags | None = None
    camera: RoomCamera = RoomCamera()
    rates: Rates = Rates(odometry=20.0, bearings=5.0, truth=20.0)
    """`bearings` is the rate of images."""

    @property
    def view(self) -> float:
        """Field of view of the camera [rad]; 2 pi for a panorama."""
        return self.camera.view

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        outline, floor = np.array(self.room.outline, float), self.room.polygon
        if not contains_xy(floor, self.home.x, self.home.y):
            raise ValueError("home: outside the room")
        if self.camera.above_floor >= self.room.height:
            raise ValueError("camera.above_floor: must be below the ceiling")
        if self.trajectory.kind == "repeat":
            raise ValueError("trajectory.kind: a rendered drive repeats no route")
        points = self.trajectory.points if isinstance(self.trajectory, ByPoints) else ()
        for i, (x, y) in enumerate(points):
            if not contains_xy(floor, x, y):
                raise ValueError(f"trajectory.points.{i}: outside the room")
        names = ["floor", "ceiling", *(f"wall {i}" for i in range(len(outline)))]
        if twice := [name for name in names if name in self.boxes]:
            raise ValueError(f"boxes.{twice[0]}: the room has this name; rename the box")
        return self


def load_room(
    source: str, seed: int | None = None, changes: Mapping[str, Any] | None = None
) -> RenderScenario:
    """Return the room that ships, by name, or a room from a YAML file, with optional changes.

    `seed` replaces the file's; changes are dotted keys ("camera.width") to values. Raises
    `InputError` for a file that cannot be read, an unknown key, a value out of range, or a file
    that names Python code, as `load_scenario` does.
    """
    given = dict(changes or {}) | ({} if seed is None else {"seed": seed})
    file = shipped_or_file(source, "rooms")
    scenario = changed_scenario(read_settings(file, RenderScenario), given)
    require_own_code(scenario, given, source)
    return scenario
