"""Rendered rooms of benchmarks and tests: ten shapes and sizes, sparsely furnished."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from shapely import Polygon, contains_xy, points
from shapely import distance as distance_between

from homeward.errors import InputError
from homeward.geometry.frames import Pose, between
from homeward.lab.simulation.render.room.boxes import with_boxes
from homeward.lab.simulation.render.room.settings import RenderScenario, Walls
from homeward.lab.simulation.scenario import Homing, OdometryErrors, RoomPose, StartPose
from homeward.lab.simulation.simulate import changed_scenario

TRIES = 2000
"""Number of draws of home and start before a room counts as too small."""
FREE = 1.15
"""Distance of the start from all walls [m]: the first arc is 1 m wide."""
HOME_FREE = 0.6
"""Distance of home from all walls [m]."""
SPEED = 0.15
"""[m/s]"""
STOP_RADIUS = 0.005
"""The drive ends within this distance of home [m]."""


@dataclass(frozen=True)
class RoomPlan:
    """A room's shape and its objects."""

    outline: tuple[tuple[float, float], ...]
    """Corners [m]."""
    height: float
    """[m]"""
    floor: str = "carpet"
    boxes: int = 6
    pictures: int = 5


def _oblong(width: float, depth: float) -> tuple[tuple[float, float], ...]:
    return (0.0, 0.0), (width, 0.0), (width, depth), (0.0, depth)


PLANS = {
    "study": RoomPlan(_oblong(4.0, 3.2), 2.4, "wood"),
    "bedroom": RoomPlan(_oblong(5.0, 4.0), 2.4),
    "living-room": RoomPlan(
        ((0, 0), (6.5, 0), (6.5, 3.5), (4.0, 3.5), (4.0, 5.5), (0, 5.5)), 2.5, "wood"
    ),
    "kitchen": RoomPlan(_oblong(6.0, 4.0), 2.5, "tiles"),
    "office": RoomPlan(_oblong(7.0, 5.0), 2.7),
    "corridor": RoomPlan(_oblong(11.0, 3.4), 2.6, "tiles", pictures=8),
    "classroom": RoomPlan(_oblong(9.0, 6.5), 3.0, boxes=8, pictures=8),
    "attic": RoomPlan(((0, 0), (7, 1), (8, 5), (3, 6.5), (-1, 4)), 2.5, "wood", boxes=7),
    "gallery": RoomPlan(
        ((0, 0), (10, 0), (10, 8), (5, 8), (5, 5), (0, 5)), 3.5, boxes=8, pictures=12
    ),
    "hall": RoomPlan(_oblong(14.0, 9.0), 4.0, "tiles", boxes=12, pictures=12),
}
"""By name, roughly from small to large."""


def room(
    name: str, seed: int = 0, distance: tuple[float, float] = (1.0, 4.0), moved: int = 3
) -> RenderScenario:
    """Return a room of `PLANS` with a homing drive, drawn from the seed.

    `distance` is the minimum and maximum distance of the start from home [m], as far as the room
    allows; `moved` boxes were elsewhere when home was stored. Raises `InputError` for another name.
    """
    if name not in PLANS:
        raise InputError(f"no room {name!r}: there are {', '.join(PLANS)}")
    plan = PLANS[name]
    home, start = _poses(plan, np.random.default_rng([seed, list(PLANS).index(name)]), distance)
    local = between(home, start)
    made = RenderScenario(
        name=name,
        seed=seed,
        room=Walls(outline=plan.outline, height=plan.height, floor=plan.floor),
        home=RoomPose(x=home.x, y=home.y, heading=home.heading),
        start=StartPose(
            R=round(math.hypot(local.x, local.y), 3),
            theta=round(math.atan2(local.y, local.x), 3),
            alpha=round(local.heading, 3),
            prior=False,
        ),
        odometry=OdometryErrors(
            speed_sigma=0.005, turn_sigma=0.005, speed_scale_sigma=0.005, turn_scale_sigma=0.01
        ),
        trajectory=Homing(
            speed=SPEED, duration=120.0, stop_radius=STOP_RADIUS, drives_unlocalised=True
        ),
    )
    return with_boxes(made, plan.boxes, plan.pictures, moved)


def changed_room(name: str, changes: Mapping[str, Any], moved: int = 3) -> RenderScenario:
    """Return a room with seed 0 and changes: dotted keys ("camera.width") to values."""
    return changed_scenario(room(name, moved=moved), changes)


def _poses(
    plan: RoomPlan, rng: np.random.Generator, distance: tuple[float, float]
) -> tuple[Pose, Pose]:
    """Draw home and start such that no wall is between them."""
    corners = np.array(plan.outline, float)
    low, high = corners.min(axis=0), corners.max(axis=0)
    floor = Polygon(corners)
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 25).T), -1).reshape(-1, 2)
    # Not farther from the walls than the room allows.
    free = min(FREE, float(_from_walls(floor, grid).max()) - 0.05)
    best: tuple[float, Pose, Pose] | None = None
    for _ in range(TRIES):
        (hx, hy), (sx, sy) = rng.uniform(low, high, (2, 2)).round(3).tolist()
        headings = rng.uniform(-math.pi, math.pi, 2).round(3).tolist()
        far = _from_walls(floor, np.linspace([hx, hy], [sx, sy], 9))
        if far.min() < HOME_FREE or far[-1] < free:
            continue
        length = math.hypot(sx - hx, sy - hy)
        home, start = Pose(hx, hy, headings[0]), Pose(sx, sy, headings[1])
        if distance[0] <= length <= distance[1]:
            return home, start
        off = max(distance[0] - length, length - distance[1])
        if best is None or off < best[0]:
            best = off, home, start
    if best is None:
        raise InputError("the room is too small to drive in")
    return best[1:]


def _from_walls(floor: Polygon, places: np.ndarray) -> np.ndarray:
    """Return the distances of places (n, 2) from the walls [m]; 0 outside."""
    far = distance_between(floor.exterior, points(places))
    return np.where(contains_xy(floor, places), far, 0.0)
