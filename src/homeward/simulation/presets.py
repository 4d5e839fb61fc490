"""Scenarios that come with homeward, by name: files of data/scenarios, as users write them."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from homeward.drives.text.settings import read_settings
from homeward.simulation.scenario import Circle, Moved, Scenario


def _shipped(name: str) -> Scenario:
    folder = Path(str(files("homeward").joinpath("data", "scenarios")))
    return read_settings(folder / f"{name}.yaml", Scenario)


WAREHOUSE, PAPER_HOMING = map(_shipped, ("warehouse", "paper-homing"))
CIRCLE = PAPER_HOMING.model_copy(
    update={
        "name": "circle",
        "moved": Moved(),
        "trajectory": Circle(speed=0.125, omega=0.25, duration=60.0),
    }
)
"""The paper's Case 4, open loop, with the same noise; its turn rate is not printed."""

PRESETS = {scenario.name: scenario for scenario in (WAREHOUSE, PAPER_HOMING, CIRCLE)}
