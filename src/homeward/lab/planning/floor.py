"""Geometry of a plan: free space and lines of sight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from homeward.errors import InputError
from homeward.lab.planning.settings import Plan

EDGE = 1e-3
"""Shelves count as smaller by this for lines of sight [m], and the outline as larger, so that none
hides landmarks on its own face."""
MAX_CELLS = 200_000


@dataclass(frozen=True)
class Floor:
    """Floor with n free points on a grid, and lines of sight."""

    outline: Polygon
    shelves: tuple[Polygon, ...]
    sight: BaseGeometry
    """Area of possible lines of sight."""
    x: np.ndarray
    """(columns,), grid coordinates [m]."""
    y: np.ndarray
    """(rows,)"""
    inside: np.ndarray
    """(rows, columns), bool: the n free points."""

    @property
    def points(self) -> np.ndarray:
        """(n, 2), free points [m]."""
        row, column = np.nonzero(self.inside)
        return np.stack([self.x[column], self.y[row]], axis=1)

    def image(self, values: np.ndarray) -> np.ndarray:
        """Return values (n,) as an image (rows, columns), NaN elsewhere."""
        image = np.full(self.inside.shape, np.nan)
        image[self.inside] = values
        return image

    def sees(self, origins: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """Return whether targets (q, 2) [m] are visible from origins (n, 2), shape (n, q)."""
        # Threads cannot share a prepared geometry.
        sight = shapely.from_wkb(shapely.to_wkb(self.sight))
        shapely.prepare(sight)
        ends = np.empty((len(origins), len(targets), 2, 2))
        ends[:, :, 0], ends[:, :, 1] = origins[:, None], targets[None]
        return np.asarray(shapely.covers(sight, shapely.linestrings(ends)))


def make_floor(plan: Plan) -> Floor:
    """Return the floor of a plan.

    Raises `InputError` when a polygon crosses itself or has no area, home or a landmark is outside
    or in a shelf, no point is free, or the grid has too many points.
    """
    outline = _polygon(plan.outline, "outline")
    shelves = tuple(_polygon(s, f"shelves.{i}") for i, s in enumerate(plan.shelves))
    solid = shapely.union_all([s.buffer(-EDGE, join_style="mitre") for s in shelves])
    sight = shapely.difference(outline.buffer(EDGE, join_style="mitre"), solid)
    shapely.prepare(sight)
    for name, place in plan.landmarks.items():
        _on_floor(f"landmarks.{name}", place, outline, shelves, sight)
    _on_floor("home", (plan.home.x, plan.home.y), outline, shelves, sight, inside=False)
    free = shapely.difference(outline, shapely.union_all(list(shelves)))
    free = free.buffer(-plan.clearance) if plan.clearance else free
    west, south, east, north = outline.bounds
    if plan.drive.length > np.hypot(east - west, north - south):
        raise InputError(f"drive.length: {plan.drive.length:g} m is longer than the floor")
    x, y = _grid(outline, plan.grid)
    shapely.prepare(free)
    inside = shapely.contains_xy(free, *np.meshgrid(x, y))
    if not inside.any():
        raise InputError("no point of the grid is free; check grid, clearance, outline and shelves")
    return Floor(outline, shelves, sight, x, y, np.asarray(inside))


def check_place(key: str, place: tuple[float, float], floor: Floor) -> None:
    """Raise `InputError` for a place [m] of the robot outside the outline or in a shelf."""
    _on_floor(key, place, floor.outline, floor.shelves, floor.sight, inside=False)


def _polygon(corners: tuple[tuple[float, float], ...], key: str) -> Polygon:
    polygon = Polygon(corners)
    if not polygon.is_valid:
        reason = shapely.is_valid_reason(polygon).replace("[", " at (").replace("]", ")")
        raise InputError(f"{key}: not a simple polygon: {reason.lower()}")
    if polygon.area < EDGE**2:
        raise InputError(f"{key}: the polygon has no area")
    return polygon


def _on_floor(
    key: str,
    place: tuple[float, float],
    outline: Polygon,
    shelves: tuple[Polygon, ...],
    sight: BaseGeometry,
    inside: bool = True,
) -> None:
    """Raise InputError for a place off the floor; a landmark may be on the face of a shelf."""
    point = shapely.Point(place)
    if shapely.covers(sight, point) and (inside or not any(s.contains(point) for s in shelves)):
        return
    where = "outside the outline"
    if outline.covers(point):
        where = f"inside shelves.{next(i for i, s in enumerate(shelves) if s.covers(point))}"
    raise InputError(f"{key}: ({place[0]:g}, {place[1]:g}) is {where}")


def _grid(outline: Polygon, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates of the centres of square cells that cover the outline."""
    west, south, east, north = outline.bounds
    size = (east - west) / step, (north - south) / step
    if max(size) > MAX_CELLS or size[0] * size[1] > MAX_CELLS:
        raise InputError(
            f"grid: {step:g} m gives more than {MAX_CELLS:,} points; use a larger spacing"
        )
    columns, rows = (max(1, round(s)) for s in size)
    x = west + (np.arange(columns) + 0.5) * (east - west) / columns
    y = south + (np.arange(rows) + 0.5) * (north - south) / rows
    return x, y
