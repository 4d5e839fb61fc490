"""Files and folders that appear whole or not at all.

They are written under a name that begins with `SCRATCH`, on the file system of their destination,
and enter by a rename. A process that is killed leaves at most such a scratch folder behind.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from homeward.errors import InputError
from homeward.io.reading import is_there, naming

SCRATCH = ".writing-"
"""First characters of the names of scratch folders."""


@contextmanager
def scratch_folder(parent: Path) -> Iterator[Path]:
    """Make a folder in `parent`, which is made too; delete it at the end unless it was renamed.

    Its permissions are those that the umask gives.
    """
    parent.mkdir(parents=True, exist_ok=True)
    scratch = parent / f"{SCRATCH}{secrets.token_hex(8)}"
    scratch.mkdir()
    try:
        yield scratch
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Lend the path of a new file that replaces `path` when the block ends without an error.

    The file is on the disk before it replaces the old one.
    """
    with scratch_folder(path.parent) as scratch:
        yield (made := scratch / path.name)
        sync(made)
        os.replace(made, path)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file whole or not at all; `InputError` where it cannot be written."""
    with naming(path, "cannot be written"), whole_file(path) as made:
        made.write_bytes(content)


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
    names = {p.name for p in directory.iterdir() if not p.name.startswith(SCRATCH)}
    if names and marker not in names:
        raise InputError(
            f"holds files but no {marker}, so they are not ours to replace; "
            "choose another output folder",
            directory,
        )


@contextmanager
def whole_folder(
    folder: Path, marker: str | None = None, merge: bool = False, owned: Collection[str] = ()
) -> Iterator[Path]:
    """Lend a scratch folder whose entries enter `folder` when the block ends without an error.

    A new folder appears by one rename. In an existing one, entries of the same names are replaced.
    The `marker` of earlier output enters last: a folder that has it is whole. With `merge`, other
    files in subfolders stay, as where users work in them; by default a new subfolder replaces the
    old one. Files of an existing folder that are `owned`, and not replaced, are deleted.
    `InputError` as `check_output`, if there is a marker, or where the folder cannot be written.
    """
    with naming(folder, "cannot be written"):
        if marker is not None:
            check_output(folder, marker)
        new = not is_there(folder)
        # In an existing folder, since its parent may be on another file system.
        with scratch_folder(folder.parent if new else folder) as scratch:
            yield scratch
            if new:
                scratch.rename(folder)
                return
            entries = sorted(scratch.iterdir(), key=lambda entry: entry.name == marker)
            for entry in entries:
                place = folder / entry.name
                if merge and entry.is_dir():
                    shutil.copytree(entry, place, copy_function=os.replace, dirs_exist_ok=True)
                    continue
                if place.is_dir() and not place.is_symlink():
                    shutil.rmtree(place)
                os.replace(entry, place)
            for name in set(owned) - {entry.name for entry in entries}:
                (folder / name).unlink(missing_ok=True)


def sync(path: Path) -> None:
    """Wait until a file, or the entries of a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
