"""Rectangles as a panorama's camera sees them: what a ray is tried against, and where at all."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from homeward.simulation.render.rays.surfaces import Surfaces

SLACK = 1e-6
"""Rectangles reach so far beyond their edges, in tiles, lest a ray slips through where two meet."""

Window = tuple[int, slice, slice]
"""A rectangle's number, rows and columns."""


@dataclass(frozen=True)
class Projected:
    """Those rectangles that face a camera, in its frame. Arrays over m of them."""

    index: np.ndarray
    matrix: np.ndarray
    """(m, 3, 3), M."""
    shift: np.ndarray
    """(m, 2), added to q1 / q0 and q2 / q0."""
    low: np.ndarray
    """(m, 2), least tile coordinates."""
    high: np.ndarray
    """(m, 2), greatest tile coordinates."""
    corners: np.ndarray
    """(m, 4, 3), in the camera's frame [m]."""

    def limits(self, dtype: type[np.floating]) -> np.ndarray:
        """Return shift, least and greatest tile coordinates of each, (m, 6)."""
        return np.hstack([self.shift, self.low, self.high]).astype(dtype)


def project(surfaces: Surfaces, position: np.ndarray, rotation: np.ndarray) -> Projected:
    """Return the rectangles that face a camera, in its frame.

    `position`, (3,) [m], and `rotation`, (3, 3), are those of a `Viewpoint`.
    """
    away = np.einsum("ni,ni->n", surfaces.normal, surfaces.corner - position)
    index = np.flatnonzero(away < -1e-9)
    corner = (surfaces.corner[index] - position) @ rotation
    right, up = surfaces.right[index] @ rotation, surfaces.up[index] @ rotation
    tiles, low = surfaces.tiles[index], surfaces.offset[index]
    normal = np.cross(right, up)
    rows = np.stack(
        [
            normal / np.einsum("ni,ni->n", normal, corner)[:, None],
            right * (tiles[:, 0] / np.einsum("ni,ni->n", right, right))[:, None],
            up * (tiles[:, 1] / np.einsum("ni,ni->n", up, up))[:, None],
        ],
        axis=1,
    )
    shift = low - np.einsum("nki,ni->nk", rows[:, 1:], corner)
    sides = np.stack([corner, corner + right, corner + right + up, corner + up], axis=1)
    return Projected(index, rows, shift, low - SLACK, low + tiles + SLACK, sides)


def windows(projected: Projected, azimuth: np.ndarray, elevation: np.ndarray) -> list[Window]:
    """Return for each rectangle the one or two windows of the picture that it can cover."""
    w = azimuth.size
    step = 2 * math.pi / w
    first, turn = _azimuths(projected.corners)
    lowest, highest = _elevations(projected.corners)
    above, below = _covers_pole(projected, 1.0), _covers_pole(projected, -1.0)
    highest[above], lowest[below] = np.pi, -np.pi
    turn[above | below] = 2 * np.pi
    # Rows and columns one beyond, so that rounding loses none.
    top = np.maximum(np.searchsorted(-elevation, -highest) - 1, 0)
    bottom = np.minimum(np.searchsorted(-elevation, -lowest, "right") + 1, elevation.size)
    count = np.ceil(turn / step).astype(int) + 3
    left = (np.floor((azimuth[0] - first - turn) / step).astype(int) - 1) % w
    found: list[Window] = []
    for k, (a, b, c, n) in enumerate(np.stack([top, bottom, left, count], axis=1).tolist()):
        rows = slice(a, b)
        if n >= w:
            found.append((k, rows, slice(0, w)))
        elif c + n <= w:
            found.append((k, rows, slice(c, c + n)))
        else:
            found += [(k, rows, slice(c, w)), (k, rows, slice(0, c + n - w))]
    return found


def _azimuths(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least azimuth of each rectangle (m, 4, 3) and how far it spreads on [rad]."""
    angle = np.unwrap(np.arctan2(corners[..., 1], corners[..., 0]), axis=1)
    return angle.min(axis=1), np.ptp(angle, axis=1)


def _elevations(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return least and greatest elevation along the edges of rectangles (m, 4, 3) [rad].

    An edge is an arc of a great circle: beside its ends, the circle's highest or lowest point can
    lie on it.
    """
    ends = np.roll(corners, -1, axis=1)
    axis = np.cross(corners, ends)
    x, y, z = np.moveaxis(axis, -1, 0)
    summit = np.stack([-x * z, -y * z, x * x + y * y], axis=-1)
    after = np.einsum("mki,mki->mk", np.cross(corners, summit), axis)
    before = np.einsum("mki,mki->mk", np.cross(summit, ends), axis)
    slope = np.arctan2(summit[..., 2], np.hypot(summit[..., 0], summit[..., 1]))
    angle = np.arctan2(corners[..., 2], np.hypot(corners[..., 0], corners[..., 1]))
    highest = np.where((after > 0) & (before > 0), slope, angle)
    lowest = np.where((after < 0) & (before < 0), -slope, angle)
    return (
        np.minimum(lowest, angle).min(axis=1),
        np.maximum(highest, angle).max(axis=1),
    )


def _covers_pole(projected: Projected, pole: float) -> np.ndarray:
    """Say of each rectangle whether the ray straight up (pole 1) or down (-1) meets it."""
    q = projected.matrix[:, :, 2] * pole
    with np.errstate(divide="ignore", invalid="ignore"):
        place = q[:, 1:] / q[:, :1] + projected.shift
    inside = (place >= projected.low) & (place <= projected.high)
    return np.asarray((q[:, 0] > 0) & inside.all(axis=1))
