"""`homeward place add`: run a drive in a place, and merge it into the place."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from homeward.cli import options as shared
from homeward.cli.drives.run import common_options, home_options, run_one, run_settings


def add(
    place: Annotated[
        Path, typer.Argument(metavar="PLACE", help="The folder of the place; it may be new.")
    ],
    drive: Annotated[
        str, typer.Argument(help="A drive folder, a folder of images, a log, or: sample.")
    ],
    out: shared.RunFolder = None,
    store_home: Annotated[
        str | None,
        typer.Option(
            help="Store the end of the drive, or its pose at --home at:T, as a home with this name."
        ),
    ] = None,
    store_route: Annotated[
        str | None, typer.Option(help="Store the path of the drive as a route with this name.")
    ] = None,
    when: shared.When = None,
    topics: shared.Topics = None,
    robot_file: shared.RobotFile = None,
    home: shared.Home = None,
    place_home: shared.PlaceHome = None,
    changes: shared.Changes = None,
    json: shared.AsJson = False,
) -> None:
    """Localise a robot in a drive as homeward run, and merge the drive into a place.

    The first drive creates the place; its home is the first home. A drive of another place, or one
    that was merged before, changes nothing. Exit status 1 if nothing was merged or stored.
    """
    from homeward.places.files import check_place
    from homeward.runs.visits import ToStore

    check_place(place)  # fail before a run of minutes
    chosen = shared.home_choice(home)
    stored_at = chosen.pop("home_at", None) if store_home is not None else None
    options = common_options(topics, robot_file, place, place_home, when, changes)
    given = {key: value for key, value in options.items() if value is not None}
    settings = run_settings(drive, {**given, **home_options(chosen)})
    run_one(settings, out, json, ToStore(store_home, stored_at, store_route))
