"""Scenarios from presets, files and changes; simulations into folders."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

from homeward.drives.folder import write_folder
from homeward.errors import InputError
from homeward.io.reading import is_there, naming, shipped
from homeward.io.settings import key_parts, read_settings, validated
from homeward.io.table import write_csv
from homeward.lab.simulation.scenario import Circle, Course, Moved, Scenario
from homeward.lab.simulation.simulate import Simulation
from homeward.lab.simulation.world import World, quantise

Driven = TypeVar("Driven", bound=Course)
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
    scenario = PRESETS.get(source) or read_settings(_existing(source), Scenario)
    return changed_scenario(scenario, changes)


def changed_scenario(scenario: Driven, changes: Mapping[str, Any] | None) -> Driven:
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
        _write_world(simulation.world, folder / WORLD)


def _existing(source: str) -> Path:
    path = Path(source)
    if not is_there(path):
        raise InputError(f"neither a file nor one of the presets {', '.join(PRESETS)}", path)
    return path


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


def _write_world(world: World, path: Path) -> None:
    columns = zip(world.ids, world.in_home_frame, world.fault, strict=True)
    rows = (
        (landmark, quantise(x, 4), quantise(y, 4), int(fault != 0.0), quantise(fault, 5))
        for landmark, (x, y), fault in columns
    )
    write_csv(path, ("landmark", "x", "y", "moved", "fault"), rows)
