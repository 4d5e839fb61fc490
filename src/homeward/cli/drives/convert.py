"""`homeward convert`: a drive from one form into another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from homeward.cli.options import (
    HomeNoise,
    HomePose,
    HomeSpin,
    Robot,
    Topics,
    progress,
    read_drive,
    spin_span,
)
from homeward.cli.terminal import say, warn


def convert(
    source: Annotated[
        str,
        typer.Argument(
            help="A drive folder, a ROS bag, an MCAP file, an MRCLAM folder, or: sample."
        ),
    ],
    target: Annotated[
        Path, typer.Argument(help="A name ending in .mcap, .bag or .db3, or a new drive folder.")
    ],
    topics: Topics = None,
    home_spin: HomeSpin = None,
    robot: Robot = None,
    home: HomePose = None,
    home_noise_deg: HomeNoise = 0.0,
    seed: Annotated[int, typer.Option(help="MRCLAM: of that noise.")] = 0,
) -> None:
    """Write a drive as a drive folder, an MCAP file or a ROS bag; the way back is exact."""
    from homeward.drives.saving import save_drive

    span = spin_span(home_spin)
    drive = read_drive(source, robot, home, home_noise_deg, topics, seed=seed, home_spin=span)
    with progress(f"writing {target}") as tell:
        kind = save_drive(drive, target, tell)
    say(
        f"{kind} {target}: {drive.odometry.t.size} twists, {drive.sightings.t.size} sightings, "
        f"{len(drive.home)} home bearings"
        + ("" if drive.truth is None else f", {drive.truth.t.size} true poses")
    )
    for remark in drive.remark_lines:
        warn(remark)
