"""`homeward view`: a run in Rerun's viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from homeward.cli.drives.run import run_settings
from homeward.cli.options import progress
from homeward.cli.terminal import say, warn


def view(
    run: Annotated[
        str, typer.Argument(help="The folder that a run wrote, its run.yaml, a drive, or: sample.")
    ],
    rerun: Annotated[
        Path | None,
        typer.Option(metavar="FILE.rrd", help="Write a recording instead of opening the viewer."),
    ] = None,
) -> None:
    """Show a run in Rerun: the map and the robot in it over time, series, and camera images.

    The run is repeated from its run.yaml, on its drive. Needs the extra view.
    """
    from homeward.drives.images import read_images
    from homeward.report.run.folder import SETTINGS_FILE, is_written_as
    from homeward.report.viewer import recording as viewer
    from homeward.studies.single_run import drive_path, finish, prepare

    written = (Path(run) / SETTINGS_FILE).is_file()
    settings = run_settings(str(Path(run) / SETTINGS_FILE) if written else run, {})
    with progress(f"{settings.drive}, {settings.estimator}") as tell:
        drive, estimator, complete = prepare(settings, tell)
        images = read_images(drive_path(settings), {})
        if rerun is None:
            viewer.check_display()
        else:
            viewer.check_recording(rerun)
        track = finish(drive, estimator, complete, tell)
    if written and not is_written_as(Path(run), track):
        warn(f"The drive or homeward has changed since {run} was written; it shows anew.")
    if rerun is None:
        viewer.show(drive, track, images)
    else:
        viewer.write_recording(rerun, drive, track, images)
        say(f"Recording: {rerun}")
