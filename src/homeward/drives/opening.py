"""Reading and writing of drives in any format."""

from __future__ import annotations

import dataclasses
import difflib
import os
import re
from collections.abc import Callable
from pathlib import Path

from homeward.drives.drive import Drive
from homeward.drives.folder import (
    BEARINGS,
    HOME,
    KNOWN,
    ODOMETRY,
    SETTINGS,
    TILT,
    is_drive_folder,
    read_folder,
    read_home,
    write_folder,
)
from homeward.drives.images import IMAGES, cameras_in
from homeward.drives.plausibility import with_clock_remarks
from homeward.drives.robot import with_calibration
from homeward.drives.ros.kinds import is_log
from homeward.drives.senses import with_sense_remark
from homeward.drives.settings import RobotSettings, home_when
from homeward.errors import InputError, as_typed, naming_file
from homeward.geometry.frames import Pose
from homeward.io.naming import command
from homeward.io.reading import is_there, naming, opened, shipped
from homeward.io.settings import read_settings
from homeward.io.table import quoted

SAMPLE = "sample"
"""Name of the sample drive in the package."""
IMAGE_FOLDER = "folder of images (images.csv)"
DRIVE_FOLDER = "drive folder (odometry.csv, bearings.csv, home.csv)"
LOG = "log (a ROS bag, an MCAP file or a .wpilog file)"
TABLES, TEXT = (".csv", ".tsv"), ".txt"
"""Suffixes of files that `homeward import` converts; one of text only if it has numbers."""
HEAD_BYTES = 4096
"""Size of the beginning of a text file that shows whether it is a table."""
ROW = re.compile(rb"^[-+.\d]+[,;\s]+[-+.\d]+([,;\s]|$)", re.MULTILINE)
"""Beginning of a line of a table: two numbers."""


def open_drive(
    path: str | os.PathLike[str],
    *,
    topics: str | os.PathLike[str] | None = None,
    robot_file: str | os.PathLike[str] | None = None,
    home_spin: tuple[float, float] | None = None,
    home_during: tuple[float, float] | None = None,
    home_at: float | None = None,
    home_file: str | os.PathLike[str] | None = None,
    home_needed: bool = True,
    on_progress: Callable[[float], None] | None = None,
) -> Drive:
    """Read a drive in any known format.

    Parameters
    ----------
    path : path-like
        A drive folder, a folder of images, a ROS bag, an MCAP file or `SAMPLE`.
    topics : path-like, optional
        As in `read_log`; only for logs.
    robot_file : path-like, optional
        The robot.yaml of the robot, see `homeward tune`; the drive's own settings replace its keys.
    home_spin : (float, float), optional
        Interval in which the robot turned on the spot at home, since the first sample of the drive
        [s]; replaces the home bearings of the drive.
    home_during : (float, float), optional
        Interval in which it was at rest there, instead.
    home_at : float, optional
        Time of the pose that is home, since the first sample of the drive [s], instead; its
        bearings come from a map of the drive.
    home_file : path-like, optional
        A table like home.csv, instead.
    home_needed : bool
        Whether a drive folder must define home; later drives in a place need none.
    on_progress : callable, optional
        Receives the fraction done, in [0, 1], of a log, of images, or of the map for `home_at`.

    Raises
    ------
    InputError
        For an unknown format or invalid data, or where bearings and odometry do not overlap.
    """
    chosen = home_when(home_during, home_spin, home_at)
    if chosen is not None and home_file is not None:
        raise InputError("give a time at home or a file with home bearings, not both")
    robot = None if robot_file is None else read_settings(Path(robot_file), RobotSettings)
    place = located(path)
    kind = kind_of(place)
    if topics is not None and kind != LOG:
        raise InputError(f"topics are for logs, not for a {kind.partition(' (')[0]}", place)
    # Imported where needed only: rosbags and OpenCV load slowly.
    if kind == IMAGE_FOLDER:
        from homeward.vision.recorded.recording import see_recording

        drive = with_calibration(see_recording(place, on_progress), robot)
    elif kind == DRIVE_FOLDER:
        drive = with_calibration(
            read_folder(place, home_needed=home_needed and chosen is None and home_file is None),
            robot,
        )
    else:
        from homeward.drives.ros.reading import read_log

        file = None if topics is None else Path(topics)
        drive = read_log(place, file, on_progress, robot=robot)
    drive = _truth_from_home(with_clock_remarks(drive, place), place)
    when = drive.settings.home
    if home_file is not None:
        when, remarks = None, dict(drive.remarks)
        home = read_home(Path(home_file), remarks, drive.sightings)
        drive = dataclasses.replace(drive, home=home, remarks=remarks)
    elif chosen is not None:
        when = chosen
    elif when is not None and drive.home:
        problem = f"home is given twice, in {HOME} and under home in {SETTINGS}"
        raise InputError(problem, place, advice="remove one of them")
    with naming_file(place):
        drive = with_sense_remark(drive)
        if when is None:
            return drive
        from homeward.drives.home.when import with_home

        return with_home(drive, when, on_progress)


def _truth_from_home(drive: Drive, place: Path) -> Drive:
    """Return a drive with its ground truth transformed to the home frame, per its settings."""
    if drive.settings.truth is None:
        return drive
    if drive.truth is None:
        problem = "truth: the drive has no ground truth"
        raise InputError(problem, place, part=SETTINGS, advice="remove the key")
    settings = drive.settings.model_copy(update={"truth": None})
    truth = drive.truth.seen_from(Pose(*drive.settings.truth.home))
    return dataclasses.replace(drive, settings=settings, truth=truth)


def located(path: str | os.PathLike[str]) -> Path:
    """Return the path of a drive, or of the sample drive; `InputError` where neither exists."""
    place = Path(path)
    if is_there(place):
        return place
    if str(path) == SAMPLE:
        return sample_drive()
    near = [file.name for file in place.parent.glob("*")] if place.parent.is_dir() else []
    similar = difflib.get_close_matches(place.name, near, 1)
    advice = f"; did you mean {as_typed(place.with_name(similar[0]))}?" if similar else ""
    raise InputError(f"no such file or folder{advice}", place)


def sample_drive() -> Path:
    """Return the folder of the sample drive in the package."""
    return shipped(SAMPLE)


def kind_of(place: Path) -> str:
    """Return the kind of drive at a path; `InputError` with advice where there is none."""
    for kind, recognises in KINDS.items():
        if recognises(place):
            return kind
    if place.is_dir() and next(place.glob("*/place.yaml"), None) is not None:
        ways = "use homeward place info PLACE to inspect it, or homeward run DRIVE --place PLACE"
        raise InputError("a place, not a drive", place, advice=ways)
    if tables := tables_in(place):
        way = command("import", *tables, "--out", f"out/{place.resolve().stem}")
        others = ", and add the tables of odometry, bearings and home that it lacks"
        more = others * (tables == [place])
        raise InputError("not a drive yet", place, advice=f"convert its tables with `{way}`{more}")
    if logs := sorted(file.name for file in place.glob("*.bag")):
        advice = f"give one: {', '.join(map(quoted, logs[:4]))}"
        raise InputError("a folder of logs", place, advice=advice)
    from homeward.drives.importers.mrclam import is_mrclam, mrclam_command, robots_in

    if is_mrclam(place):
        ways = f"convert one of its robots ({robots_in(place)}) with `{mrclam_command(place)}`"
        raise InputError("an MRCLAM folder", place, advice=ways)
    raise InputError(f"neither a {' nor a '.join(KINDS)}", place)


def tables_in(place: Path) -> list[Path]:
    """Return the tables in a folder, or the path itself if it is a table."""
    return [file for file in (place, *sorted(place.glob("*"))) if _is_table(file)]


def _is_table(file: Path) -> bool:
    """Whether a file is a table, by its name and, with the suffix of text, its beginning."""
    if file.suffix.lower() != TEXT or not file.is_file():
        return file.suffix.lower() in TABLES
    with naming(file, "cannot be read"), opened(file) as stream:
        return ROW.search(stream.read(HEAD_BYTES)) is not None


def is_image_folder(path: Path) -> bool:
    """Whether a folder has images of one or several cameras, and no bearings yet.

    A drive folder may have images, too; several cameras share its odometry.
    """
    if is_there(path / BEARINGS):
        return False
    return is_there(path / IMAGES) or (is_there(path / ODOMETRY) and bool(cameras_in(path)))


KINDS = {IMAGE_FOLDER: is_image_folder, DRIVE_FOLDER: is_drive_folder, LOG: is_log}
"""Test for each kind of drive; the first that is true counts."""
LOG_SUFFIXES = (".bag", ".mcap", ".db3")
"""ROS 1 bag, MCAP, and the sqlite3 file of a ROS 2 bag."""


def save_drive(
    drive: Drive,
    path: str | os.PathLike[str],
    on_progress: Callable[[float], None] | None = None,
    *,
    commented: bool = False,
) -> str:
    """Write a drive that `open_drive` reads back exactly; return the name of the format.

    Parameters
    ----------
    drive : Drive
        The drive; its name and remarks are not written.
    path : path-like
        A file with one of `LOG_SUFFIXES`, or else a drive folder; a new path or an empty folder.
    on_progress : callable, optional
        Receives the fraction done of a log, in [0, 1].
    commented : bool
        Whether the drive.yaml of a folder lists all keys, those that are not set as comments.

    Raises
    ------
    InputError
        When the path exists or cannot be written, or a log is to contain known landmarks or a tilt.
    """
    place = Path(path)
    if is_there(place) and not (place.is_dir() and not any(place.iterdir())):
        raise InputError("exists already", place, advice="choose another name")
    if place.suffix not in LOG_SUFFIXES:
        write_folder(drive, place, commented=commented)
        return "drive folder"
    for file, is_given in ((KNOWN, drive.known.is_given), (TILT, drive.tilt is not None)):
        if is_given:
            advice = "write a drive folder instead"
            raise InputError(f"a log cannot contain {file}", place, advice=advice)
    # Imported here only: rosbags loads slowly.
    from homeward.drives.ros.writing import write_log

    write_log(drive, place, on_progress)
    return {".bag": "ROS 1 bag", ".mcap": "MCAP file", ".db3": "ROS 2 bag (sqlite3)"}[place.suffix]
