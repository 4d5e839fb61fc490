"""`homeward studio`: interactive page to drag landmarks, home and the robot."""

from __future__ import annotations

import asyncio
from typing import Annotated

import typer

from homeward.cli.options import say
from homeward.errors import InputError


def studio(
    source: Annotated[
        str,
        typer.Argument(
            metavar="[SCENE]",
            help="A simulated scene: warehouse, paper-homing, circle, or a scenario.yaml.",
        ),
    ] = "warehouse",
    estimator: Annotated[
        str,
        typer.Option(
            help="Estimators to compare, separated by commas: names or package.module:make."
        ),
    ] = "robust,ekf",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0: any free port.")] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")
    ] = True,
) -> None:
    """Open an interactive page: move landmarks, home and the robot, and compare estimators live.

    Only this machine can connect, with the token in the printed address. Stop with Ctrl-C. Needs
    the extra live. See docs/do/studio.md.
    """
    import webbrowser
    from pathlib import Path

    from homeward.lab.simulation.simulate import PRESETS
    from homeward.registry import settings_model
    from homeward.studio.scenes import open_scene
    from homeward.studio.server import Studio
    from homeward.studio.session import Session

    names = tuple(word.strip() for word in estimator.split(",") if word.strip())
    for name in names:
        settings_model(name)  # an unknown name is an error before anything is opened
    if source not in PRESETS and Path(source).suffix not in (".yaml", ".yml"):
        raise InputError(
            f"{source}: not a scene; use {', '.join(PRESETS)} or a scenario.yaml (for a drive"
            " `homeward run`, for a place `homeward place view`)"
        )
    session = Session(open_scene(source), names)

    def opened(address: str) -> None:
        say(f"The studio is at {address}")
        if browser:
            webbrowser.open(address)

    asyncio.run(Studio(session).serve(port, opened))
