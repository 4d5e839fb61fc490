"""Panoramic cameras: which direction each pixel of a panorama looks in.

Columns run clockwise, as an image is seen from inside, and wrap round after the last one.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from homeward.angles import wrap
from homeward.drives.cameras.camera import Camera, Directions, Pixels, Shape
from homeward.drives.drive import Finite
from homeward.errors import InputError
from homeward.vision.cameras.grey import as_grey
from homeward.vision.cameras.mask import Mask

Share = Annotated[float, Field(ge=0, le=1)]


class Panorama(Camera):
    """What all panoramic cameras share: 360 degrees across the image."""

    axis: Share = 0.5
    """Where the camera's axis (azimuth 0) stands, as a share of the width from the left edge."""
    horizon: Finite = 0.5
    """Where elevation 0 stands, as a share of the height from the top edge."""

    def directions(self, columns: np.ndarray, rows: np.ndarray, shape: Shape) -> Directions:
        """Return azimuth and elevation [rad] of pixels; as `Camera.directions`."""
        height, width = shape
        azimuth = np.asarray(wrap((self.axis * width - 0.5 - columns) * self.column_angle(width)))
        below = rows - (self.horizon * height - 0.5)
        return self._level(azimuth, self._elevation(-below * self.column_angle(width)))

    def pixels(self, azimuth: np.ndarray, elevation: np.ndarray, shape: Shape) -> Pixels:
        """Return columns and rows [px] of directions [rad]; as `Camera.pixels`."""
        height, width = shape
        azimuth, elevation = self._tilted(azimuth, elevation)
        step = self.column_angle(width)
        columns = (self.axis * width - 0.5 - azimuth / step + 0.5) % width - 0.5
        return columns, self.horizon * height - 0.5 - self._above(elevation) / step

    @property
    def seen(self) -> Mask | None:
        """Which part of a panorama the camera sees at all; None: all of it."""
        return None

    @staticmethod
    def column_angle(width: int) -> float:
        """Return the azimuth that one column spans [rad]."""
        return 2 * math.pi / width

    def panorama(self, image: np.ndarray) -> np.ndarray:
        """Return the panorama, uint8 (height, width), that `directions` speaks of.

        Parameters
        ----------
        image : ndarray
            As the camera gives it, of any kind that `as_grey` takes.

        Raises
        ------
        InputError
            When it is no picture, or its size does not suit the camera.
        """
        grey = as_grey(image)
        height, width = grey.shape
        if height > width:
            raise InputError(f"{width}x{height} pixels: taller than wide; is it rotated?")
        return grey

    def _elevation(self, above: np.ndarray) -> np.ndarray:
        """Return the elevation [rad] of rows `above` the horizon, in units of width / 2 pi."""
        raise NotImplementedError

    def _above(self, elevation: np.ndarray) -> np.ndarray:
        """Return the inverse of `_elevation`."""
        raise NotImplementedError


class Equirectangular(Panorama):
    """Elevation grows evenly with the rows; pixels are square unless told otherwise."""

    model: Literal["equirectangular"] = "equirectangular"
    row_scale: Annotated[float, Field(gt=0, le=10)] = 1.0
    """Elevation that a row spans, over the azimuth that a column spans [1]."""

    def panorama(self, image: np.ndarray) -> np.ndarray:
        """Return the image, in grey; it must not span more than 180 degrees of elevation."""
        grey = as_grey(image)
        height, width = grey.shape
        span = height * self.column_angle(width) * self.row_scale
        if span > math.pi * 1.01 and width >= height:
            raise InputError(
                f"{width}x{height} pixels would span {math.degrees(span):.0f} deg of elevation: "
                "no equirectangular panorama of 360 deg; name its camera"
            )
        return super().panorama(grey)

    def _elevation(self, above: np.ndarray) -> np.ndarray:
        return np.clip(above * self.row_scale, -math.pi / 2, math.pi / 2)

    def _above(self, elevation: np.ndarray) -> np.ndarray:
        return elevation / self.row_scale


class Cylindrical(Panorama):
    """A vertical cylinder unrolled: the tangent of the elevation grows evenly with the rows."""

    model: Literal["cylindrical"] = "cylindrical"

    def _elevation(self, above: np.ndarray) -> np.ndarray:
        return np.asarray(np.arctan(above))

    def _above(self, elevation: np.ndarray) -> np.ndarray:
        return np.asarray(np.tan(elevation))


SECTORS = 24
"""Azimuth is divided into so many sectors where the spread of matches is counted."""


WINDOW = 3
"""So many neighbouring sectors may be filled by one object: 45 degrees."""


def sector_of(azimuth: np.ndarray) -> np.ndarray:
    """Return the number, 0 to `SECTORS` - 1, of the sector that each azimuth [rad] lies in."""
    return np.floor((azimuth / (2 * math.pi) + 0.5) * SECTORS).astype(int) % SECTORS
