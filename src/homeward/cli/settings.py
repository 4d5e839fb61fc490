"""`homeward settings`: what can be set, where, and what it means."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from homeward.cli.options import AsJson
from homeward.cli.terminal import answer, say
from homeward.errors import InputError

if TYPE_CHECKING:
    from homeward.drives.drive import Strict


def settings(
    of: Annotated[
        str | None,
        typer.Argument(help="Whose: an estimator, a command that takes --set, or a YAML file."),
    ] = None,
    json: AsJson = False,
) -> None:
    """List what can be set, its default and its meaning; without a name, where there is any.

    What an estimator or a command takes is given as --set KEY=VALUE; in a YAML file each dot is one
    level more. A * stands for the name or number of one of several.
    """
    from homeward.drives.text.keys import keys
    from homeward.registry import estimator_names, settings_model

    models, estimators = other_models(), estimator_names()
    if of is None and json:
        answer({"settings": [*estimators, *models]})
        return
    if of is None:
        for name in estimators:
            say(f"homeward settings {name}  # homeward run --estimator {name} --set ...", "    ")
        for name, (where, _) in models.items():
            say(f"homeward settings {name}  # {where}", indent="    ")
        return
    if of in estimators or ":" in of:
        model = settings_model(of)
    elif of in models:
        model = models[of][1]
    else:
        there = ", ".join((*estimators, *models))
        raise InputError(f"nothing called {of!r} has settings: there are {there}")
    if json:
        answer({"keys": [asdict(key) for key in keys(model)]})
        return
    for key in keys(model):
        say(f"{key.name}={key.default}" + f"  # {key.meaning}" * bool(key.meaning), "    ")


def other_models() -> dict[str, tuple[str, type[Strict]]]:
    """Return where other settings are used, and their model, by the word for them."""
    from homeward.drives.drive import DriveSettings
    from homeward.drives.ros.settings import LogSettings
    from homeward.simulation.render.room.settings import RenderScenario
    from homeward.simulation.scenario import Scenario
    from homeward.studies.paper.map_settings import MapSettings
    from homeward.studies.paper.settings import PaperSettings
    from homeward.studies.planning.settings import Plan
    from homeward.studies.study.settings import StudySettings
    from homeward.vision.recorded.settings import ImageSettings

    return {
        "simulate": ("homeward simulate --set ..., scenario.yaml", Scenario),
        "render": ("homeward render --set ..., scenario.yaml", RenderScenario),
        "reproduce": ("homeward reproduce --set ...", PaperSettings),
        "study": ("the YAML file of homeward study", StudySettings),
        "map": ("the YAML file of homeward study, for a map", MapSettings),
        "plan": ("the YAML file of homeward plan", Plan),
        "drive": ("drive.yaml of a drive folder", DriveSettings),
        "images": ("images.yaml of a folder of images", ImageSettings),
        "topics": ("the topics file of a log", LogSettings),
    }
