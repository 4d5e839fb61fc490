"""Scenarios that come with homeward, by name: files of data/scenarios, as users write them."""

from __future__ import annotations

from homeward.drives.text.files import shipped
from homeward.drives.text.settings import read_settings
from homeward.simulation.scenario import Circle, Moved, Scenario

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
