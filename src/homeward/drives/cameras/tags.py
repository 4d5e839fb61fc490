"""Bearings of square tags from their corners: no size, no pose, no orientation."""

from __future__ import annotations

import numpy as np

from homeward.drives.cameras.camera import Camera, Directions, Shape, angles, unit_vectors
from homeward.geometry.angles import wrap

FLAT = 1e-10
"""Least product of a tag's diagonals and the sine between them [rad^2]."""


def tag_bearings(
    corners: np.ndarray, sigma: np.ndarray | float, camera: Camera, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the bearings of the middles of tags, and their standard deviations.

    A tag's middle is where its diagonals cross. Each diagonal spans a plane with the camera, and
    the line in which the planes meet is the ray of the middle: exact for every lens, where the
    crossing in a distorted image, and the mean of the corners in any, are not. It is the
    projective centre: that of the tag's homography.

    Parameters
    ----------
    corners : ndarray, shape (n, 4, 2)
        Columns and rows [px], in turn round the tag, from any.
    sigma : float or ndarray, shape (n,)
        Standard deviation of each of their coordinates [px].
    camera : Camera
        That took the image; what is not known of its tilt is in the deviations.
    shape : tuple of int
        Height and width of the image [px].

    Returns
    -------
    bearing, sigma : ndarray, shape (n,)
        [rad]; NaN where the camera has no ray for a corner.
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
