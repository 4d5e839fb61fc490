"""Panoramic cameras: the direction of each pixel of a panorama.

Columns run clockwise, as an image is seen from inside, and wrap round after the last one. The image
of a lens with a limited field of view is mapped onto a panorama that is black elsewhere.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Annotated, Literal

import numpy as np

from homeward.drives.cameras.camera import Camera, Directions, Pixels, Shape
from homeward.drives.cameras.lens import Lens
from homeward.drives.settings import Finite
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.io.checks import Field
from homeward.vision.cameras.grey import Mask, as_grey
from homeward.vision.opencv import opencv

Share = Annotated[float, Field(ge=0, le=1)]


class Panorama(Camera):
    """Base class of panoramic cameras: 360 degrees across the image."""

    axis: Share = 0.5
    """Position of the camera's axis (azimuth 0), as a share of the width from the left edge."""
    horizon: Finite = 0.5
    """Position of elevation 0, as a share of the height from the top edge."""

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
        """The part of a panorama within the field of view; None: all of it."""
        return None

    @staticmethod
    def column_angle(width: int) -> float:
        """Return the azimuth that one column spans [rad]."""
        return 2 * math.pi / width

    def panorama(self, image: np.ndarray) -> np.ndarray:
        """Return the panorama, uint8 (height, width), that `directions` refers to.

        From an image as the camera delivers it, in any format of `as_grey`; `InputError` if it is
        no picture, or its size does not suit the camera.
        """
        grey = as_grey(image)
        height, width = grey.shape
        if height > width:
            raise InputError(f"{width}x{height} pixels: taller than wide; check if it is rotated")
        return grey

    def _elevation(self, above: np.ndarray) -> np.ndarray:
        """Return the elevation [rad] of rows `above` the horizon, in units of width / 2 pi."""
        raise NotImplementedError

    def _above(self, elevation: np.ndarray) -> np.ndarray:
        """Return the inverse of `_elevation`."""
        raise NotImplementedError


class Equirectangular(Panorama):
    """Elevation is linear in the rows; pixels are square unless `row_scale` is given."""

    model: Literal["equirectangular"] = "equirectangular"
    row_scale: Annotated[float, Field(gt=0, le=10)] = 1.0
    """Elevation spanned by a row over azimuth spanned by a column [1]."""

    def panorama(self, image: np.ndarray) -> np.ndarray:
        """Return the image, in grey; it must not span more than 180 degrees of elevation."""
        grey = as_grey(image)
        height, width = grey.shape
        span = height * self.column_angle(width) * self.row_scale
        if span > math.pi * 1.01 and width >= height:
            raise InputError(
                f"{width}x{height} pixels would span {math.degrees(span):.0f} deg of elevation: "
                "not an equirectangular panorama of 360 deg; specify its camera in images.yaml"
            )
        return super().panorama(grey)

    def _elevation(self, above: np.ndarray) -> np.ndarray:
        return np.clip(above * self.row_scale, -math.pi / 2, math.pi / 2)

    def _above(self, elevation: np.ndarray) -> np.ndarray:
        return elevation / self.row_scale


class Cylindrical(Panorama):
    """A vertical cylinder unrolled: the tangent of the elevation is linear in the rows."""

    model: Literal["cylindrical"] = "cylindrical"

    def _elevation(self, above: np.ndarray) -> np.ndarray:
        return np.asarray(np.arctan(above))

    def _above(self, elevation: np.ndarray) -> np.ndarray:
        return np.asarray(np.tan(elevation))


SECTORS = 24
"""Number of azimuth sectors in which the spread of matches is counted."""
WINDOW = 3
"""Number of neighbouring sectors that one object may fill: 45 degrees."""


def sector_of(azimuth: np.ndarray) -> np.ndarray:
    """Return the sector, 0 to `SECTORS` - 1, of each azimuth [rad]."""
    return np.floor((azimuth / (2 * math.pi) + 0.5) * SECTORS).astype(int) % SECTORS


MAX_WIDTH, MIN_WIDTH = 2048, 256
"""Limits of the width of a computed panorama [px]."""
GRID = 33
"""Number of columns, and of rows, at which the vertical field of view is sampled."""
MAX_ELEVATION = math.radians(75.0)
"""Beyond this elevation a panorama is too stretched [rad]."""


class PartialPanorama(Equirectangular):
    """The part of a panorama within the field of view of a calibrated lens.

    It is used like any panorama; pixels outside the field of view are masked. Pixels in the
    picture's middle keep their size within the limits of the panorama's width.
    """

    model: Literal["partial"] = "partial"  # type: ignore[assignment]
    lens: Lens
    """The lens of the pictures."""

    @classmethod
    def through(cls, lens: Lens) -> PartialPanorama:
        """Return the partial panorama of a lens.

        Raises `InputError` if the size of its pictures is unknown.
        """
        if lens.width is None or lens.height is None:
            raise InputError("in images.yaml the camera needs width and height, or tags: 36h11")
        tilt = lens.model_dump(include=set(Camera.model_fields))
        lens = lens.model_copy(update={"roll": 0.0, "pitch": 0.0})
        top, bottom = _extent(lens)
        return cls(lens=lens, horizon=top / (top - bottom), **tilt)

    def panorama(self, image: np.ndarray) -> np.ndarray:
        """Return the panorama, black outside the field of view."""
        grey = as_grey(image)
        self.lens.require_shape((grey.shape[0], grey.shape[1]))
        black = {"borderMode": opencv().BORDER_CONSTANT, "borderValue": 0}
        return np.asarray(opencv().remap(grey, *self._map, opencv().INTER_LINEAR, **black))

    @property
    def seen(self) -> Mask | None:
        """The field of view of the lens."""
        assert self.lens.height is not None
        assert self.lens.width is not None
        return Mask.of(self.panorama(np.full((self.lens.height, self.lens.width), 255, np.uint8)))

    @cached_property
    def _map(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the column and row in the picture of each pixel of the panorama."""
        width = int(np.clip(16 * round(math.tau * self.lens.fx / 16), MIN_WIDTH, MAX_WIDTH))
        top, bottom = _extent(self.lens)
        height = max(round((top - bottom) / self.column_angle(width)), 16)
        rows, columns = np.indices((height, width))
        level = self.model_copy(update={"roll": 0.0, "pitch": 0.0})
        seen = self.lens.pixels(*level.directions(columns, rows, (height, width)))
        column, row = (np.nan_to_num(part, nan=-9.0).astype(np.float32) for part in seen)
        return column, row


def _extent(lens: Lens) -> tuple[float, float]:
    """Return the largest and smallest elevation [rad] in view, the horizon included."""
    assert lens.height is not None
    assert lens.width is not None
    columns, rows = np.meshgrid(*(np.linspace(0, n - 1, GRID) for n in (lens.width, lens.height)))
    seen = lens.directions(columns.ravel(), rows.ravel())[1]
    ends = float(np.nanmax(seen)), float(np.nanmin(seen))
    return min(max(ends[0], 0.0), MAX_ELEVATION), max(min(ends[1], 0.0), -MAX_ELEVATION)
