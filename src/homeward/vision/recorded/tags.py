"""Records of a camera that sees tags, made into drives: picture folders, videos and logs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from homeward.drives.drive import Drive, HomeBearing, Sightings
from homeward.drives.folder import HOME, read_home
from homeward.drives.ros.measurements.bearings import TWICE
from homeward.drives.text.files import is_there
from homeward.errors import InputError, speaking_of
from homeward.vision.cameras.image_files import read_grey
from homeward.vision.recorded.folder import (
    IMAGE_SETTINGS,
    drive_beside,
    home_image,
    home_images,
)
from homeward.vision.recorded.frames import VIDEOS, PictureFiles, Video
from homeward.vision.recorded.settings import ImageSettings, read_image_settings
from homeward.vision.tags.front_end import TagFrontEnd

Tell = Callable[[float], None]
NO_TAGS = "pictures without a tag"


def see_tags(path: Path, family: str | None = None, tell: Tell | None = None) -> Drive:
    """Turn a folder of pictures, or a video in such a folder, into a drive.

    Parameters
    ----------
    path : Path
        A folder with images.csv, or a video; next to it odometry.csv, images.yaml with the camera,
        and a home image or home.csv. Without either, the drive has no home bearings: drive.yaml
        may specify when the robot was at home, or a place has its home.
    family : str, optional
        Of the tags; None: images.yaml's.
    tell : callable, optional
        Told the fraction done, in [0, 1].

    Returns
    -------
    Drive
        Its landmarks are the numbers of the tags.

    Raises
    ------
    InputError
        When a file is missing or cannot be used, or pictures and odometry do not overlap.
    """
    video = path.suffix.lower() in VIDEOS
    folder = path.parent if video else path
    told = folder / IMAGE_SETTINGS
    settings = read_image_settings(told if is_there(told) else None)
    eye = TagFrontEnd(settings.camera, family or settings.tags or "36h11")
    remarks: dict[str, int] = {}
    frames = Video(path) if video else PictureFiles(folder, remarks)
    if not frames.t.size:
        raise InputError("no pictures in it", path)
    blind = drive_beside(folder, frames.t, remarks)
    home = _home(eye, folder, settings, remarks) if blind.settings.home is None else {}
    seen = _sightings(eye, frames, remarks, tell)
    return replace(blind, name=path.resolve().stem, sightings=seen, home=home)


def _home(
    eye: TagFrontEnd, folder: Path, settings: ImageSettings, remarks: dict[str, int]
) -> dict[str, HomeBearing]:
    """Return the home bearings of the home image or, without one, of home.csv; or none."""
    if not home_images(folder, settings):
        return read_home(folder / HOME, remarks) if is_there(folder / HOME) else {}
    place = home_image(folder, settings)
    with speaking_of(place):
        home = eye.see(read_grey(place)).home
    if not home:
        raise InputError("no tag in the home image", place)
    return home


def _sightings(
    eye: TagFrontEnd, frames: PictureFiles | Video, remarks: dict[str, int], tell: Tell | None
) -> Sightings:
    """Return what all frames show; `remarks` counts what was left out."""
    rows: list[tuple[float, str, float, float]] = []
    counts: Counter[str] = Counter()
    for k, (t, frame) in enumerate(zip(frames.t.tolist(), frames, strict=True)):
        with speaking_of(Path(f"picture at {t:g} s")):
            seen = eye.see(frame)
        rows += [(t, name, b, seen.sigmas[name]) for name, b in seen.bearings.items()]
        counts[TWICE] += len(seen.tags.twice)
        counts[NO_TAGS] += not seen.bearings
        if tell is not None:
            tell((k + 1) / frames.t.size)
    remarks |= {reason: count for reason, count in counts.items() if count}
    return Sightings.of_rows(rows)
