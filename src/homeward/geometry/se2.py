"""SE(2) and the bearing model with their Jacobians, on arrays; same values as `frames`.

The localiser linearises with these functions and the chain rule; tests compare them with CasADi's
derivatives of `homeward.geometry.frames`. Poses are (..., 3): x [m], y [m], heading [rad], not
wrapped.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from homeward.geometry.angles import wrap

MIN_DISTANCE = 1e-3
"""Minimum distance of a camera from a landmark, where they coincide [m]."""
MIN_SQUARED_DISTANCE = MIN_DISTANCE**2
"""Its square, in derivatives [m^2]."""


class Sight(NamedTuple):
    """Bearings of places from camera poses, and their Jacobian."""

    bearing: np.ndarray
    """(...): bearings from the camera's axis [rad], not wrapped."""
    by_place: np.ndarray
    """(..., 2): Jacobian by the place; by the camera position it is the negative, by heading -1."""
    offset: np.ndarray
    """(..., 2): offset of the place from the camera [m]."""


def sight(eyes: np.ndarray, places: np.ndarray) -> Sight:
    """Return the bearings of places (..., 2) [m] from camera poses (..., 3)."""
    offset = places - eyes[..., :2]
    dx, dy = offset[..., 0], offset[..., 1]
    square = np.maximum(dx * dx + dy * dy, MIN_SQUARED_DISTANCE)
    by_place = np.empty_like(offset)
    np.divide(dy, square, out=by_place[..., 0])
    np.negative(by_place[..., 0], out=by_place[..., 0])
    np.divide(dx, square, out=by_place[..., 1])
    return Sight(np.arctan2(dy, dx) - eyes[..., 2], by_place, offset)


def rotation(heading: float | np.ndarray) -> np.ndarray:
    """Return the matrix (..., 3, 3) from a pose's frame to its parent, for (x, y, heading)."""
    c, s = np.cos(heading), np.sin(heading)
    if isinstance(c, float):
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    matrix = np.zeros((*np.shape(heading), 3, 3))
    matrix[..., 0, 0] = matrix[..., 1, 1] = c
    matrix[..., 1, 0], matrix[..., 0, 1] = s, -s
    matrix[..., 2, 2] = 1.0
    return matrix


def lever(shift: np.ndarray) -> np.ndarray:
    """Return the Jacobian of ``compose(a, b)`` by a, (..., 3, 3).

    `shift` (..., 2 or 3) is the result minus a, in their common frame [m].
    """
    matrix = np.zeros((*np.shape(shift)[:-1], 3, 3))
    matrix[..., 0, 0] = matrix[..., 1, 1] = matrix[..., 2, 2] = 1.0
    matrix[..., 0, 2], matrix[..., 1, 2] = -shift[..., 1], shift[..., 0]
    return matrix


def compose(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return poses b, which are in the frames of a, in the parent frame of a."""
    if a.ndim == b.ndim == 1:  # for a single pose, floats are faster
        (x, y, heading), (ahead, aside, turn) = a.tolist(), b.tolist()
        c, s = math.cos(heading), math.sin(heading)
        return np.array([x + c * ahead - s * aside, y + s * ahead + c * aside, heading + turn])
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x, y, result = b[..., 0], b[..., 1], np.asarray(a + b)
    result[..., 0] = a[..., 0] + c * x - s * y
    result[..., 1] = a[..., 1] + s * x + c * y
    return result


def composition(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ``compose(a, b)`` and its Jacobians by a and by b, (..., 3, 3) each."""
    if not a.ndim == b.ndim == 1:
        result = compose(a, b)
        return result, lever(result - a), rotation(a[..., 2])
    (x, y, heading), (ahead, aside, turn) = a.tolist(), b.tolist()
    c, s = math.cos(heading), math.sin(heading)
    to_x, to_y = x + c * ahead - s * aside, y + s * ahead + c * aside
    by_a = np.array([[1.0, 0.0, y - to_y], [0.0, 1.0, to_x - x], [0.0, 0.0, 1.0]])
    by_b = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.array([to_x, to_y, heading + turn]), by_a, by_b


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return poses a (..., 3) minus poses b, component by component; the heading is wrapped."""
    off = np.asarray(a - b)
    off[..., 2] = wrap(off[..., 2])
    return off


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return poses b in the frames of poses a.

    The Jacobian by b is ``R = rotation(a.heading)`` transposed; by a it is ``-R.T @ lever(b - a)``.
    """
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    result = np.asarray(b - a)
    x, y = result[..., 0], result[..., 1]
    result[..., 0], result[..., 1] = c * x + s * y, c * y - s * x
    return result
