"""`homeward studio`: interactive page to drag landmarks, home and the robot."""

from __future__ import annotations

import asyncio
from typing import Annotated

import typer

from homeward.cli.options import Topics, read_drive, say


def studio(
    source: Annotated[
        str,
        typer.Argument(
            metavar="[SCENE|DRIVE|PLACE]",
            help="A simulated scene (warehouse, paper-homing, circle, a scenario.yaml); a drive "
            "(sample, a drive folder, a ROS bag or MCAP file); or a place.",
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
    topics: Topics = None,
) -> None:
    """Open an interactive page: move landmarks, home and the robot, and compare estimators live.

    For a drive: scrub through it, and run it with other camera extrinsics, lag or noise. For a
    place: scrub through its visits. Only this machine can connect, with the token in the printed
    address. Stop with Ctrl-C. Needs the extra live. See docs/do/studio.md.
    """
    import webbrowser
    from pathlib import Path

    from homeward.drives.folder import SETTINGS, is_drive_folder, read_drive_settings
    from homeward.drives.opening import SAMPLE, located
    from homeward.drives.ros.info import log_info
    from homeward.drives.ros.log import is_log
    from homeward.lab.simulation.simulate import PRESETS
    from homeward.places.files import is_place, load_place
    from homeward.registry import settings_model
    from homeward.studio.replay import Replay
    from homeward.studio.scenes import open_scene
    from homeward.studio.server import Played, Studio
    from homeward.studio.session import Session
    from homeward.studio.visited import Visited

    names = tuple(word.strip() for word in estimator.split(",") if word.strip())
    for name in names:
        settings_model(name)  # an unknown name is an error before anything is opened
    shown: Played
    if source in PRESETS or (source != SAMPLE and Path(source).suffix in (".yaml", ".yml")):
        shown = Session(open_scene(source), names)
    elif is_place(Path(source)):
        shown = Visited(load_place(source))
    else:
        drive = read_drive(source, topics)
        path = located(source)
        plan = log_info(path, topics).plan if is_log(path) else None
        given = read_drive_settings(path / SETTINGS) if is_drive_folder(path) else None
        shown = Replay(drive, names, plan, given if plan is None else plan.drive)

    def opened(address: str) -> None:
        say(f"The studio is at {address}")
        if browser:
            webbrowser.open(address)

    asyncio.run(Studio(shown).serve(port, opened))
