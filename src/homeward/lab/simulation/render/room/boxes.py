"""Random boxes of a room: furniture along the walls, and flat ones on them."""

from __future__ import annotations

import math

import numpy as np
from shapely import LineString, Point, contains_xy

from homeward.errors import InputError
from homeward.geometry.frames import Pose, compose
from homeward.lab.simulation.render.rays.surfaces import footprint
from homeward.lab.simulation.render.room.settings import Box, Place, RenderScenario, Stand
from homeward.lab.simulation.trajectories import SEARCH_RADIUS
from homeward.lab.simulation.world import Stream, generator

TRIES = 500
"""Number of draws after which there is no free place for a box."""
CLEAR = 0.6
"""Distance of furniture from the path between start and home [m]."""
ARC_CLEAR = SEARCH_RADIUS + 0.2
"""Its distance from the centre of the first arc of a search [m]."""
GAP = 0.03
"""Between a box and its wall, and between boxes [m]."""
FLAT = 0.02
"""Depth of the boxes on the walls [m]."""


def with_boxes(
    scenario: RenderScenario,
    boxes: int,
    pictures: int,
    moved: int = 0,
    shift: tuple[float, float] = (0.4, 1.2),
) -> RenderScenario:
    """Return a scenario with random boxes, drawn from its seed, in place of its own.

    `boxes` stand along the walls, `pictures` are flat boxes on them. `moved` of the former were
    elsewhere when home was stored, at a distance within `shift` [m]. Raises `InputError` where the
    room has no place for all of them.
    """
    room = _Room(scenario)
    floor, wall = dict[str, Box](), dict[str, Box]()
    for i in range(boxes):
        floor[f"box {i + 1}"] = room.box(floor)
    for i in range(pictures):
        wall[f"picture {i + 1}"] = room.picture(wall)
    left = moved
    for name in room.rng.permutation(list(floor)).tolist():
        if left and (old := room.former(name, floor, shift)) is not None:
            floor[name] = floor[name].model_copy(update={"stood": old})
            left -= 1
    if left:
        raise InputError("no free former positions for all moved boxes; use fewer")
    return scenario.model_copy(update={"boxes": floor | wall})


def _radius(size: tuple[float, float, float]) -> float:
    return 0.5 * math.hypot(size[0], size[1])


def _apart(
    at: Place, size: tuple[float, float, float], others: dict[str, Box], but: str = ""
) -> bool:
    """Whether a box is clear of all others, at their present and former positions."""
    return all(
        math.dist(at, pose.at) >= _radius(size) + _radius(other.size) + GAP
        for name, other in others.items()
        for pose in (other, other.stood or other)
        if name != but
    )


class _Room:
    """Constraints on random boxes."""

    def __init__(self, scenario: RenderScenario) -> None:
        self.rng = generator(scenario, Stream.FURNITURE)
        self.floor = scenario.room.polygon
        self.corners = np.array(scenario.room.outline, float)
        self.height = scenario.room.height
        sides = np.roll(self.corners, -1, axis=0) - self.corners
        self.lengths = np.hypot(*sides.T)
        self.along = sides / self.lengths[:, None]
        self.inward = np.stack([-self.along[:, 1], self.along[:, 0]], axis=1)
        home = scenario.home.pose
        start = compose(home, scenario.start.in_home_frame(home))
        self.way = LineString([(start.x, start.y), (home.x, home.y)])
        self.arc = compose(start, Pose(0.0, SEARCH_RADIUS, 0.0))

    def box(self, others: dict[str, Box]) -> Box:
        """Draw a box at a wall that leaves the path and the first arc free."""
        for _ in range(TRIES):
            size = self.rng.uniform((0.3, 0.25, 0.3), (0.9, 0.5, 1.3))
            size[2] = min(size[2], 0.9 * self.height)
            off, turn = 0.15 * self.rng.random(), self.rng.normal(0, 0.03)
            made = self._at_wall(size, off, turn, 0.0, ["cardboard", "painted"])
            x, y = made.at
            radius = _radius(made.size)
            clear = math.dist((x, y), (self.arc.x, self.arc.y)) > radius + ARC_CLEAR
            if clear and self._fits(made, made.size, others):
                return made
        raise InputError(f"no place for {len(others) + 1} boxes; use fewer, or a larger room")

    def picture(self, others: dict[str, Box]) -> Box:
        """Draw a flat box on a wall."""
        for _ in range(TRIES):
            size = self.rng.uniform((0.3, FLAT, 0.3), (0.9, FLAT, 0.9))
            size[2] = min(size[2], 0.6 * self.height)
            low, top = 0.2 * self.height, min(2.0, 0.9 * self.height) - size[2] / 2
            base = self.rng.uniform(low, max(low, top - size[2] / 2))
            made = self._at_wall(size, -GAP, 0.0, base, ["print"])
            if self._holds(made, made.size) and _apart(made.at, made.size, others):
                return made
        raise InputError(f"the walls have no place for {len(others) + 1} pictures; use fewer")

    def former(self, name: str, others: dict[str, Box], shift: tuple[float, float]) -> Stand | None:
        """Draw the pose of a box before it was moved; None without a free one."""
        box = others[name]
        for _ in range(TRIES):
            length, direction = self.rng.uniform(*shift), self.rng.uniform(-math.pi, math.pi)
            x, y = (
                round(v, 3)
                for v in (
                    box.at[0] + length * math.cos(direction),
                    box.at[1] + length * math.sin(direction),
                )
            )
            old = Stand(at=(x, y), yaw=round(box.yaw + self.rng.normal(0, 0.3), 4))
            if self._fits(old, box.size, others, name):
                return old
        return None

    def _at_wall(
        self, size: np.ndarray, off: float, turn: float, base: float, textures: list[str]
    ) -> Box:
        """Return a box at a random place of a wall, drawn in proportion to its length."""
        wall = int(self.rng.choice(len(self.lengths), p=self.lengths / self.lengths.sum()))
        at = self.corners[wall] + self.rng.uniform(0, self.lengths[wall]) * self.along[wall]
        at = at + (GAP + off + size[1] / 2) * self.inward[wall]
        return Box(
            at=tuple(at.round(3).tolist()),
            yaw=round(math.atan2(self.along[wall, 1], self.along[wall, 0]) + turn, 4),
            size=tuple(size.round(3).tolist()),
            base=round(base, 3),
            texture=str(self.rng.choice(textures)),
        )

    def _holds(self, stand: Stand, size: tuple[float, float, float]) -> bool:
        """Whether a footprint is within the walls."""
        base = footprint(stand.at, stand.yaw, size[:2])
        fine = np.concatenate([base + f * (np.roll(base, -1, 0) - base) for f in (0, 0.25, 0.5)])
        return bool(contains_xy(self.floor.buffer(1e-3), fine).all())

    def _fits(
        self, stand: Stand, size: tuple[float, float, float], others: dict[str, Box], but: str = ""
    ) -> bool:
        """Whether a box is within the walls, off the path and clear of all others."""
        off = self.way.distance(Point(stand.at)) > _radius(size) + CLEAR
        return bool(off) and self._holds(stand, size) and _apart(stand.at, size, others, but)
