"""Atomic writing of files and folders.

They are written in a scratch folder on the file system of their destination, and then renamed. A
killed process leaves at most that scratch folder.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from homeward.errors import InputError
from homeward.io.reading import is_there, naming

SCRATCH = ".writing-"
"""Prefix of the names of scratch folders."""


@contextmanager
def scratch_folder(parent: Path) -> Iterator[Path]:
    """Make a folder in `parent` with the usual permissions; delete it at the end unless renamed."""
    parent.mkdir(parents=True, exist_ok=True)
    scratch = parent / f"{SCRATCH}{secrets.token_hex(8)}"
    scratch.mkdir()
    try:
        yield scratch
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield the path of a new file that replaces `path` when the block ends without an error.

    The file is synchronised to disk before it replaces the old one.
    """
    with scratch_folder(path.parent) as scratch:
        yield (new := scratch / path.name)
        sync(new)
        os.replace(new, path)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file atomically; `InputError` where it cannot be written."""
    with naming(path, "cannot be written"), whole_file(path) as new:
        new.write_bytes(content)


def check_output(directory: Path, marker: str) -> None:
    """Refuse an output folder that has files, but not the `marker` file of earlier output.

    The folder may not exist yet. `InputError` also where it is not a folder, not writable or has a
    name that is too long, before a long computation.
    """
    with naming(directory, "cannot be written"), suppress(FileNotFoundError, NotADirectoryError):
        os.lstat(directory)
    existing = next(p for p in (directory, *directory.absolute().parents) if is_there(p))
    if not existing.is_dir():
        raise InputError("is not a folder; choose another output folder", existing)
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError("is not writable; choose another output folder", existing)
    if existing != directory:
        return
    names = {p.name for p in directory.iterdir() if not p.name.startswith(SCRATCH)}
    if names and marker not in names:
        raise InputError(
            f"contains other files and no {marker} of earlier output; choose another output folder",
            directory,
        )


@contextmanager
def whole_folder(
    folder: Path, marker: str | None = None, merge: bool = False, owned: Collection[str] = ()
) -> Iterator[Path]:
    """Yield a scratch folder whose entries move to `folder` when the block ends without an error.

    A new folder appears by one rename. In an existing one, entries of the same names are replaced.
    The `marker` file moves last, so a folder that has it is complete. By default a new subfolder
    replaces the old one; with `merge`, other files in subfolders stay. Files of an existing folder
    that are `owned` and not replaced are deleted. `InputError` as `check_output`, if there is a
    marker, or where the folder cannot be written.
    """
    with naming(folder, "cannot be written"):
        if marker is not None:
            check_output(folder, marker)
        new = not is_there(folder)
        # Inside an existing folder, since its parent may be on another file system.
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
    """Wait until a file, or the entries of a folder, are on disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
