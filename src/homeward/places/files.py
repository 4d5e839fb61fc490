"""A place as a folder: each version a folder of its own in it, written whole or not at all.

`0007/` holds the place after its seventh change. The newest one counts; older ones are what `undo`
goes back to. A version enters by one rename, after everything in it has reached the disk.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

from homeward.errors import InputError
from homeward.io.reading import is_there, naming, require_folder
from homeward.io.writing import SCRATCH, scratch_folder, sync
from homeward.places.place import Place
from homeward.places.version import SETTINGS, read_version, write_version

KEPT = 10
"""So many versions are kept."""
CUT_SHORT_S = 3600.0
"""What was begun so long ago nobody writes any more; till then it may be another robot's [s]."""


MAX_MERGES = 5
"""Attempts to merge a visit while other robots save the same place."""


class PlaceChangedError(InputError):
    """A place got a newer version while a change of it was computed."""


def is_place(folder: Path) -> bool:
    """Return whether a folder holds a place."""
    return os.path.isdir(folder) and bool(_versions(folder))


def check_place(folder: Path) -> None:
    """Refuse a folder into which no place can be written: `InputError` if it holds other things."""
    if is_there(folder):
        require_folder(folder)
        strangers = [p.name for p in folder.iterdir() if not p.name.startswith(SCRATCH)]
        if strangers and not _versions(folder):
            raise InputError("holds files but no place; choose another folder", folder)


def load_place(folder: str | os.PathLike[str], version: int | None = None) -> Place:
    """Read a place.

    Parameters
    ----------
    folder : path-like
        Of the place.
    version : int, optional
        Which version; the newest by default.

    Raises
    ------
    InputError
        When there is none, or it is damaged.
    """
    path = Path(folder)
    found = _required(path)
    if version is not None and version not in found:
        raise InputError(f"version {version} is not kept; {min(found)} to {max(found)} are", path)
    return read_version(path / _name(version if version is not None else max(found)))


def newest(folder: str | os.PathLike[str]) -> int:
    """Return the number of the newest version of a place; `InputError` where there is none."""
    return max(_required(Path(folder)))


def save_place(place: Place, folder: str | os.PathLike[str], after: int | None = None) -> int:
    """Write a place as the next version of a folder; return its number.

    Parameters
    ----------
    place : Place
        What to write.
    folder : path-like
        New, empty, or of a place.
    after : int, optional
        The version that it was made from.

    Raises
    ------
    PlaceChangedError
        When the folder has a version newer than `after`: another robot saved meanwhile.
    InputError
        When the folder holds something else, or cannot be written, or the place contradicts itself.
    """
    path = Path(folder)
    if place.map.homes != tuple(place.homes):
        raise InputError("the homes of its map are not the place's homes", path)
    check_place(path)
    with naming(path, "cannot be written"):
        path.mkdir(parents=True, exist_ok=True)
        for left in path.glob(SCRATCH + "*"):
            with contextlib.suppress(FileNotFoundError):  # it was finished meanwhile
                if time.time() - left.stat().st_mtime > CUT_SHORT_S:
                    shutil.rmtree(left, ignore_errors=True)
        found = _versions(path)
        number = max(found, default=0) + 1
        if after is not None and number != after + 1:
            raise PlaceChangedError(f"was changed meanwhile: version {number - 1} is newer", path)
        with scratch_folder(path) as scratch:
            write_version(place, scratch)
            for file in (*scratch.iterdir(), scratch):
                sync(file)
            while not _enters(scratch, path / _name(number)):
                if after is not None:
                    raise PlaceChangedError(
                        f"was changed meanwhile: version {number} is newer", path
                    )
                number += 1
        sync(path)
        for old in sorted(found)[: max(0, len(found) + 1 - KEPT)]:
            _remove(path / _name(old))
        for half_deleted in (p for p in path.iterdir() if _is_half_deleted(p)):
            _remove(half_deleted)
    return number


def update_place(
    folder: str | os.PathLike[str], change: Callable[[Place], Place]
) -> tuple[Place, int]:
    """Change the newest version of a place and save it; return the place and its version.

    `change` is called again, at most `MAX_MERGES` times, if another robot saves meanwhile.
    `InputError` as `load_place` and `save_place`, and whatever `change` raises.
    """
    for _ in range(MAX_MERGES):
        version = newest(folder)
        after = change(load_place(folder, version))
        try:
            return after, save_place(after, folder, version)
        except PlaceChangedError as error:
            changed = error
    raise changed


def undo(folder: str | os.PathLike[str]) -> int:
    """Go back to the version before the newest one; return its number."""
    path = Path(folder)
    found = sorted(_required(path))
    if len(found) < 2:
        raise InputError("there is no older version to go back to", path)
    with naming(path, "cannot be written"):
        _remove(path / _name(found[-1]))
    return found[-2]


def _remove(version: Path) -> None:
    """Delete a version: out of the way by one rename first, so that it is whole or gone."""
    with scratch_folder(version.parent) as scratch:
        version.rename(scratch / version.name)
        sync(version.parent)


def _is_half_deleted(entry: Path) -> bool:
    """Return whether an entry is the rest of a version whose deletion was interrupted."""
    name = entry.name
    is_version = name.isdecimal() and name.isascii() and name == _name(int(name))
    return is_version and entry.is_dir() and not (entry / SETTINGS).exists()


def _enters(scratch: Path, version: Path) -> bool:
    """Rename what was written to its version; return whether nobody else was quicker."""
    try:
        scratch.rename(version)
    except OSError as error:
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST):
            return False
        raise
    return True


def _name(version: int) -> str:
    return f"{version:04d}"


def _versions(path: Path) -> list[int]:
    """Return the versions of a place that are there whole."""
    with naming(path, "cannot be read"):
        names = [p.name for p in path.iterdir() if p.name.isdecimal() and p.name.isascii()]
    return [int(n) for n in names if n == _name(int(n)) and (path / n / SETTINGS).is_file()]


def _required(path: Path) -> list[int]:
    require_folder(path)
    found = _versions(path)
    if not found:
        raise InputError("holds no place", path)
    return found
