"""Lit surfaces of a room, when home was stored or during the drive.

Light is an ambient share and one lamp under the ceiling, with Lambert's law and shadows.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass

import numpy as np
from shapely import Polygon, contains_xy

from homeward.lab.simulation.render.rays.raycast import Viewpoint, trace
from homeward.lab.simulation.render.rays.surfaces import (
    Skin,
    Surfaces,
    block,
    footprint,
    rectangle,
    upright,
)
from homeward.lab.simulation.render.room.settings import Mover, RenderScenario
from homeward.lab.simulation.render.shading.textures import Atlas, Texture, build_atlas, tag_texture

GRID = 16
"""Number of grid points along each side of a surface at which light is computed; between them it is
interpolated."""
AMBIENT = 0.45
"""Ambient light; the lamp adds up to about 1."""
REACH = 2.5
"""Distance at which the lamp's light has fallen to half [m]."""
FLAT = 0.005
"""Objects this close to a surface (posters, tags) cast no shadow on it [m]: the coarse light grid
would extend that shadow beyond their edges."""


def light_on(surfaces: Surfaces, lamp: np.ndarray, casting: Surfaces | None = None) -> np.ndarray:
    """Return the light on surfaces from a lamp at (3,) [m], with the shadows of `casting`.

    It is float32 of shape (n, g, g), rows along `up`, columns along `right`.
    """
    b, a = np.mgrid[0 : 1 : GRID * 1j, 0 : 1 : GRID * 1j].reshape(2, -1)
    towards = lamp - surfaces.at(a, b)
    distance = np.maximum(np.linalg.norm(towards, axis=-1), 1e-6)
    above = np.maximum(np.einsum("nmi,ni->nm", towards, surfaces.normal), 0.0)
    lit = above / distance / (1.0 + (distance / REACH) ** 2)
    if casting is not None:
        bright = lit > 0
        met = trace(casting, Viewpoint(lamp, np.eye(3)), -towards[bright]).distance
        lit[bright] *= (1.0 - met) * above[bright] < FLAT
    return np.asarray((AMBIENT + lit).reshape(-1, GRID, GRID), np.float32)


POSTER_GAP = 0.002
"""Distance of a poster from its wall [m]."""
STEP_ASIDE = 0.7
"""Minimum distance of movers from the camera [m]."""
TILES = {"plaster": 4.0, "carpet": 4.0, "wood": 4.0, "tiles": 4.0}
"""Width of one tile of a texture [m]; others: 1 m."""


@dataclass(frozen=True)
class RoomScene:
    """The room without its movers."""

    scenario: RenderScenario
    """Furnished scenario."""
    at_home: bool
    """Whether boxes are where they were when home was stored."""
    things: tuple[str, ...]
    """Names of the objects that surfaces belong to, movers last."""
    still: Surfaces
    light: np.ndarray
    """(surfaces, g, g), brightness on a grid, rows along `up`."""
    textures: tuple[Texture, ...]
    atlas: Atlas
    lamp: np.ndarray
    """(3,) [m]"""

    def at(self, t: float, view: Viewpoint) -> tuple[Surfaces, np.ndarray]:
        """Return all surfaces and their light, with movers at their positions at `t` [s].

        Movers keep a distance from the camera.
        """
        people = self._people(t, view)
        if people is None:
            return self.still, self.light
        shone = light_on(people, self.lamp)
        return Surfaces.joined([self.still, people]), np.concatenate([self.light, shone])

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

    def _people(self, t: float, view: Viewpoint) -> Surfaces | None:
        parts, scenario = list[Surfaces](), self.scenario
        for name, mover in scenario.movers.items():
            x, y, yaw = _aside(place_on_path(mover, t), view)
            width, height = mover.size
            seed, thing, body = _seed(scenario, name), self.things.index(name), 0.86 * height
            skin = Skin(self.textures.index(Texture(mover.texture, seed)), 1.0)
            size = (0.6 * width, width, body)
            parts += block((x, y), yaw, size, 0.0, skin, thing, seed)
            head = (0.45 * width, 0.4 * width, height - body)
            parts += block((x, y), yaw, head, body, skin, thing, seed + 1)
        return Surfaces.joined(parts) if parts else None


def build_scene(scenario: RenderScenario, at_home: bool = False) -> RoomScene:
    """Return the scene of a `furnished` scenario, when home was stored or during the drive."""
    room = scenario.room
    names = ["floor", "ceiling", *(f"wall {i}" for i in range(len(room.outline)))]
    names += [*scenario.boxes, *scenario.posters, *scenario.movers]
    textures = _textures(scenario)
    parts = [*_walls(scenario, textures), *_posters(scenario, textures, names)]
    parts += [*_tags(scenario, textures, names, at_home)]
    for name, box in scenario.boxes.items():
        pose, seed = box.where(at_home), _seed(scenario, name)
        skin = Skin(textures.index(Texture(box.texture, seed)), TILES.get(box.texture, 1.0))
        parts += block(pose.at, pose.yaw, box.size, box.base, skin, names.index(name), seed)
    still = Surfaces.joined(parts)
    lamp = _lamp(scenario)
    return RoomScene(
        scenario,
        at_home,
        tuple(names),
        still,
        light_on(still, lamp, casting=still),
        tuple(textures),
        build_atlas(tuple(textures)),
        lamp,
    )


def place_on_path(mover: Mover, t: float) -> tuple[float, float, float]:
    """Return x, y [m] and heading [rad] of a mover at time `t` [s]."""
    path = np.array(mover.path, float)
    lengths = np.hypot(*np.diff(path, axis=0).T)
    total = float(lengths.sum())
    if total == 0.0 or mover.speed == 0.0:
        return float(path[0, 0]), float(path[0, 1]), 0.0
    way = (mover.speed * t) % (2 * total)
    forth = way <= total
    at = way if forth else 2 * total - way
    knots = np.concatenate([[0.0], np.cumsum(lengths)])
    leg = min(int(np.searchsorted(knots, at, "right")) - 1, len(lengths) - 1)
    x, y = (float(np.interp(at, knots, path[:, i])) for i in (0, 1))
    dx, dy = path[leg + 1] - path[leg]
    return x, y, math.atan2(dy, dx) + (0.0 if forth else math.pi)


def _aside(place: tuple[float, float, float], view: Viewpoint) -> tuple[float, float, float]:
    """Return a mover's position, moved away from a camera that is too close."""
    x, y, yaw = place
    dx, dy = x - view.position[0], y - view.position[1]
    distance = math.hypot(dx, dy)
    if distance >= STEP_ASIDE:
        return place
    if distance < 1e-9:
        dx, dy, distance = -math.sin(yaw), math.cos(yaw), 1.0
    away = STEP_ASIDE / distance
    return float(view.position[0] + away * dx), float(view.position[1] + away * dy), yaw


def _seed(scenario: RenderScenario, name: str) -> int:
    """Return a seed from the names of an object and of its scenario."""
    return zlib.crc32(f"{scenario.seed} {scenario.name} {name}".encode())


def _textures(scenario: RenderScenario) -> list[Texture]:
    """Return all textures of the room, without duplicates."""
    room, seed = scenario.room, scenario.seed
    found = [Texture(kind, seed) for kind in (room.walls, room.floor, room.ceiling)]
    for things in (scenario.boxes, scenario.posters, scenario.movers):
        found += [Texture(thing.texture, _seed(scenario, n)) for n, thing in things.items()]
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


def _posters(scenario: RenderScenario, textures: list[Texture], names: list[str]) -> list[Surfaces]:
    corners = np.array(scenario.room.outline, float)
    parts = []
    for name, poster in scenario.posters.items():
        a, b = corners[poster.wall], corners[(poster.wall + 1) % len(corners)]
        along = (b - a) / math.hypot(*(b - a))
        middle = a + poster.along * along + POSTER_GAP * np.array([-along[1], along[0]])
        half = 0.5 * poster.size[0] * along
        bottom = poster.height - poster.size[1] / 2
        skin = Skin(textures.index(Texture(poster.texture, _seed(scenario, name))), None)
        edges = middle + half, middle - half, bottom, bottom + poster.size[1]
        parts.append(upright(*edges, skin, names.index(name)))
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
        centre = a + at * (b - a) + POSTER_GAP * np.array([along[1], -along[0]])
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


def _lamp(scenario: RenderScenario) -> np.ndarray:
    """Return a place under the ceiling: in the middle, or above home if the middle is outside."""
    corners = np.array(scenario.room.outline, float)
    x, y = corners.mean(axis=0).tolist()
    if not contains_xy(scenario.room.polygon, x, y):
        x, y = scenario.home.x, scenario.home.y
    return np.array([x, y, 0.92 * scenario.room.height])
