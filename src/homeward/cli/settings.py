"""`homeward settings`: list settings, their defaults and meanings."""

from __future__ import annotations

from dataclasses import asdict
from importlib import import_module
from typing import TYPE_CHECKING, Annotated

import typer

from homeward.cli.options import AsJson, answer, say
from homeward.errors import InputError

if TYPE_CHECKING:
    from homeward.io.keys import Strict

OTHERS = {
    "simulate": ("homeward simulate --set ..., scenario.yaml", "lab.simulation.scenario:Scenario"),
    "rooms": (
        "homeward simulate ROOM --images --set ..., scenario.yaml",
        "lab.simulation.render.room.settings:RenderScenario",
    ),
    "paper": ("homeward study paper --set ...", "lab.studies.paper.settings:PaperSettings"),
    "study": ("the YAML file of homeward study", "lab.studies.study.plan:StudySettings"),
    "plan": ("the YAML file of homeward plan", "lab.planning.settings:Plan"),
    "drive": ("drive.yaml of a drive folder", "drives.settings:DriveSettings"),
    "robot": ("robot.yaml, for --robot-file", "drives.settings:RobotSettings"),
    "images": ("images.yaml of a folder of images", "vision.recorded.settings:ImageSettings"),
    "topics": ("the topics file of a log", "drives.ros.settings:LogSettings"),
}
"""Settings other than those of estimators: where to set them, and their model."""


def settings(
    of: Annotated[
        str | None,
        typer.Argument(help="An estimator, or a name from the list without an argument."),
    ] = None,
    json: AsJson = False,
) -> None:
    """List the settings of an estimator, a command or a YAML file, with defaults and meanings.

    Give settings of estimators and commands as --set KEY=VALUE; in YAML files, each dot is a
    further level. A * is a placeholder for a name or a number.
    """
    from homeward.io.keys import keys
    from homeward.registry import estimator_names, settings_model

    estimators = estimator_names()
    if of is None and json:
        answer({"settings": [*estimators, *OTHERS]})
        return
    if of is None:
        for name in estimators:
            say(f"homeward settings {name}  # homeward run --estimator {name} --set ...", "    ")
        for name, (where, _) in OTHERS.items():
            say(f"homeward settings {name}  # {where}", indent="    ")
        return
    if of in estimators or ":" in of:
        model = settings_model(of)
    elif of in OTHERS:
        model = other_model(of)
    else:
        names = ", ".join((*estimators, *OTHERS))
        raise InputError(f"no settings named {of!r}; choose one of: {names}")
    if json:
        answer({"keys": [asdict(key) for key in keys(model)]})
        return
    for key in keys(model, elsewhere=listed_elsewhere(of)):
        value = f"={key.default}" if key.default else ""
        say(f"{key.name}{value}" + f"  # {key.meaning}" * bool(key.meaning), "    ")


def listed_elsewhere(of: str) -> dict[type[Strict], str]:
    """Return the models that files share, and the commands that list them."""
    shared = [name for name in ("drive", "robot") if name != of]
    return {other_model(name): f"`homeward settings {name}`" for name in shared}


def other_model(name: str) -> type[Strict]:
    """Return the settings model of one of `OTHERS`."""
    module, _, model = OTHERS[name][1].partition(":")
    return getattr(import_module(f"homeward.{module}"), model)  # type: ignore[no-any-return]
