"""Surfaces of a room, when home was stored or during the drive."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass

import numpy as np
from shapely import Polygon, contains_xy

from homeward.lab.simulation.render.rays.surfaces import (
    Skin,
    Surfaces,
    block,
    footprint,
    rectangle,
    upright,
)
from homeward.lab.simulation.render.room.settings import RenderScenario
from homeward.lab.simulation.render.shading.textures import Atlas, Texture, build_atlas, tag_texture

TAG_GAP = 0.002
"""Distance of a tag from its wall or box [m]."""
TILES = {"plaster": 4.0, "carpet": 4.0, "wood": 4.0, "tiles": 4.0}
"""Width of one tile of a texture [m]; others: 1 m."""


@dataclass(frozen=True)
class RoomScene:
    """The room when home was stored, or during the drive."""

    scenario: RenderScenario
    at_home: bool
    """Whether boxes are where they were when home was stored."""
    things: tuple[str, ...]
    """Names of the objects that surfaces belong to."""
    surfaces: Surfaces
    atlas: Atlas

    def blocked(self, x: float, y: float, margin: float = 0.0) -> str | None:
        """Return the box or wall that a robot at (x, y) [m] would collide with, or None."""
        if not contains_xy(self.scenario.room.polygon, x, y):
            return "a wall"
        for name, box in self.scenario.boxes.items():
            pose = box.where(self.at_home)
            size = (box.size[0] + 2 * margin, box.size[1] + 2 * margin)
            if math.dist(pose.at, (x, y)) > 0.5 * math.hypot(*size):
                continue
            below = box.base < self.scenario.camera.above_floor + margin
            if below and contains_xy(Polygon(footprint(pose.at, pose.yaw, size)), x, y):
                return name
        return None


def build_scene(scenario: RenderScenario, at_home: bool = False) -> RoomScene:
    """Return the scene when home was stored or during the drive."""
    names = ["floor", "ceiling", *(f"wall {i}" for i in range(len(scenario.room.outline)))]
    names += scenario.boxes
    textures = _textures(scenario)
    parts = [*_walls(scenario, textures), *_tags(scenario, textures, names, at_home)]
    for name, box in scenario.boxes.items():
        pose, seed = box.where(at_home), _seed(scenario, name)
        skin = Skin(textures.index(Texture(box.texture, seed)), TILES.get(box.texture, 1.0))
        parts += block(pose.at, pose.yaw, box.size, box.base, skin, names.index(name), seed)
    surfaces, atlas = Surfaces.joined(parts), build_atlas(tuple(textures))
    return RoomScene(scenario, at_home, tuple(names), surfaces, atlas)


def _seed(scenario: RenderScenario, name: str) -> int:
    """Return a seed from the names of an object and of its scenario."""
    return zlib.crc32(f"{scenario.seed} {scenario.name} {name}".encode())


def _textures(scenario: RenderScenario) -> list[Texture]:
    """Return all textures of the room, without duplicates."""
    room, seed = scenario.room, scenario.seed
    found = [Texture(kind, seed) for kind in (room.walls, room.floor, room.ceiling)]
    found += [Texture(box.texture, _seed(scenario, n)) for n, box in scenario.boxes.items()]
    if scenario.tags is not None:
        places = tag_places(scenario, at_home=False)
        found += [tag_texture(scenario.tags.family, tag.number) for tag in places]
    return list(dict.fromkeys(found))


def _walls(scenario: RenderScenario, textures: list[Texture]) -> list[Surfaces]:
    """Return floor, ceiling and walls, as objects 0, 1, 2 and so on."""
    room = scenario.room
    corners = np.array(room.outline, float)
    floor, ceiling, wall = (
        Skin(textures.index(Texture(kind, scenario.seed)), TILES.get(kind, 1.0))
        for kind in (room.floor, room.ceiling, room.walls)
    )
    low, (wide, deep) = corners.min(axis=0), np.ptp(corners, axis=0)
    x, y = np.array([wide, 0.0, 0.0]), np.array([0.0, deep, 0.0])
    parts = [
        rectangle(np.array([*low, 0.0]), x, y, floor, 0),
        rectangle(np.array([*low, room.height]), y, x, ceiling, 1),
    ]
    # Each wall shows a different part of the texture.
    along = 0.0
    for i, (a, b) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        skin = Skin(wall.texture, wall.tile, (along, 0.0))
        parts.append(upright(b, a, 0.0, room.height, skin, 2 + i))
        along += math.hypot(*(b - a)) / (wall.tile or 1.0) + 0.37
    return parts


@dataclass(frozen=True)
class TagPlace:
    """Position of a tag."""

    number: int
    thing: str
    """Name of the box or wall with the tag."""
    left: np.ndarray
    """(2,), its ends on the ground, seen from the front [m]."""
    right: np.ndarray
    middle: float
    """Height [m]."""

    @property
    def centre(self) -> np.ndarray:
        """(3,), in room coordinates [m]."""
        return np.array([*(self.left + self.right) / 2, self.middle])


def tag_places(scenario: RenderScenario, at_home: bool) -> list[TagPlace]:
    """Return the positions of tags: box k has numbers 4k to 4k + 3; tags on walls follow."""
    tags, places = scenario.tags, list[TagPlace]()
    if tags is None:
        return places
    size = 1.34 * tags.size  # with its white border

    def hang(a: np.ndarray, b: np.ndarray, at: float, middle: float, thing: str) -> None:
        """Place the next tag on the face above the line from a to b, visible from its right."""
        along = (b - a) / math.dist(a, b)
        half = 0.5 * min(size, 0.95 * math.dist(a, b), 1.9 * middle) * along
        centre = a + at * (b - a) + TAG_GAP * np.array([along[1], -along[0]])
        places.append(TagPlace(len(places), thing, centre - half, centre + half, middle))

    for name, box in scenario.boxes.items():
        pose = box.where(at_home)
        base = footprint(pose.at, pose.yaw, box.size[:2])
        for a, b in zip(base, np.roll(base, -1, axis=0), strict=True):
            hang(a, b, 0.5, box.base + box.size[2] / 2, name)
    corners = np.array(scenario.room.outline, float)
    lengths = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    for along in (np.arange(tags.walls) + 0.5) / max(tags.walls, 1) * ends[-1]:
        wall = int(np.searchsorted(ends, along)) - 1
        a, b = corners[wall], corners[(wall + 1) % len(corners)]
        hang(b, a, 1 - (along - ends[wall]) / lengths[wall], tags.height, f"wall {wall}")
    return places


def _tags(
    scenario: RenderScenario, textures: list[Texture], names: list[str], at_home: bool
) -> list[Surfaces]:
    """Return the tags as surfaces."""
    parts = []
    for tag in tag_places(scenario, at_home):
        assert scenario.tags is not None
        skin = Skin(textures.index(tag_texture(scenario.tags.family, tag.number)), None)
        half = math.dist(tag.left, tag.right) / 2
        edges = tag.left, tag.right, tag.middle - half, tag.middle + half
        parts.append(upright(*edges, skin, names.index(tag.thing)))
    return parts
