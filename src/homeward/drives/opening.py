"""Open a drive of any format, and save one."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path

from homeward.drives.drive import Drive
from homeward.drives.folder import (
    BEARINGS,
    HOME,
    SETTINGS,
    is_drive_folder,
    read_folder,
    write_folder,
)
from homeward.drives.home.spin import with_home
from homeward.drives.images import IMAGES
from homeward.drives.importers.mrclam import is_mrclam, mrclam_command
from homeward.drives.one_clock import on_one_clock, without_bearing_delay
from homeward.drives.ros.log import is_log
from homeward.drives.settings import HomeWhen
from homeward.errors import InputError, naming_file
from homeward.geometry.frames import Pose
from homeward.io.reading import is_there, shipped
from homeward.io.settings import validated
from homeward.io.table import quoted

SAMPLE = "sample"
"""The word for the drive that ships inside the package."""
IMAGE_FOLDER = "folder of images (images.csv)"
DRIVE_FOLDER = "drive folder (odometry.csv, bearings.csv, home.csv)"
LOG = "log (a ROS bag or an MCAP file)"
TABLES = (".csv", ".tsv")
"""Files that may be made a drive."""


def open_drive(
    path: str | os.PathLike[str],
    *,
    topics: str | os.PathLike[str] | None = None,
    home_spin: tuple[float, float] | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> Drive:
    """Read a drive of any known kind.

    Parameters
    ----------
    path : path-like
        A drive folder, a folder of images, a ROS bag, an MCAP file or `SAMPLE`.
    topics : path-like, optional
        As in `read_log`; refused elsewhere.
    home_spin : (float, float), optional
        From when until when the robot turned on the spot at home, since the drive's first sample
        [s]; instead of the home bearings that it brings.
    on_progress : callable, optional
        Told the fraction done of a log or of images, in [0, 1].

    Raises
    ------
    InputError
        When no reader knows it, its reader refuses it, or bearings and odometry do not overlap.
    """
    place = located(path)
    kind = kind_of(place)
    if topics is not None and kind != LOG:
        raise InputError(f"there are no topics to choose in a {kind.partition(' (')[0]}", place)
    # Imported where they are needed alone: rosbags and OpenCV take a while.
    if kind == IMAGE_FOLDER:
        from homeward.vision.recorded.recording import see_recording

        drive = see_recording(place, on_progress)
    elif kind == DRIVE_FOLDER:
        drive = read_folder(place, home_needed=home_spin is None)
    else:
        from homeward.drives.ros.reading import read_log

        drive = read_log(place, None if topics is None else Path(topics), on_progress)
    drive = _truth_from_home(on_one_clock(without_bearing_delay(drive), place), place)
    when = drive.settings.home
    if home_spin is not None:
        when = validated(HomeWhen, {"spin": home_spin})
    elif when is not None and drive.home:
        raise InputError(f"home is told twice: in {HOME} and under home in {SETTINGS}", place)
    with naming_file(place):
        return drive if when is None else with_home(drive, when)


def _truth_from_home(drive: Drive, place: Path) -> Drive:
    """Return a drive whose ground truth is in the home frame, by its settings."""
    if drive.settings.truth is None:
        return drive
    if drive.truth is None:
        raise InputError(f"{SETTINGS}: truth: the drive has no ground truth; remove the key", place)
    settings = drive.settings.model_copy(update={"truth": None})
    truth = drive.truth.seen_from(Pose(*drive.settings.truth.home))
    return dataclasses.replace(drive, settings=settings, truth=truth)


def located(path: str | os.PathLike[str]) -> Path:
    """Return the path of a drive, or of `SAMPLE` where no file has that name; else InputError."""
    place = Path(path)
    if is_there(place):
        return place
    if str(path) == SAMPLE:
        return sample_drive()
    raise InputError("no such file or folder", place)


def sample_drive() -> Path:
    """Return the folder of the sample drive that ships inside the package."""
    return shipped(SAMPLE)


def kind_of(place: Path) -> str:
    """Return the kind of drive at a path; `InputError` says what to do where there is none."""
    for kind, recognises in KINDS.items():
        if recognises(place):
            return kind
    if place.is_dir() and next(place.glob("*/place.yaml"), None) is not None:
        ways = "homeward place tells of it, homeward run DRIVE --place uses it"
        raise InputError(f"a place, not a drive: {ways}", place)
    if any(file.suffix.lower() in TABLES for file in (place, *place.glob("*"))):
        raise InputError("no drive yet: homeward import makes one of tables of any columns", place)
    if logs := sorted(file.name for file in place.glob("*.bag")):
        raise InputError(f"a folder of logs; name one: {', '.join(map(quoted, logs[:4]))}", place)
    if is_mrclam(place):
        raise InputError(f"an MRCLAM folder: {mrclam_command(place)} makes a drive of it", place)
    raise InputError(f"neither a {' nor a '.join(KINDS)}", place)


def is_image_folder(path: Path) -> bool:
    """Whether it has images, and no bearings yet."""
    # A drive folder may have images, too: its bearings are known already.
    return is_there(path / IMAGES) and not is_there(path / BEARINGS)


KINDS = {IMAGE_FOLDER: is_image_folder, DRIVE_FOLDER: is_drive_folder, LOG: is_log}
"""What recognises each kind of drive, in the order in which they are asked."""
LOG_SUFFIXES = (".bag", ".mcap", ".db3")
"""ROS 1 bag, MCAP, and the sqlite3 file of a ROS 2 bag."""


def save_drive(
    drive: Drive, path: str | os.PathLike[str], on_progress: Callable[[float], None] | None = None
) -> str:
    """Write a drive that `open_drive` reads back to the last bit.

    Parameters
    ----------
    drive : Drive
        What to write; its name and remarks are not part of any format.
    path : path-like
        A file with one of `LOG_SUFFIXES`, or else a drive folder; must not exist, or be an empty
        folder.
    on_progress : callable, optional
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
    if drive.known.is_given:
        raise InputError("a log has no place for landmarks.yaml; write a drive folder", place)
    # Imported here alone: rosbags takes a while.
    from homeward.drives.ros.writing import write_log

    write_log(drive, place, on_progress)
    return {".bag": "ROS 1 bag", ".mcap": "MCAP file", ".db3": "ROS 2 bag (sqlite3)"}[place.suffix]
