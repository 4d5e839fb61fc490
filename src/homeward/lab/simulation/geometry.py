"""What a camera has in view: field of view, range, and shelves in between."""

from __future__ import annotations

import numpy as np

from homeward.geometry.frames import Pose, bearing
from homeward.lab.simulation.scenario import Room, Visibility

EDGE = 1e-4
"""Shelves hide as if smaller by this all round [m], lest one hides what hangs on its own face."""


def in_view(
    camera: Pose, points: np.ndarray, visibility: Visibility, room: Room | None
) -> np.ndarray:
    """Say which points a camera has in view, whatever chance then makes of it.

    Parameters
    ----------
    camera : Pose
        In room coordinates; each part a float or an array of shape (n,).
    points : ndarray, shape (q, 2)
        In room coordinates [m].
    visibility : Visibility
        Field of view, range and whether shelves hide.
    room : Room or None
        With its shelves.

    Returns
    -------
    ndarray of bool, shape (q,) or (n, q)
    """
    each = Pose(*(np.asarray(part, float)[..., None] for part in camera))
    x, y = points[:, 0], points[:, 1]
    distance = np.hypot(x - each.x, y - each.y)
    least, most = visibility.range
    view = (least <= distance) & (distance <= most)
    view &= np.abs(bearing(each, x, y)) <= visibility.field_of_view / 2
    if visibility.occlusion and room is not None and room.shelves:
        view &= ~hidden(np.stack([camera.x, camera.y], -1), points, room)
    return np.asarray(view)


def hidden(origin: np.ndarray, points: np.ndarray, room: Room) -> np.ndarray:
    """Say which points lie behind or in a shelf.

    Parameters
    ----------
    origin : ndarray, shape (..., 2)
        From where one looks, in room coordinates [m].
    points : ndarray, shape (q, 2)
        At what [m].
    room : Room
        With its shelves.

    Returns
    -------
    ndarray of bool, shape (..., q)
    """
    shelves = np.asarray(room.shelves, float).reshape(-1, 4) + EDGE * np.array([1, 1, -1, -1])
    enter, leave = _crossing(origin[..., None, :], points - origin[..., None, :], shelves)
    return np.asarray(np.any(np.maximum(enter, 0.0) < np.minimum(leave, 1.0), axis=-1))


def first_surface(x: float, y: float, direction: float, room: Room) -> float:
    """Return how far one sees from (x, y) [m] in a direction [rad] up to a wall or shelf [m]."""
    origin, ray = np.array([x, y]), np.array([np.cos(direction), np.sin(direction)])
    rectangles = np.array([room.bounds, *room.shelves], float)
    enter, leave = _crossing(origin, ray, rectangles)
    ahead = (enter[1:] > 0) & (enter[1:] < leave[1:])
    return float(min([leave[0], *enter[1:][ahead]]))


def _crossing(
    origin: np.ndarray, ray: np.ndarray, rectangles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return where rays (..., 2) enter and leave rectangles (k, 4), as multiples of the rays.

    By slabs. Where a ray misses, it enters after it leaves, or both are NaN.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        low = (rectangles[:, :2] - origin[..., None, :]) / ray[..., None, :]
        high = (rectangles[:, 2:] - origin[..., None, :]) / ray[..., None, :]
    return np.minimum(low, high).max(axis=-1), np.maximum(low, high).min(axis=-1)
