"""Panoramic cameras: which direction each pixel of a panorama looks in.

The camera's frame: x along its axis, y to the left, z up. Azimuth is anti-clockwise from x,
elevation upwards from the horizon. Columns run clockwise, as an image is seen from inside, and
wrap round after the last one. Pixel centres have whole coordinates, as in OpenCV.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from homeward.angles import wrap
from homeward.drives.drive import Finite, Strict
from homeward.errors import InputError
from homeward.vision.cameras.grey import as_grey

Share = Annotated[float, Field(ge=0, le=1)]
Tilt = Annotated[float, Field(ge=-math.pi / 3, le=math.pi / 3)]


class Panorama(Strict):
    """What all panoramic cameras share: 360 degrees across the image, and a known tilt."""

    axis: Share = 0.5
    """Where the camera's axis (azimuth 0) stands, as a share of the width from the left edge."""
    horizon: Finite = 0.5
    """Where elevation 0 stands, as a share of the height from the top edge."""
    roll: Tilt = 0.0
    """Known tilt of the camera about its axis [rad]; positive: its left side is raised."""
    pitch: Tilt = 0.0
    """Known tilt about its left-hand axis [rad]; positive: it looks down."""
    tilt_sigma: Annotated[float, Field(gt=0, le=0.5)] = 0.02
    """How far the tilt may differ from that, from image to image [rad]."""

    def directions(
        self, columns: np.ndarray, rows: np.ndarray, shape: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return azimuth and elevation [rad] of pixels, the known tilt taken out.

        Parameters
        ----------
        columns, rows : ndarray, shape (n,)
            Pixel coordinates, which need not be whole.
        shape : tuple of int
            Height and width of the panorama [px].

        Returns
        -------
        azimuth : ndarray, shape (n,)
            In (-pi, pi].
        elevation : ndarray, shape (n,)
        """
        height, width = shape
        azimuth = np.asarray(wrap((self.axis * width - 0.5 - columns) * self.column_angle(width)))
        below = rows - (self.horizon * height - 0.5)
        return self._level(azimuth, self._elevation(-below * self.column_angle(width)))

    def directions_and_slope(
        self, columns: np.ndarray, rows: np.ndarray, shape: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return `directions`, (n, 2), and their derivatives by column and row, (n, 2, 2)."""
        right, down = np.array([[0.0, 0.5, -0.5, 0.0, 0.0], [0.0, 0.0, 0.0, 0.5, -0.5]])[..., None]
        told = self.directions((columns + right).ravel(), (rows + down).ravel(), shape)
        here, *ahead_and_behind = np.stack(told, axis=-1).reshape(5, -1, 2)
        right_of, left_of, below, above = ahead_and_behind
        slope = np.stack([wrap(right_of - left_of), wrap(below - above)], axis=-1)
        return here, slope

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

    def _level(self, azimuth: np.ndarray, elevation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Turn directions from the tilted camera's frame into the level one."""
        if not (self.roll or self.pitch):
            return azimuth, elevation
        x, y, z = tilt_matrix(self.roll, self.pitch) @ unit_vectors(azimuth, elevation).T
        return np.arctan2(y, x), np.arcsin(np.clip(z, -1, 1))


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


class Cylindrical(Panorama):
    """A vertical cylinder unrolled: the tangent of the elevation grows evenly with the rows."""

    model: Literal["cylindrical"] = "cylindrical"

    def _elevation(self, above: np.ndarray) -> np.ndarray:
        return np.asarray(np.arctan(above))


SECTORS = 24
"""Azimuth is divided into so many sectors where the spread of matches is counted."""


WINDOW = 3
"""So many neighbouring sectors may be filled by one object: 45 degrees."""


def sector_of(azimuth: np.ndarray) -> np.ndarray:
    """Return the number, 0 to `SECTORS` - 1, of the sector that each azimuth [rad] lies in."""
    return np.floor((azimuth / (2 * math.pi) + 0.5) * SECTORS).astype(int) % SECTORS


def unit_vectors(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """Return unit vectors, shape (n, 3), of azimuths and elevations [rad], shape (n,)."""
    c = np.cos(elevation)
    return np.stack([c * np.cos(azimuth), c * np.sin(azimuth), np.sin(elevation)], axis=-1)


def tilt_matrix(roll: float, pitch: float) -> np.ndarray:
    """Return Ry(pitch) Rx(roll), (3, 3), from a tilted camera's frame to the level one."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return np.asarray(about_y @ about_x)
