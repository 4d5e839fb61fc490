"""The camera of a rendered room: which model it is of, and what its sensor adds."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from homeward.drives.cameras.lens import Lens
from homeward.drives.settings import Finite, Positive
from homeward.io.keys import Strict
from homeward.vision.cameras.panoramic import Cylindrical, Equirectangular, Panorama
from homeward.vision.cameras.ring import Ring

LEAST_TILT = 0.002
"""A camera that is said not to tilt is still not trusted more than this [rad]."""
LENSES = {"pinhole": "plumb_bob", "fisheye": "equidistant"}
RIM = 2.0
"""A ring keeps so far from the picture's edge [px]."""
INNER = 0.3
"""Its inner radius, as a share of the outer one."""


class RoomCamera(Strict):
    """A camera that sees all round, or (pinhole, fisheye) ahead."""

    projection: Literal["equirectangular", "cylindrical", "ring", "pinhole", "fisheye"] = (
        "equirectangular"
    )
    width: Annotated[int, Field(ge=64, le=4096)] = 512
    """Columns; of a panorama, they share the full turn."""
    field_of_view: Annotated[float, Field(ge=0.1, le=6.2)] = 1.2
    """Across the width of a pinhole's (at most 2.6) or a fisheye's picture [rad]."""
    height: Annotated[int, Field(ge=16, le=2048)] = 128
    """Rows; the horizon lies in the middle, and there a pixel is as high as it is wide."""
    distortion: tuple[Finite, ...] = ()
    """Coefficients of a pinhole (plumb_bob) or a fisheye (equidistant), as of `Lens`."""
    elevations: tuple[Finite, Finite] = (-0.7, 0.5)
    """Of a ring, at its inner and its outer edge [rad]."""
    above_floor: Positive = 0.5
    """[m]"""
    roll: Annotated[float, Field(ge=-0.5, le=0.5)] = 0.0
    """About the robot's axis [rad]."""
    pitch: Annotated[float, Field(ge=-0.5, le=0.5)] = 0.0
    """Nose down [rad]."""
    tilt_sigma: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    """Each image is rolled and pitched by chance beside that [rad]."""
    noise: Annotated[float, Field(ge=0, le=100)] = 2.0
    """Standard deviation of each pixel [grey levels of 255]."""
    exposure_sigma: Annotated[float, Field(ge=0, le=1)] = 0.05
    """Each image is brighter or darker by such a share."""

    @property
    def view(self) -> float:
        """The full opening angle [rad]; a panorama's is all round."""
        return self.field_of_view if self.projection in LENSES else math.tau

    @property
    def pixel_angle(self) -> float:
        """What a pixel in the middle spans [rad]."""
        known = self.known
        if isinstance(known, Lens):
            return 1 / known.fx
        around = math.pi * (known.inner + known.outer) if isinstance(known, Ring) else self.width
        return math.tau / around

    @property
    def known(self) -> Panorama | Lens:
        """The camera as a front-end knows it: its tilt, but not each shake."""
        tilt = {"roll": self.roll, "pitch": self.pitch}
        tilt["tilt_sigma"] = max(LEAST_TILT, self.tilt_sigma)
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
        # Where a lens of focal length 1 draws what is half the view aside.
        edge, _ = Lens(fx=1, fy=1, cx=0, cy=0, **lens).pixels(
            np.array([-self.field_of_view / 2]), np.zeros(1)
        )
        focal = self.width / 2 / float(edge[0])
        if not 0 < focal < math.inf:
            raise ValueError("field_of_view: more than the lens can draw")
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
            raise ValueError("height: at most half the width, which is from pole to pole")
        if self.height > 8 * self.width:
            raise ValueError("height: too high for the width")
        if self.projection == "pinhole" and self.field_of_view > 2.6:
            raise ValueError("field_of_view: a pinhole sees 2.6 rad at most; a fisheye sees more")
        if self.distortion and self.projection not in LENSES:
            raise ValueError(f"distortion: {self.projection} has none")
        _ = self.known  # whether there is such a camera
        return self
