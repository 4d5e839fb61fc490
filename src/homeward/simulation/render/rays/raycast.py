"""Ray casting: which surface each ray meets first, and where.

A panorama's ray has azimuth a and elevation e; its direction is written (cos a, sin a, tan e) in
the camera's frame, so that it is a sum of a part by column and a part by row. Along it, one unit is
one metre on the camera's own horizon. A pinhole's is (1, -x, -y), and a unit one metre ahead. For a
rectangle with corner o (seen from the camera) and normal n, ray d meets its plane at ``1 / q0``,
and tile coordinates there are ``q1 / q0`` and ``q2 / q0`` plus constants, with q = M d linear in d:
three sums a pixel, and no other geometry. Each rectangle is tried only within the window of columns
and rows that it can cover.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from homeward.simulation.render.rays.compiled import compiled
from homeward.simulation.render.rays.projection import Projected, Window, project, windows
from homeward.simulation.render.rays.surfaces import Surfaces

TINY = 1e-30
"""No ray is seen to go so far as the inverse of this [m]."""


class Viewpoint(NamedTuple):
    """Where a camera is in the room and how it is turned."""

    position: np.ndarray
    """(3,) [m]"""
    rotation: np.ndarray
    """(3, 3), takes directions in the camera's frame (x along its axis, y left, z up) to the
    room's."""


def viewpoint(
    x: float, y: float, height: float, heading: float, roll: float = 0.0, pitch: float = 0.0
) -> Viewpoint:
    """Return the viewpoint of a camera [m, rad]; first rolled about its axis, then pitched down."""
    (cr, sr), (cp, sp), (ch, sh) = ((math.cos(a), math.sin(a)) for a in (roll, pitch, heading))
    rolled = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    pitched = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    turned = np.array([[ch, -sh, 0], [sh, ch, 0], [0, 0, 1]])
    return Viewpoint(np.array([x, y, height]), turned @ pitched @ rolled)


@dataclass(frozen=True)
class Hits:
    """What rays meet; every array has the rays' shape."""

    distance: np.ndarray
    """In units of the ray's direction, infinite where it meets nothing."""
    across: np.ndarray
    """Tile coordinate along the surface's `right`."""
    along: np.ndarray
    """Tile coordinate along its `up`."""
    surface: np.ndarray
    """Index of the surface; -1 where the ray meets nothing."""

    def window(self, rows: slice, columns: slice) -> Hits:
        """Return a part of a picture's hits, as views."""
        parts = self.distance, self.across, self.along, self.surface
        return Hits(*(part[rows, columns] for part in parts))


@dataclass(frozen=True)
class Grid:
    """The rays of a picture: ``(across[0], across[1], up)`` of each column and row."""

    across: np.ndarray
    """(2, w)"""
    up: np.ndarray
    """(h,)"""
    turn: tuple[np.ndarray, np.ndarray] | None = None
    """Of a panorama: azimuths (w,) and elevations (h,) [rad]."""

    @classmethod
    def panorama(cls, azimuth: np.ndarray, elevation: np.ndarray) -> Grid:
        """Return that of columns and rows [rad] as `cast` wants them."""
        across = np.stack([np.cos(azimuth), np.sin(azimuth)])
        return cls(across, np.tan(elevation), (azimuth, elevation))

    @classmethod
    def pinhole(cls, x: np.ndarray, y: np.ndarray) -> Grid:
        """Return that of columns and rows from the axis, in focal lengths."""
        return cls(np.stack([np.ones_like(x), -x]), -y)

    @property
    def directions(self) -> np.ndarray:
        """Of all pixels, (h, w, 3)."""
        shape = (self.up.size, self.across.shape[1])
        parts = (*self.across, self.up[:, None])
        return np.stack([np.broadcast_to(part, shape) for part in parts], axis=-1)

    @property
    def lengths(self) -> np.ndarray:
        """Of the directions, (h, w)."""
        return np.asarray(np.hypot(np.hypot(*self.across), self.up[:, None]))

    def windows(self, projected: Projected) -> list[Window]:
        """Return where each rectangle may be in the picture."""
        if self.turn is not None:
            return windows(projected, *self.turn)
        (_, left), (lowest, highest) = self.across, (self.up.min(), self.up.max())
        ahead, y, z = np.moveaxis(projected.corners, -1, 0)
        # What lies wholly beyond one of the picture's edges, or behind, is not in it.
        beyond = [ahead, y - left.min() * ahead, left.max() * ahead - y]
        beyond += [z - lowest * ahead, highest * ahead - z]
        seen = ~np.any([np.all(side <= 0, axis=1) for side in beyond], axis=0)
        whole = slice(0, self.up.size), slice(0, left.size)
        return [(k, *whole) for k in np.flatnonzero(seen).tolist()]


def trace(surfaces: Surfaces, view: Viewpoint, directions: np.ndarray) -> Hits:
    """Find what any rays meet, from where the view is.

    Directions (..., 3) are in the camera's frame, of any length but 0.
    """
    hits = _nothing(directions.shape[:-1], np.float64)
    projected = project(surfaces, *view)
    limits = projected.limits(np.float64).tolist()
    for k, index in enumerate(projected.index.tolist()):
        q = np.moveaxis(directions @ projected.matrix[k].T, -1, 0)
        _meet(hits, index, limits[k], q)
    return hits


def cast(
    surfaces: Surfaces,
    view: Viewpoint,
    grid: Grid,
    dtype: type[np.floating] = np.float64,
) -> Hits:
    """Find what the rays of a picture meet.

    Parameters
    ----------
    surfaces : Surfaces
        Everything in the room.
    view : Viewpoint
        The camera.
    grid : Grid
        A panorama's azimuths fall evenly from left to right through one full turn, its elevations
        from top to bottom, within a right angle of the horizon.
    dtype : type
        float32 is enough for pictures.

    Returns
    -------
    Hits
        Of shape (h, w); distances are in units of the grid's rays.
    """
    flat, rise = grid.across, grid.up
    hits = _nothing((rise.size, flat.shape[1]), dtype)
    projected = project(surfaces, *view)
    by_column = (projected.matrix[:, :, :2] @ flat).astype(dtype)
    by_row = (projected.matrix[:, :, 2:] * rise).astype(dtype)
    covered = grid.windows(projected)
    if dtype is np.float32 and _cast_compiled(hits, projected, covered, by_column, by_row):
        return hits
    limits = projected.limits(dtype).tolist()
    # A level camera sees walls at distances that hang on the column alone, and floors on the row:
    # what hangs on one of them stays a line.
    flat_too = np.any(projected.matrix[:, :, :2] != 0, axis=2).tolist()
    rise_too = (projected.matrix[:, :, 2] != 0).tolist()
    for k, rows, part in covered:
        across, down = by_column[k, :, None, part], by_row[k, :, rows, None]
        q = [
            across[i] + down[i] if c and r else across[i] if c else down[i]
            for i, (c, r) in enumerate(zip(flat_too[k], rise_too[k], strict=True))
        ]
        _meet(hits.window(rows, part), int(projected.index[k]), limits[k], q)
    return hits


def _cast_compiled(
    hits: Hits,
    projected: Projected,
    covered: Sequence[Window],
    by_column: np.ndarray,
    by_row: np.ndarray,
) -> bool:
    """Find in place, in compiled code, what the rays of a picture meet; False where that fails."""
    native, shape = compiled(), hits.distance.shape
    if native is None:
        return False
    table = [(k, rows.start, rows.stop, part.start, part.stop) for k, rows, part in covered]
    given = np.array(table, np.int64).reshape(-1, 5), projected.index.astype(np.int64)
    limits, found = projected.limits(np.float32), (hits.distance, hits.across, hits.along)
    sizes = len(covered), len(projected.index), *shape
    failed = native.cast(*sizes, *given, by_column, by_row, limits, TINY, *found, hits.surface)
    return not failed


def points(hits: Hits, view: Viewpoint, directions: np.ndarray) -> np.ndarray:
    """Return where rays met something, (..., 3) in room coordinates [m]; NaN where nothing."""
    reach = np.where(hits.surface >= 0, hits.distance, np.nan)
    return np.asarray(view.position + (directions * reach[..., None]) @ view.rotation.T)


def _nothing(shape: tuple[int, ...], dtype: type[np.floating]) -> Hits:
    return Hits(
        np.full(shape, np.inf, dtype),
        np.zeros(shape, dtype),
        np.zeros(shape, dtype),
        np.full(shape, -1, np.int16),
    )


def _meet(hits: Hits, index: int, limits: Sequence[float], q: Sequence[np.ndarray]) -> None:
    """Keep those hits on a rectangle that are nearer than what was met before.

    `q` are three arrays that broadcast to the shape of the hits, `limits` as in `Projected`.
    """
    shift_s, shift_t, s0, t0, s1, t1 = limits
    distance = np.reciprocal(np.maximum(q[0], hits.distance.dtype.type(TINY)))
    s, t = q[1] * distance, q[2] * distance
    s += shift_s
    t += shift_t
    met = distance < hits.distance
    met &= t >= t0
    met &= t <= t1
    # Of a wall these are lines, joined before they meet the whole window.
    met &= (q[0] > 0) & (s >= s0) & (s <= s1)
    np.copyto(hits.distance, distance, where=met)
    np.copyto(hits.across, s, where=met)
    np.copyto(hits.along, t, where=met)
    np.copyto(hits.surface, index, where=met)
