"""`homeward see`: convert images to a drive folder."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from homeward.cli import options as shared
from homeward.errors import InputError
from homeward.io.naming import command


def see(
    folder: Annotated[
        Path,
        typer.Argument(
            help="A folder with images.csv (t,file), a home image and odometry.csv; with --tags "
            "also a video, a log, or a folder with odometry.csv and a sub-folder for each camera."
        ),
    ],
    out: Annotated[Path, typer.Option(help="The drive folder to write.")],
    tags: Annotated[
        str | None,
        typer.Option(help="Detect fiducial tags of this family, for example 36h11 or 4x4_50."),
    ] = None,
    topics: shared.Topics = None,
    home: shared.Home = None,
    force: shared.Force = False,
    json: shared.AsJson = False,
) -> None:
    """Detect landmarks in panoramas, or tags in any images, and write a drive folder.

    Continue with: homeward run OUT. images.yaml in the folder may name the camera, the home image,
    and a mask, black where the robot itself is visible; drive.yaml and truth.csv are copied. With
    --tags, home.csv or a time at --home replaces the home image; a drive in a
    known place needs none of them. Each camera of several has images.csv or a video, images.yaml
    and a home image in a sub-folder with its name. Exit status 1 if no landmark was found.
    """
    chosen = shared.home_choice(home)
    if "home_file" in chosen:
        raise InputError("home bearings of images: copy the file to home.csv in their folder")
    when = shared.time_at_home(chosen)
    from homeward.drives.folder import ODOMETRY, write_folder
    from homeward.drives.home.when import with_home
    from homeward.errors import naming_file
    from homeward.io.writing import check_output
    from homeward.runs.report.words import describe_sightings
    from homeward.vision.recorded.recording import see_recording

    if os.path.realpath(out) == os.path.realpath(folder):
        raise InputError("--out is the folder of the images; choose another folder", out)
    with shared.progress(f"detecting landmarks in {folder}") as on_progress:
        drive = see_recording(
            folder,
            on_progress,
            lambda: check_output(out, ODOMETRY),
            tags=tags,
            topics=topics,
            force=force,
        )
        if when is not None:
            with naming_file(folder):
                drive = with_home(drive, when, on_progress)
        write_folder(drive, out)
    if json:
        seen = Counter(drive.sightings.landmark.tolist())
        known = {"landmarks": seen, "home": list(drive.home), "remarks": drive.remark_lines}
        shared.answer({"summary": describe_sightings(drive), "folder": out, **known})
    else:
        shared.say(describe_sightings(drive))
        shared.warn(*drive.remark_lines)
        shared.say(f"Drive: {out}")
        if drive.sightings.t.size:
            shared.say(f"Next: {command('run' if drive.home else 'info', out)}")
    if not drive.sightings.t.size:
        raise shared.no_answer()
