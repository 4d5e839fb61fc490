"""The camera images of a drive folder: images.csv with t [s] and file, the files beside it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from homeward.errors import InputError
from homeward.io.reading import is_there
from homeward.io.table import identifiers, numbers, quoted, read_csv

IMAGES = "images.csv"
KINDS = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png"}
"""Media type by the ending of a file's name."""
REPEATED_IMAGES = "images with a repeated stamp; the first counts"


@dataclass(frozen=True)
class Images:
    """Camera images along a drive."""

    t: np.ndarray
    """(n,), increasing [s]."""
    files: list[Path]
    """JPEG or PNG; they are there when this is made."""


def read_images(folder: Path, remarks: dict[str, int]) -> Images:
    """Return the images that a drive folder names; none when it has no images.csv.

    Of equal stamps the first counts; `remarks` counts the others. `InputError` where a file is not
    there, lies outside the folder, or is neither JPEG nor PNG by its name.
    """
    table_file = folder / IMAGES
    if not is_there(table_file):
        return Images(np.empty(0), [])
    table = read_csv(table_file, {"t": numbers, "file": identifiers})
    table.require_order()
    t = table["t"]
    files = [_image(folder, str(name)) for name in table["file"]]
    first = np.flatnonzero(np.diff(t, prepend=-np.inf) > 0)
    if repeats := len(t) - len(first):
        remarks[REPEATED_IMAGES] = repeats
    return Images(t[first], [files[k] for k in first])


def file_within(folder: Path, name: str | Path, what: str, told_in: Path) -> Path:
    """Return a file that must lie in `folder`, also behind a link; else raise InputError.

    Messages call the file `what`, named in the file `told_in`.
    """
    file, named = folder / name, f"{what} {quoted(str(name))}"
    try:
        inside, there = file.resolve().is_relative_to(folder.resolve()), file.is_file()
    except (OSError, ValueError, RuntimeError):  # too long, with a zero in it, a ring of links
        raise InputError(f"{named} cannot be a file", told_in) from None
    # A folder from elsewhere must not draw other files of this machine into what is written.
    if not inside:
        raise InputError(f"{named} lies outside the folder", told_in)
    if not there:
        raise InputError(f"{named} is not there", told_in)
    return file


def _image(folder: Path, name: str) -> Path:
    """Return the file of an image."""
    file = file_within(folder, name, "image", folder / IMAGES)
    if file.suffix.lower() not in KINDS:
        raise InputError(f"image {quoted(name)} is neither .jpg nor .png", folder / IMAGES)
    return file
