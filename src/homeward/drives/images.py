"""Camera images of a drive: images.csv with the columns t [s] and file, or a video."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from homeward.errors import InputError
from homeward.io.reading import is_there
from homeward.io.table import identifiers, is_identifier, numbers, quoted, read_csv

IMAGES = "images.csv"
KINDS = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png"}
"""Media types by suffix."""
VIDEOS = (".mp4", ".mkv", ".avi", ".mov", ".m4v", ".webm")
"""Suffixes of videos."""
REPEATED_IMAGES = "images with a repeated stamp; the first counts"


@dataclass(frozen=True)
class Images:
    """Camera images of a drive."""

    t: np.ndarray
    """(n,), increasing [s]."""
    files: list[Path]
    """JPEG or PNG files, which exist."""


def read_images(folder: Path, remarks: dict[str, int]) -> Images:
    """Return the images listed in images.csv; none without that file.

    The first of equal stamps counts; `remarks` counts the others. `InputError` where an image is
    missing, outside the folder, or neither JPEG nor PNG.
    """
    table_file = folder / IMAGES
    if not is_there(table_file):
        return Images(np.empty(0), [])
    table = read_csv(table_file, {"t": numbers, "file": identifiers}, remarks=remarks)
    table.require_order()
    t = table["t"]
    files = [_image(folder, str(name)) for name in table["file"]]
    first = np.flatnonzero(np.diff(t, prepend=-np.inf) > 0)
    if repeats := len(t) - len(first):
        remarks[REPEATED_IMAGES] = repeats
    return Images(t[first], [files[k] for k in first])


def cameras_in(folder: Path) -> dict[str, Path]:
    """Return the sub-folder with images.csv, or else the video in it, of each camera by name.

    The name is that of the sub-folder. None for a folder with images.csv, which is that of one
    camera. `InputError` for several videos, or a name that is no id.
    """
    if is_there(folder / IMAGES):
        return {}
    found = dict[str, Path]()
    for inner in sorted(folder.glob("*/")):
        videos = sorted(file for file in inner.glob("*") if file.suffix.lower() in VIDEOS)
        if is_there(inner / IMAGES):
            found[inner.name] = inner
        elif videos:
            found[inner.name] = videos[0]
            if len(videos) > 1:
                raise InputError(f"{len(videos)} videos of one camera", inner, advice="keep one")
    if bad := next((name for name in found if not is_identifier(name)), None):
        raise InputError("not a valid name of a camera", folder / bad, advice="rename the folder")
    return found


def file_within(folder: Path, name: str | Path, what: str, source: Path) -> Path:
    """Return a file that must be in `folder`, links resolved; else raise InputError.

    Messages call the file `what`, and name the file `source` that refers to it.
    """
    file, named = folder / name, f"{what} {quoted(str(name))}"
    try:
        inside, there = file.resolve().is_relative_to(folder.resolve()), file.is_file()
    except (OSError, ValueError, RuntimeError):  # too long, with a null character, a ring of links
        raise InputError(f"{named} cannot be a file name", source) from None
    # An untrusted folder must not include other files of this machine in an output.
    if not inside:
        raise InputError(f"{named} is outside the folder", source)
    if not there:
        raise InputError(f"{named} does not exist", source)
    return file


def _image(folder: Path, name: str) -> Path:
    file = file_within(folder, name, "image", folder / IMAGES)
    if file.suffix.lower() not in KINDS:
        raise InputError(f"image {quoted(name)} is neither .jpg nor .png", folder / IMAGES)
    return file
