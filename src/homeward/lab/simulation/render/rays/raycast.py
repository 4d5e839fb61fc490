"""Ray casting: which surface each ray meets first, and where.

A ray is a unit vector in the camera's frame, for any camera model. For a rectangle with corner o
(seen from the camera) and normal n, ray d meets its plane at the distance ``1 / q0``, and tile
coordinates there are ``q1 / q0`` and ``q2 / q0`` plus constants, with q = M d linear in d: nine
products a pixel. Every rectangle that faces the camera is tested with every ray.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from homeward.drives.cameras.camera import tilt_matrix
from homeward.geometry.se2 import rotation
from homeward.lab.engine.native.compiler import NativeError
from homeward.lab.engine.native.library import load
from homeward.lab.simulation.render.rays.surfaces import Surfaces

SLACK = 1e-6
"""Rectangles extend beyond their edges by this, in tiles, so that no ray passes between two."""


def projected(
    surfaces: Surfaces, position: np.ndarray, rotation: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the m rectangles that face a camera, in its frame; arguments as in `Viewpoint`.

    These are their indices (m,), the matrices M (m, 3, 3), and limits (m, 6): the numbers added to
    q1 / q0 and q2 / q0, and the minimum and maximum of both tile coordinates.
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
    return index, rows, np.hstack([shift, low - SLACK, low + tiles + SLACK])


_INDICES, _VALUES, _SURFACES = (
    np.ctypeslib.ndpointer(dtype, flags="C_CONTIGUOUS")
    for dtype in (np.int64, np.float32, np.int16)
)
_TYPES = (
    *(2 * (ctypes.c_long,) + (_INDICES,) + 3 * (_VALUES,)),
    *(ctypes.c_double, *(3 * (_VALUES,)), _SURFACES),
)
"""Arguments of `cast` in C."""


@cache
def compiled() -> Callable[..., None] | None:
    """Return `cast` of cast.c, compiled on first use; None without a compiler."""
    source = files("homeward.lab.simulation.render.rays").joinpath("cast.c")
    try:
        function = load(source.read_text(encoding="utf-8")).functions.cast
    except NativeError:
        return None
    function.argtypes, function.restype = _TYPES, None
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


def trace(surfaces: Surfaces, view: Viewpoint, directions: np.ndarray) -> Hits:
    """Intersect any rays from a viewpoint, in their precision; float32 suffices for images.

    Directions (..., 3) are in the camera's frame, not 0, and NaN where there is no ray.
    """
    kind, shape = directions.dtype, directions.shape[:-1]
    hits = Hits(
        np.full(shape, np.inf, kind),
        np.zeros(shape, kind),
        np.zeros(shape, kind),
        np.full(shape, -1, np.int16),
    )
    indices, *both = projected(surfaces, *view)
    matrix, limits = (part.astype(kind) for part in both)
    planes = np.ascontiguousarray(np.moveaxis(directions, -1, 0))
    if kind == np.float32 and (native := compiled()) is not None:
        given = indices.astype(np.int64), planes, matrix, limits
        found = hits.distance, hits.across, hits.along, hits.surface
        native(hits.surface.size, len(matrix), *given, TINY, *found)
        return hits
    for k, index in enumerate(indices.tolist()):
        _meet(hits, index, limits[k].tolist(), list(np.tensordot(matrix[k], planes, 1)))
    return hits


def points(hits: Hits, view: Viewpoint, directions: np.ndarray) -> np.ndarray:
    """Return the points of intersection, (..., 3) in room coordinates [m]; NaN without one."""
    reach = np.where(hits.surface >= 0, hits.distance, np.nan)
    return np.asarray(view.position + (directions * reach[..., None]) @ view.rotation.T)


def _meet(hits: Hits, index: int, limits: Sequence[float], q: Sequence[np.ndarray]) -> None:
    """Keep the hits on a rectangle that are nearer than earlier hits.

    `q` are three arrays of the shape of the hits, `limits` as of `projected`.
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
