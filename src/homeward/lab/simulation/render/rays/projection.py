"""Rectangles as a camera sees them: what a ray is tried against, and where at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.lab.simulation.render.rays.surfaces import Surfaces

SLACK = 1e-6
"""Rectangles reach so far beyond their edges, in tiles, lest a ray slips through where two meet."""

ANGLE_SLACK = 1e-4
"""And cones, for the same reason [rad]."""
LEAST_BLOCK, MOST_BLOCKS = 8, 64
"""Blocks have so many columns at least, and a picture so many blocks side by side at most."""


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

    @property
    def limits(self) -> np.ndarray:
        """Shift, least and greatest tile coordinates of each, (m, 6)."""
        return np.hstack([self.shift, self.low, self.high])


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


def windows(projected: Projected, blocks: Blocks) -> np.ndarray:
    """Return where each rectangle may be in a picture: runs of blocks that its pyramid meets.

    From the camera a rectangle is a pyramid between four planes, and rays of a block lie within a
    cone: where a whole cone lies beyond one of the planes, no ray of it meets the rectangle.

    Returns
    -------
    ndarray of int64, shape (k, 5)
        The rectangle's number, first row and the one after the last, columns alike.
    """
    corners = projected.corners
    inwards = np.cross(np.roll(corners, -1, axis=1), corners)
    inwards /= np.maximum(np.linalg.norm(inwards, axis=-1, keepdims=True), 1e-300)
    (high, wide), m = blocks.sine.shape, len(corners)
    beyond = inwards.reshape(-1, 3) @ blocks.axis.reshape(-1, 3).T < -blocks.sine.ravel()
    met = ~beyond.reshape(m, 4, high, wide).any(axis=1)
    edge = np.diff(np.pad(met, [(0, 0), (0, 0), (1, 1)]).astype(np.int8), axis=2)
    k, row, left = np.nonzero(edge == 1)
    right = np.nonzero(edge == -1)[2]
    rows, columns = blocks.rows, blocks.columns
    table = [k, rows[row], rows[row + 1], columns[left], columns[right]]
    return np.stack(table, axis=1).astype(np.int64)


@dataclass(frozen=True)
class Blocks:
    """A picture's rays in blocks of rows and columns, each within a cone."""

    rows: np.ndarray
    """(high + 1,), where they begin, and where the last one ends."""
    columns: np.ndarray
    """(wide + 1,)"""
    axis: np.ndarray
    """(high, wide, 3), unit vectors; zero where no pixel has a ray."""
    sine: np.ndarray
    """(high, wide), of the angle from there to the outermost ray; less than none without rays."""

    @classmethod
    def of(cls, rays: np.ndarray) -> Blocks:
        """Return those of rays, (3, height, width), unit vectors or NaN."""
        height, width = rays.shape[1:]
        side = max(LEAST_BLOCK, -(-width // MOST_BLOCKS))
        rows, columns = np.arange(0, height, side), np.arange(0, width, side)

        def over(ufunc: np.ufunc, values: np.ndarray) -> np.ndarray:
            return np.asarray(ufunc.reduceat(ufunc.reduceat(values, rows, -2), columns, -1))

        some = np.isfinite(rays[0])
        axis = over(np.add, np.where(some, rays, 0.0).astype(float))
        axis /= np.maximum(np.linalg.norm(axis, axis=0), 1e-12)
        high = np.diff(ends := np.append(rows, height))
        wide = np.diff(sides := np.append(columns, width))
        along = np.repeat(np.repeat(axis, high, axis=1), wide, axis=2)
        least = over(np.minimum, np.where(some, np.einsum("khw,khw->hw", along, rays), 2.0))
        angle = np.arccos(np.clip(least, -1.0, 1.0)) + ANGLE_SLACK
        sine = np.where(least > 1.5, -1.0, np.where(least > 0.0, np.sin(angle), 1.0))
        return cls(ends, sides, np.moveaxis(axis, 0, -1), sine)
