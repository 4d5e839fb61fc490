"""`homeward see HOME NOW`: two panoramas in, heading change and direction of home out."""

from __future__ import annotations

from pathlib import Path

from homeward.cli.terminal import answer, no_answer, say, warn


def compare(
    home: Path,
    now: Path,
    out: Path,
    camera: Path | None,
    mask: Path | None,
    force: bool,
    json: bool,
) -> None:
    """Report how the camera has turned since home, and in which direction home is.

    The folder gets comparison.png with both panoramas and what was matched, matches.csv and
    comparison.json. Where the panoramas have not enough in common, the exit status is 1.
    """
    from homeward.runs.report.output import check_output
    from homeward.vision.checks.camera_settings import better_settings
    from homeward.vision.checks.seam import require_panoramas
    from homeward.vision.checks.self_occlusion import find_self_occlusion
    from homeward.vision.comparison import compare as compare_views
    from homeward.vision.features.detection import read_features
    from homeward.vision.recorded.settings import read_image_settings
    from homeward.vision.report import (
        PICTURE,
        RESULT,
        as_dict,
        describe,
        write_comparison,
    )

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
    notes = [] if doubt is None else [f"But {doubt}."]
    if found := find_self_occlusion(seen, settings.panorama):
        notes.append(f"{found.matches} {found.words} (--mask FILE).")
    if json:
        told = {"summary": describe(seen), **as_dict(seen), "notes": notes}
        answer({**told, "picture": str(out / PICTURE)})
    else:
        say(describe(seen))
        for note in notes:
            warn(note)
        say(f"Picture: {out / PICTURE}")
    if not seen.accepted:
        raise no_answer()
