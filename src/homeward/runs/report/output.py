"""An output folder, written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from homeward.errors import InputError
from homeward.io import writing as io
from homeward.io.reading import is_there, naming


def check_output(directory: Path, marker: str) -> None:
    """Refuse an output folder that has files, but not the `marker` of earlier output.

    The folder may not exist yet. `InputError` also where it is no folder, or cannot be written: a
    run of minutes should not end with that.
    """
    there = next(p for p in (directory, *directory.absolute().parents) if is_there(p))
    if not there.is_dir():
        raise InputError("is not a folder; choose another output folder", there)
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError("may not be written into; choose another output folder", there)
    if there != directory:
        return
    names = {p.name for p in directory.iterdir() if not p.name.startswith(io.SCRATCH)}
    if names and marker not in names:
        raise InputError(
            f"holds files but no {marker}, so they are not ours to replace; "
            "choose another output folder",
            directory,
        )


@contextmanager
def whole_folder(directory: Path, marker: str, merge: bool = False) -> Iterator[Path]:
    """Lend a scratch folder whose files enter `directory` together, once all are written.

    The `marker` of earlier output enters last: a folder that has it is whole. With `merge`, other
    files in subfolders of earlier output stay, as where users work in them; by default a new
    subfolder replaces the old one, so that no old frame stays. `InputError` as `check_output`, or
    where the folder cannot be written.
    """
    with naming(directory, "cannot be written"):
        check_output(directory, marker)
        with io.whole_folder(directory, last=marker, merge=merge) as scratch:
            yield scratch
