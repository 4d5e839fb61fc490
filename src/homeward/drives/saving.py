"""Write a drive in whatever form the name of the target asks for."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from homeward.drives.drive import Drive
from homeward.drives.folder import write_folder
from homeward.errors import InputError
from homeward.io.reading import is_there

LOG_SUFFIXES = (".bag", ".mcap", ".db3")
"""ROS 1 bag, MCAP, and the sqlite3 file of a ROS 2 bag."""


def save_drive(
    drive: Drive, path: str | os.PathLike[str], tell: Callable[[float], None] | None = None
) -> str:
    """Write a drive that `open_drive` reads back to the last bit.

    Parameters
    ----------
    drive : Drive
        What to write; its name and remarks are not part of any format.
    path : path-like
        A file with one of `LOG_SUFFIXES`, or else a drive folder; must not exist, or be an empty
        folder.
    tell : callable, optional
        Told the fraction done of a log.

    Returns
    -------
    str
        What was written, in words.

    Raises
    ------
    InputError
        When it exists or cannot be written, or a log has no place for what is known of landmarks.
    """
    place = Path(path)
    if is_there(place) and not (place.is_dir() and not any(place.iterdir())):
        raise InputError("exists already; choose another name", place)
    if place.suffix not in LOG_SUFFIXES:
        write_folder(drive, place)
        return "drive folder"
    if drive.known.tells:
        raise InputError("a log has no place for landmarks.yaml; write a drive folder", place)
    # Imported here alone: rosbags takes a while.
    from homeward.drives.ros.writing import write_log

    write_log(drive, place, tell)
    return {".bag": "ROS 1 bag", ".mcap": "MCAP file", ".db3": "ROS 2 bag (sqlite3)"}[place.suffix]
