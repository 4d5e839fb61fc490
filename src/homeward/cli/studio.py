"""`homeward studio`: a page to drag landmarks, home and robot on."""

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
            help="A scene (warehouse, paper-homing, circle, a scenario.yaml) to play in; what was "
            "driven: sample, a drive folder, a ROS bag or MCAP file; or a place.",
        ),
    ] = "warehouse",
    estimator: Annotated[
        str, typer.Option(help="Side by side: names, or package.module:make, with commas.")
    ] = "robust,ekf",
    port: Annotated[int, typer.Option(min=0, max=65535, help="To listen at; 0: any free one.")] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open it in the browser.")
    ] = True,
    topics: Topics = None,
) -> None:
    """Open a page to play in: move landmarks, home and robot, and see which estimators notice.

    Of a drive: scrub it, and run it with another camera, lag or noise. Of a place: scrub its
    visits. Only this machine can
    connect, and only with the token in the address that is printed. It ends by Ctrl-C. Needs the
    extra live. docs/do/studio.md has more.
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
        settings_model(name)  # whoever is not there is refused before anything is opened
    shown: Played
    if source in PRESETS or (source != SAMPLE and Path(source).suffix in (".yaml", ".yml")):
        shown = Session(open_scene(source), names)
    elif is_place(Path(source)):
        shown = Visited(load_place(source))
    else:
        drive = read_drive(source, topics)
        there = located(source)
        plan = log_info(there, topics).plan if is_log(there) else None
        told = read_drive_settings(there / SETTINGS) if is_drive_folder(there) else None
        shown = Replay(drive, names, plan, told if plan is None else plan.drive)

    def opened(address: str) -> None:
        say(f"The studio is at {address}")
        if browser:
            webbrowser.open(address)

    asyncio.run(Studio(shown).serve(port, opened))
