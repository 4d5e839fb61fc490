"""Simulated world: landmarks now and when home was stored, occlusion, home bearings."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, between, compose
from homeward.lab.simulation.scenario import (
    Course,
    Listed,
    OnSurfaces,
    Ring,
    Room,
    Scenario,
    Visibility,
)

EDGE = 1e-4
"""Shelves count as smaller by this for occlusion [m], so that none hides landmarks on its face."""


def in_view(
    camera: Pose, points: np.ndarray, visibility: Visibility, room: Room | None
) -> np.ndarray:
    """Return which points are in range, field of view and line of sight: (q,) or (n, q).

    The camera (its pose has floats or arrays (n,)) and the points (q, 2) are in room coordinates
    [m].
    """
    each = Pose(*(np.asarray(part, float)[..., None] for part in camera))
    x, y = points[:, 0], points[:, 1]
    distance = np.hypot(x - each.x, y - each.y)
    near, far = visibility.range
    view = (near <= distance) & (distance <= far)
    view &= np.abs(bearing(each, x, y)) <= visibility.field_of_view / 2
    if visibility.occlusion and room is not None and room.shelves:
        view &= ~hidden(np.stack([camera.x, camera.y], -1), points, room)
    return np.asarray(view)


def hidden(origin: np.ndarray, points: np.ndarray, room: Room) -> np.ndarray:
    """Return which points (q, 2) are behind or in a shelf, seen from `origin` (..., 2): (..., q).

    Both are in room coordinates [m].
    """
    shelves = np.asarray(room.shelves, float).reshape(-1, 4) + EDGE * np.array([1, 1, -1, -1])
    enter, leave = _crossing(origin[..., None, :], points - origin[..., None, :], shelves)
    return np.asarray(np.any(np.maximum(enter, 0.0) < np.minimum(leave, 1.0), axis=-1))


def first_surface(x: float, y: float, direction: float, room: Room) -> float:
    """Return the distance from (x, y) [m] to the first wall or shelf in a direction [rad] [m]."""
    origin, ray = np.array([x, y]), np.array([np.cos(direction), np.sin(direction)])
    rectangles = np.array([room.bounds, *room.shelves], float)
    enter, leave = _crossing(origin, ray, rectangles)
    ahead = (enter[1:] > 0) & (enter[1:] < leave[1:])
    return float(min([leave[0], *enter[1:][ahead]]))


def _crossing(
    origin: np.ndarray, ray: np.ndarray, rectangles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return where rays (..., 2) enter and leave rectangles (k, 4), as multiples of the rays.

    Slab method: where a ray misses, it enters after it leaves, or both are NaN.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        low = (rectangles[:, :2] - origin[..., None, :]) / ray[..., None, :]
        high = (rectangles[:, 2:] - origin[..., None, :]) / ray[..., None, :]
    return np.minimum(low, high).max(axis=-1), np.maximum(low, high).min(axis=-1)


TRIES = 1000
"""Number of draws after which there is no free place for a landmark."""
IN_FRONT = 0.01
"""Landmarks need free space at this distance in front of their surface [m]."""


class Stream(enum.IntEnum):
    """Sources of randomness; each has its own generator, so that none disturbs another."""

    LAYOUT = 0
    FAULTS = 1
    HOME = 2
    PRIOR = 3
    TIMES = 4
    ODOMETRY = 5
    ODOMETRY_CONSTANTS = 6
    VISIBILITY = 7
    BEARINGS = 8
    WRONG_IDS = 9
    FURNITURE = 10
    IMAGES = 11
    TILT = 12


def generator(scenario: Course, stream: Stream) -> np.random.Generator:
    """Return the generator of one source of randomness."""
    return np.random.default_rng([scenario.seed, int(stream)])


def quantise(value: float, decimals: int) -> float:
    """Round as in a log, without a negative zero."""
    return round(float(value), decimals) + 0.0


@dataclass(frozen=True)
class World:
    """Ground truth of the landmarks, as arrays over the q `ids`."""

    ids: tuple[str, ...]
    places: np.ndarray
    """(q, 2), positions during the drive, in room coordinates [m]."""
    places_at_home: np.ndarray
    """(q, 2), positions when home was stored, in room coordinates [m]."""
    fault: np.ndarray
    """(q,), stored minus true bearing at the home camera [rad]; 0 for unmoved landmarks."""
    home: Pose
    """In room coordinates."""

    @property
    def in_home_frame(self) -> np.ndarray:
        """(q, 2), positions during the drive, in the home frame [m]."""
        local = between(self.home, Pose(self.places[:, 0], self.places[:, 1], 0.0))
        return np.stack([local.x, local.y], axis=-1)

    @property
    def at(self) -> dict[str, tuple[float, float]]:
        """Position of each landmark during the drive, in room coordinates [m]."""
        return {i: (x, y) for i, (x, y) in zip(self.ids, self.places.tolist(), strict=True)}

    @property
    def moved(self) -> dict[str, float]:
        """Id of each moved landmark to its fault [rad]."""
        return {i: float(f) for i, f in zip(self.ids, self.fault, strict=True) if f != 0.0}


def build_world(scenario: Scenario) -> World:
    """Place the landmarks and move some of them.

    Raises `InputError` where the room has no place for them, or home cannot have seen the moved
    ones.
    """
    ids, places = _place(scenario)
    still = World(ids, places, places, np.zeros(len(ids)), scenario.home.pose)
    return _move(still, scenario)


def home_bearings(world: World, scenario: Scenario) -> dict[str, HomeBearing]:
    """Return the stored home bearings of all landmarks in view at home.

    Raises `InputError` when none is in view.
    """
    camera, sigma = _home_camera(scenario), scenario.noise.home_sigma
    noise = sigma * generator(scenario, Stream.HOME).standard_normal(len(world.ids))
    true = bearing(camera, world.places[:, 0], world.places[:, 1])
    stored = wrap(true + world.fault + noise)
    seen = in_view(camera, world.places_at_home, scenario.visibility, scenario.room)
    if not seen.any():
        raise InputError("visibility: home has no landmark in view")
    return {
        world.ids[i]: HomeBearing(quantise(stored[i], 5), sigma if sigma > 0 else math.nan)
        for i in np.flatnonzero(seen)
    }


def _home_camera(scenario: Scenario) -> Pose:
    return compose(scenario.home.pose, scenario.home_mount.pose)


def _place(scenario: Scenario) -> tuple[tuple[str, ...], np.ndarray]:
    """Return ids and positions (q, 2) in room coordinates."""
    layout, rng = scenario.landmarks, generator(scenario, Stream.LAYOUT)
    if isinstance(layout, Listed):
        return tuple(layout.at), np.array(list(layout.at.values()), float)
    if isinstance(layout, Ring):
        places = _ring(layout, scenario.home.pose, rng)
    else:
        assert scenario.room is not None  # the scenario has checked it
        places = _on_surfaces(layout, scenario.room, rng)
    width = len(str(layout.count))
    return tuple(f"L{i:0{width}d}" for i in range(1, layout.count + 1)), places


def _ring(layout: Ring, home: Pose, rng: np.random.Generator) -> np.ndarray:
    angle = 2 * math.pi * np.arange(layout.count) / layout.count
    angle = angle + rng.uniform(-layout.jitter, layout.jitter, layout.count)
    distance = rng.uniform(*layout.distance, layout.count)
    place = compose(home, Pose(distance * np.cos(angle), distance * np.sin(angle), 0.0))
    return np.stack([place.x, place.y], axis=-1)


def _on_surfaces(layout: OnSurfaces, room: Room, rng: np.random.Generator) -> np.ndarray:
    """Draw positions uniformly along walls and shelf faces, at least `spacing` apart."""
    rectangles = [room.bounds, *room.shelves]
    lengths = np.array([2 * (x1 - x0 + y1 - y0) for x0, y0, x1, y1 in rectangles])
    places: list[tuple[float, float]] = []
    tries = 0
    while len(places) < layout.count:
        which = int(rng.choice(len(rectangles), p=lengths / lengths.sum()))
        x, y, nx, ny = _on_edge(rectangles[which], rng.uniform(0.0, lengths[which]))
        side = -IN_FRONT if which == 0 else IN_FRONT
        far = all(math.hypot(x - a, y - b) >= layout.spacing for a, b in places)
        if far and room.free(x + side * nx, y + side * ny):
            places.append((x, y))
            tries = 0
        tries += 1
        if tries > TRIES:
            raise InputError(
                f"landmarks.count: the room has no space for {layout.count} landmarks"
                f" {layout.spacing:g} m apart; reduce landmarks.count or landmarks.spacing"
            )
    return np.array(places)


def _on_edge(
    rectangle: tuple[float, float, float, float], along: float
) -> tuple[float, float, float, float]:
    """Return the point at a length along a rectangle's outline, and the outward normal there."""
    x0, y0, x1, y1 = rectangle
    width, depth = x1 - x0, y1 - y0
    if along < width:
        return x0 + along, y0, 0.0, -1.0
    if along < width + depth:
        return x1, y0 + along - width, 1.0, 0.0
    if along < 2 * width + depth:
        return x1 - (along - width - depth), y1, 0.0, 1.0
    return x0, y1 - (along - 2 * width - depth), -1.0, 0.0


def _move(world: World, scenario: Scenario) -> World:
    """Give the moved landmarks a former position at which home saw them with their faults."""
    faults = scenario.moved.faults or _draw_faults(world, scenario)
    at_home, fault = world.places_at_home.copy(), world.fault.copy()
    for name, value in faults.items():
        if name not in world.ids:
            raise InputError(f"moved.faults.{name}: no such landmark")
        i = world.ids.index(name)
        old = _old_place(world.places[i], value, scenario)
        if old is None:
            raise InputError(f"moved.faults.{name}: home would not have had it in view there")
        at_home[i], fault[i] = old, value
    return World(world.ids, world.places, at_home, fault, world.home)


def _draw_faults(world: World, scenario: Scenario) -> dict[str, float]:
    """Draw moved landmarks and their faults, such that home had the former positions in view."""
    rng, q = generator(scenario, Stream.FAULTS), len(world.ids)
    sizes = rng.uniform(*scenario.moved.fault, q) * rng.choice([-1.0, 1.0], q)
    faults: dict[str, float] = {}
    for i in rng.permutation(q):
        if len(faults) == scenario.moved.count:
            break
        # The other sign if the first would have been out of view.
        for value in (float(sizes[i]), -float(sizes[i])):
            if _old_place(world.places[i], value, scenario) is not None:
                faults[world.ids[i]] = value
                break
    if len(faults) < scenario.moved.count:
        raise InputError(f"moved.count: home can have seen only {len(faults)} moved landmarks")
    return faults


def _old_place(place: np.ndarray, fault: float, scenario: Scenario) -> np.ndarray | None:
    """Return the former position of a landmark from its fault.

    It is on the surface in that direction, or else at the present distance. None when the home
    camera would have had neither in view.
    """
    camera, room = _home_camera(scenario), scenario.room
    dx, dy = place[0] - camera.x, place[1] - camera.y
    direction = math.atan2(dy, dx) + fault
    distances = [math.hypot(dx, dy)]
    if room is not None:
        distances.insert(0, first_surface(camera.x, camera.y, direction, room))
    ray = np.array([math.cos(direction), math.sin(direction)])
    for distance in distances:
        old = np.array([camera.x, camera.y]) + distance * ray
        if in_view(camera, old[None, :], scenario.visibility, room)[0]:
            return np.asarray(old)
    return None
