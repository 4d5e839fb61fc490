"""`homeward settings`: what can be set, where, and what it means."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from homeward.cli.terminal import say
from homeward.errors import InputError

if TYPE_CHECKING:
    from homeward.drives.drive import Strict


def settings(
    of: Annotated[
        str | None,
        typer.Argument(help="Whose: an estimator, a command that takes --set, or a YAML file."),
    ] = None,
) -> None:
    """List what can be set, its default and its meaning; without a name, where there is any.

    What an estimator or a command takes is given as --set KEY=VALUE; in a YAML file each dot is one
    level more. A * stands for the name or number of one of several.
    """
    from homeward.drives.text.keys import keys

    there = _models()
    if of is None:
        for name, (where, _) in there.items():
            say(f"homeward settings {name}  # {where}", indent="    ")
    elif of in there:
        for key in keys(there[of][1]):
            say(f"{key.name}={key.default}" + f"  # {key.meaning}" * bool(key.meaning), "    ")
    else:
        raise InputError(f"nothing called {of!r} has settings: there are {', '.join(there)}")


def _models() -> dict[str, tuple[str, type[Strict]]]:
    """Return where settings are used, and their model, by the word for them."""
    from homeward.drives.drive import DriveSettings
    from homeward.drives.ros.settings import LogSettings
    from homeward.registry import ESTIMATORS
    from homeward.simulation.render.room.settings import RenderScenario
    from homeward.simulation.scenario import Scenario
    from homeward.studies.paper.settings import PaperSettings
    from homeward.studies.planning.settings import Plan
    from homeward.studies.study.settings import StudySettings
    from homeward.vision.recorded.settings import ImageSettings

    return {
        **{
            name: (f"homeward run --estimator {name} --set ...", model)
            for name, (model, _) in ESTIMATORS.items()
        },
        "simulate": ("homeward simulate --set ..., scenario.yaml", Scenario),
        "render": ("homeward render --set ..., scenario.yaml", RenderScenario),
        "reproduce": ("homeward reproduce --set ...", PaperSettings),
        "study": ("the YAML file of homeward study", StudySettings),
        "plan": ("the YAML file of homeward plan", Plan),
        "drive": ("drive.yaml of a drive folder", DriveSettings),
        "images": ("images.yaml of a folder of images", ImageSettings),
        "topics": ("the topics file of a log", LogSettings),
    }
