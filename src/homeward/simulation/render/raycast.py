"""Ray casting: which surface each ray meets first, and where.

A panorama's ray has azimuth a and elevation e; its direction is written (cos a, sin a, tan e) in
the camera's frame, so that it is a sum of a part by column and a part by row. Along it, one unit is
one metre on the camera's own horizon. For a rectangle with corner o (seen from the camera) and
normal n, ray d meets its plane at ``1 / q0``, and tile coordinates there are ``q1 / q0`` and
``q2 / q0`` plus constants, with q = M d linear in d: three sums a pixel, and no other geometry.
Each rectangle is tried only within the window of columns and rows that it can cover.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from homeward.simulation.render.surfaces import Surfaces

SLACK = 1e-6
"""Rectangles reach so far beyond their edges, in tiles, lest a ray slips through where two meet."""


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
class _Projected:
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

    def limits(self, dtype: type[np.floating]) -> list[list[float]]:
        """Return shift, least and greatest tile coordinates of each, six numbers of a type."""
        numbers: list[list[float]] = (
            np.hstack([self.shift, self.low, self.high]).astype(dtype).tolist()
        )
        return numbers


def trace(surfaces: Surfaces, view: Viewpoint, directions: np.ndarray) -> Hits:
    """Find what any rays meet.

    Parameters
    ----------
    surfaces : Surfaces
        Everything in the room.
    view : Viewpoint
        Where all rays begin.
    directions : ndarray, shape (..., 3)
        In the camera's frame, of any length but 0.
    """
    hits = _nothing(directions.shape[:-1], np.float64)
    projected = _project(surfaces, view)
    limits = projected.limits(np.float64)
    for k, index in enumerate(projected.index.tolist()):
        q = np.moveaxis(directions @ projected.matrix[k].T, -1, 0)
        _meet(hits, index, limits[k], q)
    return hits


def cast(
    surfaces: Surfaces,
    view: Viewpoint,
    azimuth: np.ndarray,
    elevation: np.ndarray,
    dtype: type[np.floating] = np.float64,
) -> Hits:
    """Find what the rays of a panorama meet.

    Parameters
    ----------
    surfaces : Surfaces
        Everything in the room.
    view : Viewpoint
        The camera.
    azimuth : ndarray, shape (w,)
        Of the columns [rad], evenly falling from left to right through one full turn.
    elevation : ndarray, shape (h,)
        Of the rows [rad], falling from top to bottom, within a right angle of the horizon.
    dtype : type
        float32 is enough for pictures.

    Returns
    -------
    Hits
        Of shape (h, w); distances are metres on the camera's own horizon.
    """
    hits = _nothing((elevation.size, azimuth.size), dtype)
    flat = np.stack([np.cos(azimuth), np.sin(azimuth)])
    rise = np.tan(elevation)
    projected = _project(surfaces, view)
    windows, limits = _windows(projected, azimuth, elevation), projected.limits(dtype)
    by_column = (projected.matrix[:, :, :2] @ flat).astype(dtype)
    by_row = (projected.matrix[:, :, 2:] * rise).astype(dtype)
    # A level camera sees walls at distances that hang on the column alone, and floors on the row:
    # what hangs on one of them stays a line.
    flat_too = np.any(projected.matrix[:, :, :2] != 0, axis=2).tolist()
    rise_too = (projected.matrix[:, :, 2] != 0).tolist()
    for k, index in enumerate(projected.index.tolist()):
        rows, *columns = windows[k]
        for part in columns:
            across, down = by_column[k, :, None, part], by_row[k, :, rows, None]
            q = [
                across[i] + down[i] if c and r else across[i] if c else down[i]
                for i, (c, r) in enumerate(zip(flat_too[k], rise_too[k], strict=True))
            ]
            _meet(hits.window(rows, part), index, limits[k], q)
    return hits


def points(hits: Hits, view: Viewpoint, directions: np.ndarray) -> np.ndarray:
    """Return where rays met something, (..., 3) in room coordinates [m]; NaN where nothing."""
    reach = np.where(hits.surface >= 0, hits.distance, np.nan)
    return np.asarray(view.position + (directions * reach[..., None]) @ view.rotation.T)


def directions(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """Return rays (cos a, sin a, tan e), shape (h, w, 3), of columns (w,) and rows (h,) [rad]."""
    a, rise = np.meshgrid(azimuth, np.tan(elevation))
    return np.stack([np.cos(a), np.sin(a), rise], axis=-1)


def _nothing(shape: tuple[int, ...], dtype: type[np.floating]) -> Hits:
    return Hits(
        np.full(shape, np.inf, dtype),
        np.zeros(shape, dtype),
        np.zeros(shape, dtype),
        np.full(shape, -1, np.int16),
    )


def _meet(hits: Hits, index: int, limits: Sequence[float], q: Sequence[np.ndarray]) -> None:
    """Keep those hits on a rectangle that are nearer than what was met before.

    `q` are three arrays that broadcast to the shape of the hits, `limits` as in `_Projected`.
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


def _project(surfaces: Surfaces, view: Viewpoint) -> _Projected:
    """Return the rectangles that face the camera, in its frame."""
    away = np.einsum("ni,ni->n", surfaces.normal, surfaces.corner - view.position)
    index = np.flatnonzero(away < -1e-9)
    turn = view.rotation
    corner = (surfaces.corner[index] - view.position) @ turn
    right, up = surfaces.right[index] @ turn, surfaces.up[index] @ turn
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
    return _Projected(index, rows, shift, low - SLACK, low + tiles + SLACK, sides)


def _windows(
    projected: _Projected, azimuth: np.ndarray, elevation: np.ndarray
) -> list[tuple[slice, ...]]:
    """Return for each rectangle the rows, and the one or two runs of columns, that it can cover."""
    w = azimuth.size
    step = 2 * math.pi / w
    first, turn = _azimuths(projected.corners)
    lowest, highest = _elevations(projected.corners)
    above, below = _covers_pole(projected, 1.0), _covers_pole(projected, -1.0)
    highest[above], lowest[below] = np.pi, -np.pi
    turn[above | below] = 2 * np.pi
    # Rows and columns one beyond, so that rounding loses none.
    top = np.maximum(np.searchsorted(-elevation, -highest) - 1, 0)
    bottom = np.searchsorted(-elevation, -lowest, "right") + 1
    count = np.ceil(turn / step).astype(int) + 3
    left = (np.floor((azimuth[0] - first - turn) / step).astype(int) - 1) % w
    found: list[tuple[slice, ...]] = []
    for a, b, c, n in np.stack([top, bottom, left, count], axis=1).tolist():
        if n >= w:
            found.append((slice(a, b), slice(0, w)))
        elif c + n <= w:
            found.append((slice(a, b), slice(c, c + n)))
        else:
            found.append((slice(a, b), slice(c, w), slice(0, c + n - w)))
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


def _covers_pole(projected: _Projected, pole: float) -> np.ndarray:
    """Say of each rectangle whether the ray straight up (pole 1) or down (-1) meets it."""
    q = projected.matrix[:, :, 2] * pole
    with np.errstate(divide="ignore", invalid="ignore"):
        place = q[:, 1:] / q[:, :1] + projected.shift
    inside = (place >= projected.low) & (place <= projected.high)
    return np.asarray((q[:, 0] > 0) & inside.all(axis=1))
