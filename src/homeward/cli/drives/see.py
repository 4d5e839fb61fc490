"""`homeward see`: convert images to a drive folder, or compare two panoramas."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from homeward.cli import options as shared
from homeward.errors import InputError


def see(
    folder: Annotated[
        Path,
        typer.Argument(
            help="A folder with images.csv (t,file), a home image and odometry.csv; with --tags "
            "also a video, a log, or a folder with odometry.csv and a sub-folder for each camera; "
            "or a panorama taken at home."
        ),
    ],
    now: Annotated[
        Path | None,
        typer.Argument(help="A second panorama of the same camera, to compare with the first."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="The drive folder to write [two panoramas: out/compare].")
    ] = None,
    tags: Annotated[
        str | None,
        typer.Option(help="Detect fiducial tags of this family, for example 36h11 or 4x4_50."),
    ] = None,
    topics: shared.Topics = None,
    home: shared.Home = None,
    camera: Annotated[
        Path | None,
        typer.Option(
            help="Two panoramas: an images.yaml that names the camera; default: equirectangular."
        ),
    ] = None,
    mask: Annotated[
        Path | None,
        typer.Option(
            help="Two panoramas: an image of their size, black where the robot itself is visible; "
            "default: the mask of images.yaml."
        ),
    ] = None,
    force: shared.Force = False,
    json: shared.AsJson = False,
) -> None:
    """Detect landmarks in panoramas, or tags in any images, and write a drive folder.

    Continue with: homeward run OUT. images.yaml in the folder may name the camera, the home image,
    and a mask, black where the robot itself is visible; drive.yaml and truth.csv are copied. With
    --tags, home.csv or a time at --home replaces the home image; a drive in a
    known place needs none of them. Each camera of several has images.csv or a video, images.yaml
    and a home image in a sub-folder with its name. Exit status 1 if no landmark was found.

    For two panoramas (`homeward see home.png now.png`), it reports the rotation of the camera since
    home and the direction of home, and writes comparison.png, matches.csv and comparison.json.
    """
    chosen = shared.home_choice(home)
    if "home_file" in chosen:
        raise InputError("home bearings of images: copy the file to home.csv in their folder")
    when = shared.time_at_home(chosen)
    if now is not None:
        if tags or topics or when:
            raise InputError("two panoramas take only --camera, --mask, --force, --out and --json")
        compare(folder, now, out or Path("out/compare"), camera, mask, force, json)
        return
    if camera or mask:
        raise InputError(
            "--camera and --mask are for two panoramas; for a folder, set them in its images.yaml"
        )
    if out is None:
        raise InputError("no output folder: add --out FOLDER, the drive folder to write")
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
    if not drive.sightings.t.size:
        raise shared.no_answer()


def compare(
    home: Path,
    now: Path,
    out: Path,
    camera: Path | None,
    mask: Path | None,
    force: bool,
    json: bool,
) -> None:
    """Report the rotation of the camera since home, and the direction of home."""
    from homeward.io.writing import check_output
    from homeward.vision.checks import better_settings, find_self_occlusion, require_panoramas
    from homeward.vision.comparison import compare as compare_views
    from homeward.vision.features.detection import read_features
    from homeward.vision.recorded.settings import read_image_settings
    from homeward.vision.report import PICTURE, RESULT, as_dict, describe, write_comparison

    settings = read_image_settings(camera)
    home_image, home_view = read_features(home, settings.panorama, mask=mask or settings.mask)
    now_image, now_view = read_features(now, settings.panorama, like=home_view)
    if not (force or settings.force):
        require_panoramas([home_image, now_image], settings.panorama)
    check_output(out, RESULT)
    seen = compare_views(home_view, now_view, settings.panorama)
    images, views = (home_image, now_image), (home_view, now_view)
    doubt = better_settings(seen, images, views, settings.panorama)
    write_comparison(out, seen, images, views)
    notes = [] if doubt is None else [f"{doubt[:1].upper()}{doubt[1:]}."]
    if found := find_self_occlusion(seen, settings.panorama):
        notes.append(f"{found.matches} {found.words} (--mask FILE).")
    if json:
        facts = {"summary": describe(seen), **as_dict(seen), "notes": notes}
        shared.answer({**facts, "picture": str(out / PICTURE)})
    else:
        shared.say(describe(seen))
        shared.warn(*notes)
        shared.say(f"Picture: {out / PICTURE}")
    if not seen.accepted:
        raise shared.no_answer()
