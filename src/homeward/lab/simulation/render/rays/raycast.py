"""Ray casting: which surface each ray meets first, and where.

A ray is a unit vector in the camera's frame, for any camera model. For a rectangle with corner o
(seen from the camera) and normal n, ray d meets its plane at the distance ``1 / q0``, and tile
coordinates there are ``q1 / q0`` and ``q2 / q0`` plus constants, with q = M d linear in d: nine
products a pixel. Each rectangle is tested only in the blocks that its pyramid can reach.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from homeward.drives.cameras.camera import tilt_matrix, unit_vectors
from homeward.geometry.se2 import rotation
from homeward.lab.simulation.render.rays.surfaces import Surfaces
from homeward.native.compiler import NativeError
from homeward.native.library import load

SLACK = 1e-6
"""Rectangles extend beyond their edges by this, in tiles, so that no ray passes between two."""

ANGLE_SLACK = 1e-4
"""Extension of cones, for the same reason [rad]."""
MIN_BLOCK, MAX_BLOCKS = 8, 64
"""Minimum number of columns of a block, and maximum number of blocks in a row of an image."""


@dataclass(frozen=True)
class Projected:
    """The m rectangles that face a camera, in its frame."""

    index: np.ndarray
    matrix: np.ndarray
    """(m, 3, 3), M."""
    shift: np.ndarray
    """(m, 2), added to q1 / q0 and q2 / q0."""
    low: np.ndarray
    """(m, 2), minimum tile coordinates."""
    high: np.ndarray
    """(m, 2), maximum tile coordinates."""
    corners: np.ndarray
    """(m, 4, 3), in the camera's frame [m]."""

    @property
    def limits(self) -> np.ndarray:
        """Shift, minimum and maximum tile coordinates, (m, 6)."""
        return np.hstack([self.shift, self.low, self.high])


def project(surfaces: Surfaces, position: np.ndarray, rotation: np.ndarray) -> Projected:
    """Return the rectangles that face a camera, in its frame; arguments as in `Viewpoint`."""
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
    """Return where each rectangle can be in an image: runs of blocks that its pyramid meets.

    From the camera a rectangle is a pyramid between four planes, and the rays of a block are within
    a cone: if the cone is beyond one of the planes, no ray of it meets the rectangle. Rows of the
    result, (k, 5) int64, are the rectangle's number, its first row and the row after its last, and
    the same for columns.
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
    """Rays of an image in blocks of rows and columns, each within a cone."""

    rows: np.ndarray
    """(high + 1,), first row of each block, and the end of the last one."""
    columns: np.ndarray
    """(wide + 1,)"""
    axis: np.ndarray
    """(high, wide, 3), unit vectors; zero for blocks without rays."""
    sine: np.ndarray
    """(high, wide), sine of the angle from the axis to the outermost ray; -1 without rays."""

    @classmethod
    def of(cls, rays: np.ndarray) -> Blocks:
        """Return the blocks of rays (3, height, width), unit vectors or NaN."""
        height, width = rays.shape[1:]
        side = max(MIN_BLOCK, -(-width // MAX_BLOCKS))
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


_INDICES, _VALUES, _SURFACES = (
    np.ctypeslib.ndpointer(dtype, flags="C_CONTIGUOUS")
    for dtype in (np.int64, np.float32, np.int16)
)
_TYPES = (
    *(4 * (ctypes.c_long,) + 2 * (_INDICES,) + 3 * (_VALUES,)),
    *(ctypes.c_double, *(3 * (_VALUES,)), _SURFACES),
)
"""Arguments of `cast` in C."""


@cache
def compiled() -> Callable[..., int] | None:
    """Return `cast` of cast.c, compiled on first use; None without a compiler."""
    source = files("homeward.lab.simulation.render.rays").joinpath("cast.c")
    try:
        function = load(source.read_text(encoding="utf-8")).functions.cast
    except NativeError:
        return None
    function.argtypes = _TYPES
    return function


TINY = 1e-30
"""Inverse of the maximum distance [1/m]."""


class Viewpoint(NamedTuple):
    """Position and rotation of a camera in the room."""

    position: np.ndarray
    """(3,) [m]"""
    rotation: np.ndarray
    """(3, 3), from the camera's frame (x along its axis, y left, z up) to the room's."""


def viewpoint(
    x: float, y: float, height: float, heading: float, roll: float = 0.0, pitch: float = 0.0
) -> Viewpoint:
    """Return the viewpoint of a camera [m, rad]; first rolled about its axis, then pitched down."""
    return Viewpoint(np.array([x, y, height]), rotation(heading) @ tilt_matrix(roll, pitch))


@dataclass(frozen=True)
class Hits:
    """Intersections of rays with surfaces; every array has the rays' shape."""

    distance: np.ndarray
    """In units of the ray's direction, infinite without an intersection."""
    across: np.ndarray
    """Tile coordinate along the surface's `right`."""
    along: np.ndarray
    """Tile coordinate along its `up`."""
    surface: np.ndarray
    """Index of the surface; -1 without an intersection."""

    def window(self, rows: slice, columns: slice) -> Hits:
        """Return a part of an image's hits, as views."""
        parts = self.distance, self.across, self.along, self.surface
        return Hits(*(part[rows, columns] for part in parts))


@dataclass(frozen=True)
class Rays:
    """Rays of an image, for any camera model."""

    planes: np.ndarray
    """(3, h, w), unit vectors in the camera's frame, by component; NaN where there is no ray."""

    @classmethod
    def of(
        cls, azimuth: np.ndarray, elevation: np.ndarray, dtype: type[np.floating] = np.float64
    ) -> Rays:
        """Return the rays of azimuths and elevations, (h, w) [rad]; float32 suffices for images."""
        return cls(np.moveaxis(unit_vectors(azimuth, elevation), -1, 0).astype(dtype, order="C"))

    @property
    def directions(self) -> np.ndarray:
        """Of all pixels, (h, w, 3)."""
        return np.moveaxis(self.planes, 0, -1)

    @cached_property
    def blocks(self) -> Blocks:
        """Blocks of the image with their cones."""
        return Blocks.of(self.planes)


def trace(surfaces: Surfaces, view: Viewpoint, directions: np.ndarray) -> Hits:
    """Intersect any rays from a viewpoint; directions (..., 3) are in the camera's frame, not 0."""
    hits = _nothing(directions.shape[:-1], np.float64)
    projected = project(surfaces, *view)
    limits = projected.limits.tolist()
    for k, index in enumerate(projected.index.tolist()):
        q = np.moveaxis(directions @ projected.matrix[k].T, -1, 0)
        _meet(hits, index, limits[k], q)
    return hits


def cast(surfaces: Surfaces, view: Viewpoint, rays: Rays) -> Hits:
    """Intersect the rays of an image (h, w), in their precision; distances are in metres."""
    planes = rays.planes
    hits = _nothing(planes.shape[1:], planes.dtype.type)
    projected = project(surfaces, *view)
    covered = windows(projected, rays.blocks)
    matrix, limits = projected.matrix.astype(planes.dtype), projected.limits.astype(planes.dtype)
    if planes.dtype == np.float32 and (native := compiled()) is not None:
        sizes = len(covered), len(matrix), *planes.shape[1:]
        given = covered, projected.index.astype(np.int64), planes, matrix, limits
        found = hits.distance, hits.across, hits.along, hits.surface
        if native(*sizes, *given, TINY, *found):
            raise ValueError("a window outside the image")
        return hits
    for k, top, bottom, left, right in covered.tolist():
        part = slice(top, bottom), slice(left, right)
        q = tuple(np.tensordot(matrix[k], planes[:, *part], 1))
        _meet(hits.window(*part), int(projected.index[k]), limits[k].tolist(), q)
    return hits


def points(hits: Hits, view: Viewpoint, directions: np.ndarray) -> np.ndarray:
    """Return the points of intersection, (..., 3) in room coordinates [m]; NaN without one."""
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
    """Keep the hits on a rectangle that are nearer than earlier hits.

    `q` are three arrays of the shape of the hits, `limits` as in `Projected`.
    """
    shift_s, shift_t, s0, t0, s1, t1 = limits
    distance = np.reciprocal(np.maximum(q[0], hits.distance.dtype.type(TINY)))
    s, t = q[1] * distance + shift_s, q[2] * distance + shift_t
    met = (q[0] > 0) & (distance < hits.distance)
    met &= (s >= s0) & (s <= s1) & (t >= t0) & (t <= t1)
    np.copyto(hits.distance, distance, where=met)
    np.copyto(hits.across, s, where=met)
    np.copyto(hits.along, t, where=met)
    np.copyto(hits.surface, index, where=met)
