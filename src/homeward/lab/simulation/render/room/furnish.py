"""Random boxes, posters and movers of a room."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from itertools import count, islice

import numpy as np
from shapely import LineString, Point, contains_xy

from homeward.errors import InputError
from homeward.geometry.frames import Pose, compose
from homeward.lab.simulation.render.rays.surfaces import footprint
from homeward.lab.simulation.render.room.settings import (
    Box,
    Mover,
    Place,
    Poster,
    RenderScenario,
    Stand,
)
from homeward.lab.simulation.trajectories import SEARCH_RADIUS
from homeward.lab.simulation.world import Stream, generator

TRIES = 500
"""Number of draws after which there is no free place for an object."""
CLEAR = 0.6
"""Distance of random boxes from the path between start, way points and home [m]."""
ARC_CLEAR = SEARCH_RADIUS + 0.2
"""Their distance from the centre of the first arc of a search [m]."""
GAP = 0.03
"""Between a box and its wall, and between boxes [m]."""


def furnished(scenario: RenderScenario) -> RenderScenario:
    """Return a scenario that lists the objects that `furnish` requests, with `furnish` empty.

    Raises `InputError` where the room has no place for all of them.
    """
    wanted = scenario.furnish
    rng = generator(scenario, Stream.FURNITURE)
    room = _Room(scenario)
    boxes, posters = dict(scenario.boxes), dict(scenario.posters)
    movers = dict(scenario.movers)
    taken = {*boxes, *posters, *movers}
    for name in _names("box", wanted.boxes, taken):
        boxes[name] = _box(rng, room, boxes)
    for name in _names("poster", wanted.posters, taken):
        posters[name] = _poster(rng, room, posters)
    for name in _names("mover", wanted.movers, taken):
        movers[name] = _mover(rng, room)
    _move(rng, room, boxes, scenario)
    return scenario.model_copy(
        update={
            "furnish": type(wanted)(),
            "boxes": boxes,
            "posters": posters,
            "movers": movers,
        }
    )


class _Room:
    """Constraints on random objects."""

    def __init__(self, scenario: RenderScenario) -> None:
        self.floor = scenario.room.polygon
        self.corners = np.array(scenario.room.outline, float)
        self.height = scenario.room.height
        sides = np.roll(self.corners, -1, axis=0) - self.corners
        self.lengths = np.hypot(*sides.T)
        self.along = sides / self.lengths[:, None]
        self.inward = np.stack([-self.along[:, 1], self.along[:, 0]], axis=1)
        home = scenario.home.pose
        start = compose(home, scenario.start.in_home_frame(home))
        points = getattr(scenario.trajectory, "points", ())
        self.way = LineString([(start.x, start.y), *points, (home.x, home.y)])
        self.arc = compose(start, Pose(0.0, SEARCH_RADIUS, 0.0))

    def wall(self, rng: np.random.Generator) -> int:
        """Draw a wall, with a probability proportional to its length."""
        return int(rng.choice(len(self.lengths), p=self.lengths / self.lengths.sum()))

    def holds(self, base: np.ndarray) -> bool:
        """Whether a footprint (4, 2) is within the walls."""
        fine = np.concatenate([base + f * (np.roll(base, -1, 0) - base) for f in (0, 0.25, 0.5)])
        return bool(contains_xy(self.floor, fine).all())

    def clear_of_arc(self, at: Place, radius: float) -> bool:
        """Whether a disc [m] leaves the first arc free."""
        return math.hypot(at[0] - self.arc.x, at[1] - self.arc.y) > radius + ARC_CLEAR

    def clear_of_way(self, at: Place, radius: float) -> bool:
        """Whether a disc [m] leaves the path free."""
        return bool(self.way.distance(Point(at)) > radius + CLEAR)


def _names(kind: str, number: int, taken: Collection[str]) -> Iterator[str]:
    """Return unused names."""
    return islice((name for i in count(1) if (name := f"{kind} {i}") not in taken), number)


def _radius(size: tuple[float, ...]) -> float:
    return 0.5 * math.hypot(size[0], size[1])


def _apart(at: Place, size: tuple[float, ...], others: dict[str, Box], but: str = "") -> bool:
    """Whether a box is clear of all others, at their present and former positions."""
    return all(
        math.dist(at, pose.at) >= _radius(size) + _radius(other.size) + GAP
        for name, other in others.items()
        for pose in (other, other.stood or other)
        if name != but
    )


def _box(rng: np.random.Generator, room: _Room, others: dict[str, Box]) -> Box:
    for _ in range(TRIES):
        wall = room.wall(rng)
        length, depth, height = rng.uniform((0.3, 0.25, 0.3), (0.9, 0.5, 1.3)).tolist()
        size = (length, depth, min(height, 0.9 * room.height))
        off = room.corners[wall] + rng.uniform(0, room.lengths[wall]) * room.along[wall]
        at = off + (GAP + depth / 2 + 0.15 * rng.random()) * room.inward[wall]
        place = (round(float(at[0]), 3), round(float(at[1]), 3))
        yaw = math.atan2(room.along[wall, 1], room.along[wall, 0]) + rng.normal(0, 0.03)
        fits = room.holds(footprint(place, yaw, size[:2])) and _apart(place, size, others)
        clear = room.clear_of_way(place, _radius(size)) and room.clear_of_arc(place, _radius(size))
        if fits and clear:
            texture = str(rng.choice(["cardboard", "painted"]))
            size = tuple(round(v, 3) for v in size)
            return Box(at=place, yaw=round(yaw, 4), size=size, texture=texture)
    raise InputError(
        f"furnish.boxes: no place for {len(others) + 1} boxes; use fewer, or a larger room"
    )


def _poster(rng: np.random.Generator, room: _Room, others: dict[str, Poster]) -> Poster:
    for _ in range(TRIES):
        wall = room.wall(rng)
        width, high = rng.uniform((0.3, 0.3), (0.9, 0.9)).tolist()
        high = min(high, 0.6 * room.height)
        if room.lengths[wall] < width + 0.2:
            continue
        along = rng.uniform(width / 2 + 0.1, room.lengths[wall] - width / 2 - 0.1)
        low, top = high / 2 + 0.2 * room.height, room.height - high / 2 - 0.1 * room.height
        if all(
            p.wall != wall or abs(p.along - along) > (p.size[0] + width) / 2 + 0.05
            for p in others.values()
        ):
            return Poster(
                wall=wall,
                along=round(along, 3),
                height=round(rng.uniform(low, max(low, min(top, 2.0))), 3),
                size=(round(width, 3), round(high, 3)),
            )
    raise InputError(f"furnish.posters: the walls have no place for {len(others) + 1} posters")


def _mover(rng: np.random.Generator, room: _Room) -> Mover:
    """Draw a mover that walks between two points 0.5 m from the walls."""
    path: list[Place] = []
    for _ in range(TRIES):
        wall = room.wall(rng)
        at = room.corners[wall] + rng.uniform(0.1, 0.9) * room.lengths[wall] * room.along[wall]
        x, y = (at + 0.5 * room.inward[wall]).tolist()
        near = path and math.hypot(x - path[0][0], y - path[0][1]) < 0.4 * room.lengths.max()
        free = contains_xy(room.floor, x, y) and room.floor.exterior.distance(Point(x, y)) > 0.3
        if free and not near:
            path.append((round(x, 3), round(y, 3)))
        if len(path) == 2:
            height = min(round(rng.uniform(1.55, 1.9), 3), 0.9 * room.height)
            return Mover(
                path=tuple(path), speed=round(rng.uniform(0.5, 1.2), 3), size=(0.45, height)
            )
    raise InputError("furnish.movers: no free path to walk; use a larger room")


def _move(
    rng: np.random.Generator, room: _Room, boxes: dict[str, Box], scenario: RenderScenario
) -> None:
    """Give some boxes a former position, at a distance from the present one."""
    left = scenario.furnish.moved
    still = [name for name, box in boxes.items() if box.stood is None]
    for name in rng.permutation(still) if still else ():
        if left == 0:
            return
        old = _old_place(rng, room, boxes, str(name), scenario.furnish.shift)
        if old is not None:
            boxes[str(name)] = boxes[str(name)].model_copy(update={"stood": old})
            left -= 1
    if left:
        raise InputError("furnish.moved: no free former positions for all moved boxes; use fewer")


def _old_place(
    rng: np.random.Generator,
    room: _Room,
    boxes: dict[str, Box],
    name: str,
    shift: tuple[float, float],
) -> Stand | None:
    box = boxes[name]
    for _ in range(TRIES):
        length, direction = rng.uniform(*shift), rng.uniform(-math.pi, math.pi)
        x, y = box.at[0] + length * math.cos(direction), box.at[1] + length * math.sin(direction)
        yaw = box.yaw + rng.normal(0, 0.3)
        place = (round(x, 3), round(y, 3))
        fits = room.holds(footprint(place, yaw, box.size[:2])) and room.clear_of_way(
            place, _radius(box.size)
        )
        if fits and _apart(place, box.size, boxes, name):
            return Stand(at=place, yaw=round(yaw, 4))
    return None
