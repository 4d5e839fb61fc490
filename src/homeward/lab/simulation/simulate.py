"""The simulator: truth, sensors, perhaps an estimator, and a control law; its presets and files.

The truth follows the commanded twist exactly; odometry and bearings measure it with their errors.
Numbers are kept as a log would hold them: stamps to 1 ms (the world is sampled at the rounded
stamp), twists to 1e-4 m/s and rad/s, bearings to 1e-5 rad, truth and start prior to 1e-4 m and rad.
An estimator in the loop gets these very numbers, so that a replay of the drive repeats it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml

from homeward.drives.drive import Drive
from homeward.drives.folder import write_folder
from homeward.errors import InputError
from homeward.estimator import Estimator
from homeward.geometry.frames import Pose
from homeward.io.reading import naming, shipped, shipped_or_file
from homeward.io.settings import key_parts, read_settings, validated
from homeward.io.table import write_csv
from homeward.lab.simulation.course import Camera, Driven, Log, before, drive_course
from homeward.lab.simulation.scenario import Circle, Course, Moved, Scenario
from homeward.lab.simulation.trajectories import as_visitor
from homeward.lab.simulation.world import World, build_world, home_bearings, quantise


@dataclass(frozen=True)
class Simulation(Driven):
    """A simulated drive, and the truth about it."""

    scenario: Scenario
    world: World
    reason: str
    """Why the robot gave up, if it did."""


def prepare(scenario: Scenario) -> Drive:
    """Return the drive of a scenario before it begins: home and settings, no samples.

    An estimator for the closed loop is made from this; where a route is repeated, it knows the
    place instead of home. Raises `InputError` when the scenario cannot be built.
    """
    return as_visitor(scenario, _prepare(scenario, build_world(scenario)))


def simulate(
    scenario: Scenario,
    estimator: Estimator | None = None,
    progress: Callable[[float], None] | None = None,
) -> Simulation:
    """Simulate a drive, which follows from its scenario to the last bit.

    The pose of a fresh estimator, made for ``prepare(scenario)`` and used up, steers the robot;
    None: the truth. `progress` gets the share of the longest duration that is done, in [0, 1].
    Raises `InputError` when the scenario cannot be built, or names an estimator and none is given.
    """
    if estimator is None and scenario.estimator != "truth":
        raise InputError(f"estimator: the scenario is steered by {scenario.estimator}; none given")
    world = build_world(scenario)
    camera, log = Camera(scenario, world), Log(estimator, scenario.sensor.yaw)
    before = _prepare(scenario, world)

    def look(t: float, robot: Pose) -> None:
        log.bearings(t, camera.look(robot))

    ending, pose = drive_course(scenario, log, look, before.home_bearings(), progress)
    drive = log.fill(before)
    return Simulation(drive, ending, pose, log.estimates, scenario, world, log.last_words)


def _prepare(scenario: Scenario, world: World) -> Drive:
    sigma = scenario.noise.bearing_sigma or None
    return before(scenario, home_bearings(world, scenario), sigma, scenario.view)


AnyCourse = TypeVar("AnyCourse", bound=Course)
SCENARIO, WORLD = "scenario.yaml", "world.csv"
WAREHOUSE, PAPER_HOMING = (
    read_settings(shipped("scenarios", f"{name}.yaml"), Scenario)
    for name in ("warehouse", "paper-homing")
)
CIRCLE = PAPER_HOMING.model_copy(
    update={
        "name": "circle",
        "moved": Moved(),
        "trajectory": Circle(speed=0.125, omega=0.25, duration=60.0),
    }
)
"""The paper's Case 4, open loop, with the same noise; its turn rate is not printed."""
PRESETS = {scenario.name: scenario for scenario in (WAREHOUSE, PAPER_HOMING, CIRCLE)}
"""Scenarios that come with homeward, by name: files of data/scenarios, as users write them."""


def load_scenario(source: str, changes: Mapping[str, Any] | None = None) -> Scenario:
    """Return a scenario by the name of a preset or from a YAML file, perhaps changed.

    Changes are keys in dots ("noise.bearing_sigma") to new values. Another `trajectory.kind` keeps
    the speed and duration of the old one, and to teach its points, too. Raises `InputError` for a
    file that cannot be read, a key that does not exist, or a value out of range.
    """
    if (scenario := PRESETS.get(source)) is None:
        scenario = read_settings(shipped_or_file(source, "presets", PRESETS), Scenario)
    return changed_scenario(scenario, changes)


def changed_scenario(scenario: AnyCourse, changes: Mapping[str, Any] | None) -> AnyCourse:
    """Return a scenario with some keys changed; parameters and errors as `load_scenario`."""
    if not changes:
        return scenario
    tree = scenario.model_dump(exclude_none=True)
    for key, value in changes.items():
        _change(tree, key, value)
    return validated(type(scenario), tree)


def scenario_yaml(scenario: Course) -> str:
    """Return the whole scenario as YAML text, defaults and all."""
    tree = scenario.model_dump(mode="json", exclude_none=True)
    return yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)


def write_simulation(simulation: Simulation, folder: Path) -> None:
    """Write the drive folder, scenario.yaml, and world.csv: the truth about the landmarks.

    world.csv has landmark, x, y [m, home frame], moved (0 or 1) and fault [rad]; no estimator reads
    it. Raises `InputError` when the folder cannot be written.
    """
    write_folder(simulation.drive, folder)
    with naming(folder, "cannot be written"):
        (folder / SCENARIO).write_text(scenario_yaml(simulation.scenario), encoding="utf-8")
        world, head = simulation.world, ("landmark", "x", "y", "moved", "fault")
        columns = zip(world.ids, world.in_home_frame, world.fault, strict=True)
        rows = (
            (landmark, quantise(x, 4), quantise(y, 4), int(fault != 0.0), quantise(fault, 5))
            for landmark, (x, y), fault in columns
        )
        write_csv(folder / WORLD, head, rows)


def _change(tree: dict[str, Any], key: str, value: Any) -> None:
    """Set one key, given in dots, in nested mappings."""
    *sections, last = key_parts(key)
    branch = tree
    for section in sections:
        inner = branch.setdefault(section, {})
        if not isinstance(inner, dict):
            raise InputError(f"{key}: {section} has no keys")
        branch = inner
    if key == "trajectory.kind" and branch.get("kind") != value:
        points = {"points", "end_at_home"} if value == "teach" else set()
        for other in branch.keys() - {"speed", "duration"} - points:
            del branch[other]
    branch[last] = value
