"""Scenarios for the studio: all landmarks listed, and no code to import."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from homeward.control.laws import LAWS
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, compose
from homeward.lab.simulation.scenario import Homing, Listed, Moved, Repeat, RoomPose, Scenario
from homeward.lab.simulation.simulate import PRESETS, read_scenario
from homeward.lab.simulation.world import World, build_world
from homeward.studio.messages import MAX_NUMBER

MAX_LANDMARKS = 100
MAX_RATE_HZ = 100.0
MIN_NUMBER = 1e-9
"""Minimum of a sigma or a rate that is not 0."""


def open_scene(source: str) -> Scenario:
    """Return a scene by the name of a preset, with nothing moved, or from a YAML file.

    Errors as `as_scene`.
    """
    scenario = read_scenario(source)
    if source in PRESETS:
        scenario = scenario.model_copy(update={"moved": Moved()})
    return as_scene(scenario)


def as_scene(scenario: Scenario) -> Scenario:
    """Return a scenario whose landmarks, and faults of those that moved, are listed.

    `InputError` where it cannot be built, is too large, has a number out of range, or a law that is
    not homeward's: a scene can come from anywhere, and must not name code to run.
    """
    trajectory = scenario.trajectory
    if isinstance(trajectory, Repeat):
        raise InputError("trajectory.kind: the studio cannot repeat a route of a place")
    check_numbers(scenario)
    if isinstance(trajectory, Homing) and trajectory.law not in LAWS:
        raise InputError(f"trajectory.law: use one of {', '.join(LAWS)} in the studio")
    if scenario.landmarks.count > MAX_LANDMARKS:
        raise InputError(f"landmarks: at most {MAX_LANDMARKS} in the studio")
    if max(scenario.rates.odometry, scenario.rates.bearings) > MAX_RATE_HZ:
        raise InputError(f"rates: at most {MAX_RATE_HZ:g} Hz in the studio")
    return with_landmarks(scenario, build_world(scenario))


def check_numbers(scenario: Scenario) -> None:
    """Raise InputError for a number of a scenario that would overflow."""
    for key, value in _numbers(scenario.model_dump()):
        if key == "trajectory.duration":
            continue
        divides = "sigma" in key or key.startswith("rates.")
        if abs(value) > MAX_NUMBER or (divides and 0 < value < MIN_NUMBER):
            raise InputError(f"{key}: {value:g} is out of the studio's range")


def _numbers(value: Any, key: str = "") -> Iterator[tuple[str, float]]:
    """Yield the floats in nested mappings and sequences, with dotted keys."""
    if isinstance(value, float):
        yield key.lstrip("."), value
    inner = value.items() if isinstance(value, dict) else ()
    for part, one in enumerate(value) if isinstance(value, tuple) else inner:
        yield from _numbers(one, f"{key}.{part}")


def with_landmarks(scenario: Scenario, world: World) -> Scenario:
    """Return a scenario with the landmark positions of a world, now and at home."""
    camera = compose(world.home, scenario.home_mount.pose)
    new = {
        i: float(wrap(bearing(camera, *old) - bearing(camera, *now)))
        for i, old, now in zip(world.ids, world.places_at_home, world.places, strict=True)
    }
    faults = {i: fault for i, fault in new.items() if abs(fault) > 1e-6}
    update = {"landmarks": Listed(at=world.at), "moved": Moved(faults=faults)}
    return scenario.model_copy(update=update)


def with_start(scenario: Scenario, robot: Pose) -> Scenario:
    """Return a scenario that starts at the robot's pose, given in the home frame."""
    x, y, heading = map(float, compose(scenario.home.pose, robot))
    polar = dict.fromkeys(("R", "theta", "alpha"))
    start = scenario.start.model_copy(update={"x": x, "y": y, "heading": heading, **polar})
    return scenario.model_copy(update={"start": start})


def with_home(scenario: Scenario, robot: Pose, x: float, y: float, heading: float) -> Scenario:
    """Return a scenario with home elsewhere in the room, and the robot at its pose.

    Home is stored again there, so that no landmark has moved since. `InputError` where home would
    be in a shelf or outside the room.
    """
    if scenario.room is not None and not scenario.room.free(x, y):
        raise InputError("home: outside the room or in a shelf")
    here = with_start(scenario, robot)
    home = RoomPose(x=x, y=y, heading=heading)
    return here.model_copy(update={"home": home, "moved": Moved()})


def extent(scenario: Scenario) -> tuple[float, float, float, float]:
    """Return the rectangle to draw: x_min, y_min, x_max, y_max in room coordinates [m]."""
    if scenario.room is not None:
        return scenario.room.bounds
    world = build_world(scenario)
    robot = compose(world.home, scenario.start.in_home_frame(world.home))
    points = np.vstack([world.places, [world.home[:2], robot[:2]]])
    middle, half = points.mean(axis=0), 1.25 * float(np.abs(points - points.mean(axis=0)).max())
    half = max(half, 1.0)
    x, y = (math.floor(10 * float(v)) / 10 for v in middle)
    return x - half, y - half, x + half, y + half
