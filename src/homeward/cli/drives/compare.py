"""`homeward compare`: the rotation of a camera and the direction of home, from two panoramas."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from homeward.cli import options as shared


def compare(
    home: Annotated[Path, typer.Argument(help="A panorama taken at home.")],
    now: Annotated[Path, typer.Argument(help="A second panorama of the same camera.")],
    out: Annotated[Path, typer.Option(help="The folder to write.")] = Path("out/compare"),
    camera: Annotated[
        Path | None,
        typer.Option(help="An images.yaml that names the camera; default: equirectangular."),
    ] = None,
    mask: Annotated[
        Path | None,
        typer.Option(
            help="An image of the size of the panoramas, black where the robot itself is visible; "
            "default: the mask of images.yaml."
        ),
    ] = None,
    force: shared.Force = False,
    json: shared.AsJson = False,
) -> None:
    """Report the rotation of a camera since home and the direction of home, from two panoramas.

    Writes comparison.png, matches.csv and comparison.json. Exit status 1 if too few points match.
    """
    from homeward.errors import InputError
    from homeward.io.writing import check_output
    from homeward.registry import estimator_names
    from homeward.vision.checks import find_mirrored, require_panoramas
    from homeward.vision.comparison import compare as compare_views
    from homeward.vision.features.detection import read_features
    from homeward.vision.recorded.settings import read_image_settings
    from homeward.vision.report import PICTURE, RESULT, as_dict, describe, write_comparison

    if {str(home), str(now)} <= {*estimator_names()}:
        raise InputError(
            "estimators, not panoramas", advice=f"use `homeward run DRIVE --estimator {home},{now}`"
        )
    if folder := next(filter(Path.is_dir, (home, now)), None):
        advice = "use `homeward run DRIVE --estimator A,B` to compare estimators"
        raise InputError("a folder, not a panorama", folder, advice=advice)
    settings = read_image_settings(camera)
    home_image, home_view = read_features(home, settings.panorama, mask=mask or settings.mask)
    now_image, now_view = read_features(now, settings.panorama, like=home_view)
    if not (force or settings.force):
        require_panoramas([home_image, now_image], settings.panorama)
    check_output(out, RESULT)
    seen = compare_views(home_view, now_view, settings.panorama)
    images, views = (home_image, now_image), (home_view, now_view)
    mirrored = find_mirrored(seen, now_image, views, settings.panorama)
    write_comparison(out, seen, images, views)
    notes = [] if mirrored is None else [f"{mirrored[:1].upper()}{mirrored[1:]}."]
    if json:
        facts = {"summary": describe(seen), **as_dict(seen), "notes": notes}
        shared.answer({**facts, "picture": str(out / PICTURE)})
    else:
        shared.say(describe(seen))
        shared.warn(*notes)
        shared.say(f"Picture: {out / PICTURE}")
    if not seen.accepted:
        raise shared.no_answer()
