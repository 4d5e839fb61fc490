"""Open a drive of any format, and save one."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from dataclasses import dataclass
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
from homeward.drives.home.choosing import with_home
from homeward.drives.images import IMAGES
from homeward.drives.importers.mrclam import is_mrclam, mrclam_command
from homeward.drives.one_clock import on_one_clock, on_time
from homeward.drives.ros.log import is_log
from homeward.drives.settings import HomeWhen
from homeward.errors import InputError, speaking_of
from homeward.geometry.frames import Pose
from homeward.io.reading import is_there, shipped
from homeward.io.settings import validated
from homeward.io.table import quoted

SAMPLE = "sample"
"""The word for the drive that ships inside the package."""
TABLES = (".csv", ".tsv")
"""Files that may be made a drive."""


@dataclass(frozen=True)
class Choices:
    """What a user says of a drive beside where it is."""

    topics: Path | None
    home_spin: tuple[float, float] | None
    tell: Callable[[float], None] | None

    def refuse_topics(self, kind: str, path: Path) -> None:
        """Raise InputError when topics were named: a drive of this kind has none."""
        if self.topics is not None:
            raise InputError(f"there are no topics to choose in a {kind}", path)


@dataclass(frozen=True)
class Reader:
    """One kind of drive."""

    kind: str
    """In words, for messages."""
    recognises: Callable[[Path], bool]
    read: Callable[[Path, Choices], Drive]


def open_drive(
    path: str | os.PathLike[str],
    *,
    topics: str | os.PathLike[str] | None = None,
    home_spin: tuple[float, float] | None = None,
    tell: Callable[[float], None] | None = None,
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
    tell : callable, optional
        Told the fraction done of a log or of images, in [0, 1].

    Raises
    ------
    InputError
        When no reader knows it, its reader refuses it, or bearings and odometry do not overlap.
    """
    place = located(path)
    named = None if topics is None else Path(topics)
    choices = Choices(named, home_spin, tell)
    drive = on_one_clock(on_time(reader_of(place).read(place, choices)), place)
    drive = _truth_from_home(drive, place)
    when = drive.settings.home
    if home_spin is not None:
        when = validated(HomeWhen, {"spin": home_spin})
    elif when is not None and drive.home:
        raise InputError(f"home is told twice: in {HOME} and under home in {SETTINGS}", place)
    with speaking_of(place):
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


def reader_of(place: Path) -> Reader:
    """Return the reader that recognises a path; `InputError` says what to do where none does."""
    for reader in READERS:
        if reader.recognises(place):
            return reader
    if place.is_dir() and next(place.glob("*/place.yaml"), None) is not None:
        ways = "homeward place tells of it, homeward run DRIVE --place uses it"
        raise InputError(f"a place, not a drive: {ways}", place)
    if any(file.suffix.lower() in TABLES for file in (place, *place.glob("*"))):
        raise InputError("no drive yet: homeward import makes one of tables of any columns", place)
    if logs := sorted(file.name for file in place.glob("*.bag")):
        raise InputError(f"a folder of logs; name one: {', '.join(map(quoted, logs[:4]))}", place)
    if is_mrclam(place):
        raise InputError(f"an MRCLAM folder: {mrclam_command(place)} makes a drive of it", place)
    kinds = " nor ".join(reader.kind for reader in READERS)
    raise InputError(f"neither {kinds}", place)


def _open_folder(path: Path, choices: Choices) -> Drive:
    choices.refuse_topics("drive folder", path)
    return read_folder(path, home_needed=choices.home_spin is None)


def _open_log(path: Path, choices: Choices) -> Drive:
    # Imported here alone: rosbags takes a while.
    from homeward.drives.ros.reading import read_log

    return read_log(path, choices.topics, choices.tell)


def _open_images(path: Path, choices: Choices) -> Drive:
    choices.refuse_topics("folder of images", path)
    # Imported here alone: what only reads logs needs no images.
    from homeward.vision.recorded.recording import see_recording

    return see_recording(path, choices.tell)


def is_image_folder(path: Path) -> bool:
    """Whether it has images, and no bearings yet."""
    # A drive folder may have images, too: its bearings are known already.
    return is_there(path / IMAGES) and not is_there(path / BEARINGS)


READERS = (
    Reader("a folder of images (images.csv)", is_image_folder, _open_images),
    Reader("a drive folder (odometry.csv, bearings.csv, home.csv)", is_drive_folder, _open_folder),
    Reader("a log (a ROS bag or an MCAP file)", is_log, _open_log),
)
"""In the order in which they are asked."""


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
