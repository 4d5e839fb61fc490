"""Folder of a place, with a subfolder for each version.

`0007/` contains the place after its seventh change. The newest version is used; older versions are
kept for `undo`. A version is added by one rename after all its files are on disk.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

from homeward.errors import InputError
from homeward.io.reading import is_there, naming, require_folder
from homeward.io.writing import SCRATCH, remove_abandoned, scratch_folder, sync, sync_folder
from homeward.places.place import Place
from homeward.places.version import SETTINGS, read_version, write_version

NUM_KEPT = 10
"""Number of versions to keep."""
MAX_MERGES = 5
"""Attempts to merge a visit while other robots save the same place."""


class PlaceChangedError(InputError):
    """A newer version of a place was saved while a change was computed."""


def is_place(folder: Path) -> bool:
    """Return whether a folder holds a place."""
    return os.path.isdir(folder) and bool(_versions(folder))


def check_place(folder: Path) -> None:
    """Raise `InputError` if a folder contains files but no place."""
    if is_there(folder):
        require_folder(folder)
        strangers = [p.name for p in folder.iterdir() if not p.name.startswith(SCRATCH)]
        if strangers and not _versions(folder):
            raise InputError("contains files but no place; choose another folder", folder)


def load_place(folder: str | os.PathLike[str], version: int | None = None) -> Place:
    """Read a version of a place, by default the newest; `InputError` if missing or damaged."""
    path = Path(folder)
    found = _require_versions(path)
    if version is not None and version not in found:
        raise InputError(f"has no version {version}; it has {min(found)} to {max(found)}", path)
    return read_version(path / _name(version if version is not None else max(found)))


def newest(folder: str | os.PathLike[str]) -> int:
    """Return the number of the newest version of a place; `InputError` if there is none."""
    return max(_require_versions(Path(folder)))


def save_place(place: Place, folder: str | os.PathLike[str], after: int | None = None) -> int:
    """Write a place as the next version in a folder; return the version number.

    Parameters
    ----------
    place : Place
        Place to write.
    folder : path-like
        New, empty, or the folder of a place.
    after : int, optional
        The version from which the place was computed.

    Raises
    ------
    PlaceChangedError
        If the folder has a version newer than `after`, because another robot saved meanwhile.
    InputError
        If the folder contains something else or cannot be written, or the place is inconsistent.
    """
    path = Path(folder)
    if place.map.homes != tuple(place.homes):
        raise InputError("the homes of the map differ from the homes of the place", path)
    check_place(path)
    with naming(path, "cannot be written"):
        path.mkdir(parents=True, exist_ok=True)
        remove_abandoned(path)
        found = _versions(path)
        number = max(found, default=0) + 1
        if after is not None and number != after + 1:
            raise PlaceChangedError(f"was changed meanwhile: version {number - 1} is newer", path)
        with scratch_folder(path) as scratch:
            write_version(place, scratch)
            for file in scratch.iterdir():
                sync(file)
            sync_folder(scratch)
            while not _publish(scratch, path / _name(number)):
                if after is not None:
                    raise PlaceChangedError(
                        f"was changed meanwhile: version {number} is newer", path
                    )
                number += 1
        sync_folder(path)
        for old in sorted(found)[: max(0, len(found) + 1 - NUM_KEPT)]:
            _remove(path / _name(old))
        for half_deleted in (p for p in path.iterdir() if _is_half_deleted(p)):
            _remove(half_deleted)
    return number


def update_place(
    folder: str | os.PathLike[str], change: Callable[[Place], Place]
) -> tuple[Place, int]:
    """Change the newest version of a place and save it; return the place and its version.

    `change` is called again, at most `MAX_MERGES` times, if another robot saves meanwhile.
    Raises the errors of `load_place`, `save_place` and `change`.
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
    found = sorted(_require_versions(path))
    if len(found) < 2:
        raise InputError("has no older version to go back to", path)
    with naming(path, "cannot be written"):
        _remove(path / _name(found[-1]))
    return found[-2]


def _remove(version: Path) -> None:
    """Delete a version, after a rename so that it is never visible in part."""
    with scratch_folder(version.parent) as scratch:
        version.rename(scratch / version.name)
        sync_folder(version.parent)


def _is_half_deleted(entry: Path) -> bool:
    """Return whether a folder is left over from an interrupted deletion of a version."""
    name = entry.name
    is_version = name.isdecimal() and name.isascii() and name == _name(int(name))
    return is_version and entry.is_dir() and not (entry / SETTINGS).exists()


def _publish(scratch: Path, version: Path) -> bool:
    """Rename a scratch folder to its version; return False if that version already exists."""
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
    """Return the numbers of the complete versions of a place."""
    with naming(path, "cannot be read"):
        names = [p.name for p in path.iterdir() if p.name.isdecimal() and p.name.isascii()]
    return [int(n) for n in names if n == _name(int(n)) and (path / n / SETTINGS).is_file()]


def _require_versions(path: Path) -> list[int]:
    require_folder(path)
    found = _versions(path)
    if not found:
        raise InputError("contains no place", path)
    return found
