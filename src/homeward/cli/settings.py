"""`homeward settings`: list settings, their defaults and meanings."""

from __future__ import annotations

from dataclasses import asdict
from importlib import import_module
from typing import TYPE_CHECKING, Annotated

import typer

from homeward.cli.options import AsJson, answer, say
from homeward.errors import InputError

if TYPE_CHECKING:
    from homeward.io.models import Strict

OTHERS = {
    "simulate": ("homeward simulate --set ..., scenario.yaml", "lab.simulation.scenario:Scenario"),
    "rooms": (
        "homeward simulate ROOM --images --set ..., scenario.yaml",
        "lab.simulation.render.room.settings:RenderScenario",
    ),
    "paper": ("homeward study paper --set ...", "lab.studies.paper.settings:PaperSettings"),
    "live": ("homeward live --set ..., settings of the ROS 2 node", "live.settings:LiveSettings"),
    "study": ("the YAML file of homeward study", "lab.studies.study.plan:StudySettings"),
    "plan": ("the YAML file of homeward plan", "lab.planning.settings:Plan"),
    "drive": ("drive.yaml of a drive folder", "drives.settings:DriveSettings"),
    "robot": ("robot.yaml, for --robot-file", "drives.settings:RobotSettings"),
    "images": ("images.yaml of a folder of images", "vision.recorded.settings:ImageSettings"),
    "topics": ("the topics file of a log", "drives.ros.settings:LogSettings"),
}
"""Settings other than those of estimators: where to set them, and their model."""
LISTED_ONCE: dict[str, tuple[str, str, tuple[str, ...] | None]] = {
    "drives.settings:DriveSettings": ("drive", "", None),
    "drives.settings:RobotSettings": ("robot", "", None),
    "drives.settings:Wheels": ("robot", "wheels", None),
    "drives.cameras.lens:Lens": ("images", "camera", ("topics",)),
    "lab.simulation.scenario:Course": ("simulate", "", ("rooms",)),
    "lab.filters.settings:FilterSettings": (
        "ekf",
        "",
        ("a-ekf", "pi-ekf", "schmidt", "adaptive", "ukf"),
    ),
    "lab.filters.settings:CartesianSettings": ("invariant", "", ("particle",)),
}
"""Models by the listing that has their keys, the key there, and the listings that name it (None:
all)."""


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
    from homeward.io.models import keys
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
        hint = "; those of `homeward run` are an estimator's" if of in ("run", "place") else ""
        raise InputError(f"no settings named {of!r}{hint}; choose one of: {names}")
    if json:
        answer({"keys": [asdict(key) for key in keys(model)]})
        return
    known = listed_elsewhere(of)
    if model in known:
        say(f"all keys are as {known[model]}", "    ")
        return
    for key in keys(model, elsewhere=known):
        value = f"={key.default}" if key.default else ""
        say(f"{key.name}{value}" + f"  # {key.meaning}" * bool(key.meaning), "    ")


def listed_elsewhere(of: str) -> dict[type[Strict], str]:
    """Return the models that are listed once for all, and the commands that list them."""
    return {
        _imported(model): f"{part and f'`{part}` of '}`homeward settings {name}`"
        for model, (name, part, readers) in LISTED_ONCE.items()
        if name != of and (readers is None or of in readers)
    }


def other_model(name: str) -> type[Strict]:
    """Return the settings model of one of `OTHERS`."""
    return _imported(OTHERS[name][1])


def _imported(model: str) -> type[Strict]:
    module, _, name = model.partition(":")
    return getattr(import_module(f"homeward.{module}"), name)  # type: ignore[no-any-return]
