"""`homeward convert`: convert a drive to another format."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from homeward.cli.options import (
    Home,
    Topics,
    home_choice,
    progress,
    read_drive,
    say,
    warn,
)
from homeward.io.naming import command


def convert(
    source: Annotated[
        str, typer.Argument(help="A drive folder, a ROS bag, an MCAP file, or: sample.")
    ],
    target: Annotated[
        Path, typer.Argument(help="A file ending in .mcap, .bag or .db3, or a new drive folder.")
    ],
    topics: Topics = None,
    home: Home = None,
) -> None:
    """Convert a drive to a drive folder, an MCAP file or a ROS bag, without loss."""
    from homeward.drives.opening import save_drive

    drive = read_drive(source, topics, home_needed=False, **home_choice(home))
    with progress(f"writing {target}") as on_progress:
        kind = save_drive(drive, target, on_progress)
    say(
        f"{kind} {target}: {drive.odometry.t.size} twists, {drive.sightings.t.size} sightings, "
        f"{len(drive.home)} home bearings"
        + ("" if drive.truth is None else f", {drive.truth.t.size} true poses")
    )
    warn(*drive.remark_lines)
    say(f"Next: {command('run' if drive.home else 'info', target)}")
