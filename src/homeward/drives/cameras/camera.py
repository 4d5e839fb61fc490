"""Base of all camera models: pixel to ray, ray to pixel, tilt, and bearings of tags.

A camera's frame: x along its axis, y to the left, z up. Azimuth is anti-clockwise from x, elevation
upwards from the horizon. Pixel centres have whole coordinates, as in OpenCV and ROS: the centre of
the top left pixel is (0, 0). Half a pixel of a camera of 60 degrees and 1280 columns is 0.03 deg.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np

from homeward.geometry.angles import wrap
from homeward.io.checks import Field
from homeward.io.models import Strict

Shape = tuple[int, int]
"""Height and width of an image [px]."""
Pixels = tuple[np.ndarray, np.ndarray]
"""Columns and rows, also fractional [px]."""
Directions = tuple[np.ndarray, np.ndarray]
"""Azimuths and elevations [rad]."""
Tilt = Annotated[float, Field(ge=-math.pi, le=math.pi)]


class Camera(Strict):
    """A camera of any model, with its tilt on the robot."""

    roll: Tilt = 0.0
    """Known tilt of the camera about its axis [rad]; positive: its left side is raised."""
    pitch: Tilt = 0.0
    """Known tilt about its left-hand axis [rad]; positive: it looks down."""
    tilt_sigma: Annotated[float, Field(gt=0, le=0.5)] = 0.02
    """Standard deviation of the tilt from image to image [rad]."""

    def directions(self, columns: np.ndarray, rows: np.ndarray, shape: Shape) -> Directions:
        """Return azimuth and elevation [rad] of pixels (n,), corrected for the known tilt.

        Pixels may be fractional. Azimuths are in (-pi, pi]; both are NaN for a pixel without a ray.
        """
        raise NotImplementedError

    def pixels(self, azimuth: np.ndarray, elevation: np.ndarray, shape: Shape) -> Pixels:
        """Return columns and rows [px] of directions [rad]; the inverse of `directions`.

        NaN for directions without a pixel; directions outside the image have coordinates, too.
        """
        raise NotImplementedError

    def directions_and_slope(
        self, columns: np.ndarray, rows: np.ndarray, shape: Shape
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return `directions`, (n, 2), and their derivatives by column and row, (n, 2, 2)."""
        right, down = np.array([[0.0, 0.5, -0.5, 0.0, 0.0], [0.0, 0.0, 0.0, 0.5, -0.5]])[..., None]
        around = self.directions((columns + right).ravel(), (rows + down).ravel(), shape)
        here, right_of, left_of, below, above = np.stack(around, axis=-1).reshape(5, -1, 2)
        slope = np.stack([wrap(right_of - left_of), wrap(below - above)], axis=-1)
        return here, slope

    def bearing_variance(self, elevation: np.ndarray) -> np.ndarray:
        """Return the variance of bearings, (n,), from the unknown tilt [rad^2].

        A small rotation (wx, wy, 0) turns the azimuth a at elevation e by -tan e (wx cos a +
        wy sin a): 0 at the horizon, and more towards the top and bottom of the image.
        """
        return np.asarray((np.tan(elevation) * self.tilt_sigma) ** 2)

    def _level(self, azimuth: np.ndarray, elevation: np.ndarray) -> Directions:
        """Rotate directions from the tilted camera's frame to the level frame."""
        return turned(azimuth, elevation, tilt_matrix(self.roll, self.pitch))

    def _tilted(self, azimuth: np.ndarray, elevation: np.ndarray) -> Directions:
        """Rotate directions from the level frame to the tilted camera's frame."""
        return turned(azimuth, elevation, tilt_matrix(self.roll, self.pitch).T)


def turned(azimuth: np.ndarray, elevation: np.ndarray, rotation: np.ndarray) -> Directions:
    """Return azimuth and elevation [rad], (n,), of directions after a rotation (3, 3)."""
    if np.array_equal(rotation, np.eye(3)):
        return azimuth, elevation
    return angles(unit_vectors(azimuth, elevation) @ rotation.T)


def angles(rays: np.ndarray) -> Directions:
    """Return azimuth and elevation [rad], (...), of rays (..., 3) of any length but 0."""
    x, y, z = np.moveaxis(rays, -1, 0)
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def unit_vectors(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """Return unit vectors, shape (..., 3), of azimuths and elevations [rad], shape (...)."""
    c = np.cos(elevation)
    return np.stack([c * np.cos(azimuth), c * np.sin(azimuth), np.sin(elevation)], axis=-1)


def tilt_matrix(roll: float, pitch: float) -> np.ndarray:
    """Return Ry(pitch) Rx(roll), (3, 3), from a tilted camera's frame to the level frame."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return np.asarray(about_y @ about_x)


Side = Annotated[float, Field(gt=0, le=100)]
TagSize = Side | dict[str, Side]
"""Length of the side of a tag's black square [m]: of all tags, or by id."""
MIN_TAG_AREA = 1e-10
"""Minimum product of a tag's diagonals and the sine between them [rad^2]."""


def tag_bearings(
    corners: np.ndarray, sigma: np.ndarray | float, camera: Camera, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the bearings (n,) of the centres of tags, and their standard deviations (n,) [rad].

    The diagonals of a tag cross in its centre. Each diagonal and the camera define a plane, and the
    planes intersect in the ray of the centre. This is exact for every lens, unlike the crossing in
    a distorted image or the mean of the corners.

    `corners` (n, 4, 2) are columns and rows [px], in order round the tag; `sigma`, a number or
    (n,), is the standard deviation of each coordinate [px]. The standard deviations include the
    unknown tilt. Bearings are NaN where the camera has no ray for a corner.
    """
    n = len(corners)
    step = np.broadcast_to(np.asarray(sigma, float), (n,))
    # Each of the eight coordinates plus and minus its standard deviation.
    moved = np.zeros((17, 4, 2))
    moved[1:] = np.concatenate([np.eye(8), -np.eye(8)]).reshape(16, 4, 2)
    shifted = corners + moved[:, None] * step[:, None, None]
    azimuth, elevation = tag_directions(shifted, camera, shape)
    ahead, back = azimuth[1:9], azimuth[9:]
    variance = np.sum((wrap(ahead - back) / 2) ** 2, axis=0)
    return azimuth[0], np.sqrt(variance + camera.bearing_variance(elevation[0]))


def tag_ranges(
    corners: np.ndarray, sizes: np.ndarray, camera: Camera, shape: tuple[int, int]
) -> np.ndarray:
    """Return the horizontal distances (n,) of tags on vertical surfaces [m], from their size.

    The ends of a vertical side are at the same distance d, so its length is d times the difference
    of the tangents of their elevations, however the tag is turned about the vertical. The mean of
    the two sides that are more vertical counts; NaN without a size or a ray. `corners` (n, 4, 2)
    are columns and rows [px] in order round each tag, `sizes` (n,) lengths of the sides [m], NaN if
    unknown, and `shape` is height and width of the image [px].
    """
    _, elevation = camera.directions(corners[..., 0].ravel(), corners[..., 1].ravel(), shape)
    height = np.tan(elevation).reshape(-1, 4)
    sides = np.abs(height - np.roll(height, -1, axis=1)).reshape(-1, 2, 2)  # opposite ones last
    upright = np.take_along_axis(sides, sides.sum(axis=1).argmax(axis=1)[:, None, None], axis=2)
    with np.errstate(divide="ignore"):
        found = sizes * (1.0 / upright[..., 0]).mean(axis=1)
    return np.where(np.isfinite(found), found, np.nan)


def sizes_of(names: Sequence[str], size: TagSize | None) -> np.ndarray:
    """Return the sizes of named tags [m], shape (n,); NaN where unknown."""
    if isinstance(size, dict):
        return np.array([size.get(name, math.nan) for name in names], float)
    return np.full(len(names), math.nan if size is None else size)


def rays_of(pixels: np.ndarray, camera: Camera, shape: Shape) -> np.ndarray:
    """Return the rays (..., 3) of pixels (..., 2)."""
    seen = camera.directions(pixels[..., 0].ravel(), pixels[..., 1].ravel(), shape)
    return unit_vectors(*seen).reshape(*pixels.shape[:-1], 3)


def tag_directions(corners: np.ndarray, camera: Camera, shape: Shape) -> Directions:
    """Return azimuth and elevation [rad], (...), of the centres of tags (..., 4, 2) [px]."""
    rays = rays_of(corners, camera, shape)
    one, two = (np.cross(rays[..., i, :], rays[..., i + 2, :]) for i in (0, 1))
    centre = np.cross(one, two)
    # Corners on one line, or all in one point, have no crossing.
    is_flat = np.linalg.norm(centre, axis=-1) < MIN_TAG_AREA
    centre = np.where(is_flat[..., None], np.nan, centre)
    ahead = np.sum(centre * rays.sum(axis=-2), axis=-1, keepdims=True)
    return angles(np.where(ahead < 0, -centre, centre))
