"""Simulator of drives, with its presets and files.

Ground truth follows the commanded twist exactly; odometry and bearings measure it with errors.
Numbers are rounded as in a log: stamps to 1 ms (the world is sampled at the rounded stamp), twists
to 1e-4 m/s and rad/s, bearings to 1e-5 rad, ground truth and start prior to 1e-4 m and rad. An
estimator in the loop receives the rounded numbers, so that a replay of the drive repeats it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
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
from homeward.lab.simulation.scenario import Course, Scenario
from homeward.lab.simulation.trajectories import as_visitor
from homeward.lab.simulation.world import World, build_world, home_bearings, quantise
from homeward.plugins import require_confirmed


@dataclass(frozen=True)
class Simulation(Driven):
    """A simulated drive with its ground truth."""

    scenario: Scenario
    world: World
    reason: str
    """Why the robot gave up, if it did."""


def prepare(scenario: Scenario) -> Drive:
    """Return the drive of a scenario before it begins: home and settings, no samples.

    An estimator for the closed loop is made from it. Where a route is repeated, it contains the
    place instead of home. Raises `InputError` when the scenario cannot be built.
    """
    return as_visitor(scenario, _prepare(scenario, build_world(scenario)))


def simulate(
    scenario: Scenario,
    estimator: Estimator | None = None,
    progress: Callable[[float], None] | None = None,
) -> Simulation:
    """Simulate a drive; the same scenario gives the same drive to the last bit.

    `estimator`, made for ``prepare(scenario)``, steers the robot; None: the true pose does.
    `progress` receives the fraction of the maximum duration, in [0, 1]. Raises `InputError` when
    the scenario cannot be built, or names an estimator and none is given.
    """
    if estimator is None and scenario.estimator != "truth":
        raise InputError(f"estimator: the scenario is steered by {scenario.estimator}; pass it")
    world = build_world(scenario)
    camera, log = Camera(scenario, world), Log(estimator, scenario.sensor.yaw)
    before = _prepare(scenario, world)

    def look(t: float, robot: Pose) -> None:
        log.bearings(t, camera.look(robot))

    ending, pose = drive_course(scenario, log, look, before.home_bearings(), progress)
    drive = log.fill(before)
    return Simulation(drive, ending, pose, log.estimates, scenario, world, log.failure)


def _prepare(scenario: Scenario, world: World) -> Drive:
    sigma = scenario.noise.bearing_sigma or None
    return before(scenario, home_bearings(world, scenario), sigma, scenario.view)


AnyCourse = TypeVar("AnyCourse", bound=Course)
SCENARIO, WORLD = "scenario.yaml", "world.csv"
PRESETS = {
    name: read_settings(shipped("scenarios", f"{name}.yaml"), Scenario)
    for name in ("warehouse", "paper-homing", "circle")
}
"""Scenarios that ship with homeward, by name."""
WAREHOUSE, PAPER_HOMING, CIRCLE = PRESETS.values()


def load_scenario(source: str, changes: Mapping[str, Any] | None = None) -> Scenario:
    """Return a preset by name, or a scenario from a YAML file, with optional changes.

    Changes are dotted keys ("noise.bearing_sigma") to new values. A new `trajectory.kind` keeps
    speed and duration; `teach` also keeps the points. Raises `InputError` for a file that cannot be
    read, an unknown key, a value out of range, or a file that names Python code
    (``package.module:attribute``) as its estimator or law; `changes` may name code.
    """
    scenario = changed_scenario(read_scenario(source), changes)
    require_own_code(scenario, changes, source)
    return scenario


def read_scenario(source: str) -> Scenario:
    """Return a preset by name, or a scenario from a YAML file, which may name code to execute."""
    if (scenario := PRESETS.get(source)) is None:
        scenario = read_settings(shipped_or_file(source, "presets", PRESETS), Scenario)
    return scenario


def require_own_code(scenario: Course, changes: Mapping[str, Any] | None, source: str) -> None:
    """Raise `InputError` where a scenario's file `source` names code that `changes` do not name."""
    law = getattr(scenario.trajectory, "law", "")
    named = [("estimator", scenario.estimator, "--estimator ")]
    named.append(("trajectory.law", law, "--set trajectory.law="))
    # A change may set a whole section, such as the trajectory.
    given = {text for value in (changes or {}).values() for text in _texts(value)}
    require_confirmed(named, given, Path(source))


def _texts(value: Any) -> Iterator[str]:
    """Yield the texts in nested mappings."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for inner in value.values():
            yield from _texts(inner)


def changed_scenario(scenario: AnyCourse, changes: Mapping[str, Any] | None) -> AnyCourse:
    """Return a scenario with some keys changed; see `load_scenario`."""
    if not changes:
        return scenario
    tree = scenario.model_dump(exclude_none=True)
    for key, value in changes.items():
        _change(tree, key, value)
    return validated(type(scenario), tree)


def scenario_yaml(scenario: Course) -> str:
    """Return the whole scenario as YAML text, including defaults."""
    tree = scenario.model_dump(mode="json", exclude_none=True)
    return yaml.safe_dump(tree, sort_keys=False, default_flow_style=None)


def write_simulation(simulation: Simulation, folder: Path) -> None:
    """Write the drive folder, scenario.yaml, and world.csv with the ground truth of landmarks.

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
    """Set one dotted key in nested mappings."""
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
