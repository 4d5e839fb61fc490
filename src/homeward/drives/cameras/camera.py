"""What all camera models share: pixel to ray with its covariance, ray to pixel, and a known tilt.

A camera's frame: x along its axis, y to the left, z up. Azimuth is anti-clockwise from x, elevation
upwards from the horizon. Pixel centres have whole coordinates, as in OpenCV and ROS: the middle of
the top left pixel is (0, 0). Half a pixel of a camera of 60 degrees and 1280 columns is 0.03 deg.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from homeward.geometry.angles import wrap
from homeward.io.keys import Strict

Shape = tuple[int, int]
"""Height and width of an image [px]."""
Pixels = tuple[np.ndarray, np.ndarray]
"""Columns and rows, which need not be whole [px]."""
Directions = tuple[np.ndarray, np.ndarray]
"""Azimuths and elevations [rad]."""
Tilt = Annotated[float, Field(ge=-math.pi / 3, le=math.pi / 3)]


class Camera(Strict):
    """A camera of any model, and how it is tilted on the robot."""

    roll: Tilt = 0.0
    """Known tilt of the camera about its axis [rad]; positive: its left side is raised."""
    pitch: Tilt = 0.0
    """Known tilt about its left-hand axis [rad]; positive: it looks down."""
    tilt_sigma: Annotated[float, Field(gt=0, le=0.5)] = 0.02
    """How far the tilt may differ from that, from image to image [rad]."""

    def directions(self, columns: np.ndarray, rows: np.ndarray, shape: Shape) -> Directions:
        """Return azimuth and elevation [rad] of pixels (n,), the known tilt taken out.

        Pixels need not be whole. Azimuths are in (-pi, pi]; both are NaN where the model has no ray
        for a pixel.
        """
        raise NotImplementedError

    def pixels(self, azimuth: np.ndarray, elevation: np.ndarray, shape: Shape) -> Pixels:
        """Return columns and rows [px] of directions [rad]; the inverse of `directions`.

        NaN where the camera cannot see; what lies outside of the image has coordinates, too.
        """
        raise NotImplementedError

    def directions_and_slope(
        self, columns: np.ndarray, rows: np.ndarray, shape: Shape
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return `directions`, (n, 2), and their derivatives by column and row, (n, 2, 2)."""
        right, down = np.array([[0.0, 0.5, -0.5, 0.0, 0.0], [0.0, 0.0, 0.0, 0.5, -0.5]])[..., None]
        told = self.directions((columns + right).ravel(), (rows + down).ravel(), shape)
        here, *ahead_and_behind = np.stack(told, axis=-1).reshape(5, -1, 2)
        right_of, left_of, below, above = ahead_and_behind
        slope = np.stack([wrap(right_of - left_of), wrap(below - above)], axis=-1)
        return here, slope

    def bearing_variance(self, elevation: np.ndarray) -> np.ndarray:
        """Return what bearings, (n,), owe to the tilt that is not known [rad^2].

        A small rotation (wx, wy, 0) turns the azimuth a at elevation e by -tan e (wx cos a +
        wy sin a): nothing at the horizon, and ever more towards the image's top and bottom.
        """
        return np.asarray((np.tan(elevation) * self.tilt_sigma) ** 2)

    def _level(self, azimuth: np.ndarray, elevation: np.ndarray) -> Directions:
        """Turn directions from the tilted camera's frame into the level one."""
        return turned(azimuth, elevation, tilt_matrix(self.roll, self.pitch))

    def _tilted(self, azimuth: np.ndarray, elevation: np.ndarray) -> Directions:
        """Turn directions from the level frame into the tilted camera's."""
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
    """Return Ry(pitch) Rx(roll), (3, 3), from a tilted camera's frame to the level one."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return np.asarray(about_y @ about_x)


FLAT = 1e-10
"""Least product of a tag's diagonals and the sine between them [rad^2]."""


def tag_bearings(
    corners: np.ndarray, sigma: np.ndarray | float, camera: Camera, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the bearings (n,) of the centres of tags, and their standard deviations (n,) [rad].

    The centre of a tag is where its diagonals cross. Each diagonal spans a plane with the camera,
    and the planes meet in the ray of the centre. This is exact for every lens; the crossing in a
    distorted image, and the mean of the corners in any image, are not.

    `corners` (n, 4, 2) are columns and rows [px], in order round the tag; `sigma`, a number or
    (n,), is the standard deviation of each coordinate [px]. The unknown part of the camera's tilt
    is in the deviations. Bearings are NaN where the camera has no ray for a corner.
    """
    n = len(corners)
    step = np.broadcast_to(np.asarray(sigma, float), (n,))
    # Each of the eight coordinates ahead and back by its deviation.
    moved = np.zeros((17, 4, 2))
    moved[1:] = np.concatenate([np.eye(8), -np.eye(8)]).reshape(16, 4, 2)
    tried = corners + moved[:, None] * step[:, None, None]
    azimuth, elevation = _middle(tried, camera, shape)
    ahead, back = azimuth[1:9], azimuth[9:]
    variance = np.sum((wrap(ahead - back) / 2) ** 2, axis=0)
    return azimuth[0], np.sqrt(variance + camera.bearing_variance(elevation[0]))


def _middle(corners: np.ndarray, camera: Camera, shape: Shape) -> Directions:
    """Return azimuth and elevation [rad], (...), of the middles of tags (..., 4, 2) [px]."""
    seen = camera.directions(corners[..., 0].ravel(), corners[..., 1].ravel(), shape)
    rays = unit_vectors(*seen).reshape(*corners.shape[:-1], 3)
    one, two = (np.cross(rays[..., i, :], rays[..., i + 2, :]) for i in (0, 1))
    middle = np.cross(one, two)
    # Corners on one line, or all at one place, have no crossing.
    flat = np.linalg.norm(middle, axis=-1) < FLAT
    middle = np.where(flat[..., None], np.nan, middle)
    ahead = np.sum(middle * rays.sum(axis=-2), axis=-1, keepdims=True)
    return angles(np.where(ahead < 0, -middle, middle))
