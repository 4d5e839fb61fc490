"""Polygons on the ground."""

from __future__ import annotations

import numpy as np


def is_clockwise(corners: np.ndarray) -> bool:
    """Say whether a polygon (n, 2) runs clockwise."""
    x, y = corners.T
    return bool(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) < 0)


def crosses_itself(corners: np.ndarray) -> bool:
    """Say whether two sides of a polygon (n, 2) cross or touch that are not neighbours."""
    a, b = corners, np.roll(corners, -1, axis=0)
    n = len(corners)
    for i in range(n):
        for j in range(i + 2, n - (i == 0)):
            if _cross(a[i], b[i], a[j], b[j]):
                return True
    return False


def inside(corners: np.ndarray, x: float, y: float) -> bool:
    """Say whether a point lies inside a polygon (n, 2)."""
    (ax, ay), (bx, by) = corners.T, np.roll(corners, -1, axis=0).T
    spans = (ay > y) != (by > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = ax + (y - ay) * (bx - ax) / (by - ay)
    return bool(np.sum(spans & (x < at)) % 2)


def distance_to(corners: np.ndarray, x: float, y: float) -> float:
    """Return the distance of a point from the nearest side of a polygon (n, 2)."""
    a, side = corners, np.roll(corners, -1, axis=0) - corners
    along = np.einsum("ni,ni->n", (x, y) - a, side) / np.einsum("ni,ni->n", side, side)
    nearest = a + np.clip(along, 0.0, 1.0)[:, None] * side
    return float(np.min(np.hypot(nearest[:, 0] - x, nearest[:, 1] - y)))


def _cross(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> bool:
    """Say whether the lines from a to b and from c to d meet."""

    def side(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> float:
        return float((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))

    return side(a, b, c) * side(a, b, d) <= 0 and side(c, d, a) * side(c, d, b) <= 0
