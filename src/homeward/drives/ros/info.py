"""What is in a log, and what homeward would make of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from homeward.drives.drive import Drive
from homeward.drives.folder import is_drive_folder, read_folder
from homeward.drives.one_clock import on_one_clock
from homeward.drives.ros.bag_folder import open_log
from homeward.drives.ros.bearings import IN_IMAGE, POINT, READERS
from homeward.drives.ros.choosing import OUR_SETTINGS, choose
from homeward.drives.ros.odometry import JOINT_STATE, NAV_ODOMETRY, POSES, TWISTS
from homeward.drives.ros.settings import LogSettings
from homeward.drives.ros.stamps import NANO
from homeward.drives.ros.survey import Survey, Tell, Topic, survey
from homeward.drives.ros.times import Clock
from homeward.drives.settings import read_settings, settings_yaml
from homeward.errors import InputError

REFUSED = "homeward run refuses it: {}."


@dataclass(frozen=True)
class LogInfo:
    """A log as `homeward info` tells of it."""

    kind: str
    topics: tuple[Topic, ...]
    settings: str
    """The topics file that says what is used without one: YAML; empty when there is none."""
    remarks: tuple[str, ...]
    """What serves for what, what is in the way, and what a reader counted, each a line."""


def log_info(path: Path, topics: Path | None = None, tell: Tell | None = None) -> LogInfo:
    """Look into a log, or a drive folder.

    Parameters
    ----------
    path : Path
        A ROS bag, an MCAP file, or a drive folder.
    topics : Path, optional
        A topics file to be tried.
    tell : callable, optional
        Told the fraction done.

    Raises
    ------
    InputError
        When it is none of them, or damaged.
    """
    if not path.exists():
        raise InputError("no such file or folder", path)
    if path.is_dir() and is_drive_folder(path):
        drive = read_folder(path)
        return LogInfo("drive folder", _streams(drive), "", tuple(_judged(drive, path)))
    told = LogSettings() if topics is None else read_settings(topics, LogSettings)
    log = open_log(path)
    known = survey(log, tell=tell)
    try:
        plan = choose(known, told)
    except InputError as error:
        return LogInfo(log.kind, known.topics, "", (f"{error.what}.", *_candidates(known)))
    missing = tuple(_missing(plan))
    remarks = (*missing, *(_candidates(known) if missing else ()), *_clock_refused(known, plan))
    return LogInfo(log.kind, known.topics, settings_yaml(plan), remarks)


def _streams(drive: Drive) -> tuple[Topic, ...]:
    """Return the files of a drive folder as if they were topics."""
    files = [
        ("odometry.csv", "t,v,omega", drive.odometry.t),
        ("bearings.csv", "t,landmark,bearing", np.unique(drive.sightings.t)),
    ]
    if drive.truth is not None:
        files.append(("truth.csv", "t,x,y,heading", drive.truth.t))
    return tuple(
        Topic(name, columns, np.rint(t * NANO).astype(np.int64), None) for name, columns, t in files
    )


def _judged(drive: Drive, path: Path) -> Iterator[str]:
    """Yield what looked wrong with a drive, and why it is refused where it would run."""
    try:
        yield from on_one_clock(drive, path).remark_lines
    except InputError as error:
        yield from drive.remark_lines
        yield REFUSED.format(error.what)


def _clock_refused(known: Survey, plan: LogSettings) -> Iterator[str]:
    """Yield why the clocks of a log are refused where it would run."""
    if OUR_SETTINGS in (topic.name for topic in known.topics):
        return  # its clock is the drive's, with the epoch that its settings name
    try:
        Clock(known, plan, None)
    except InputError as error:
        yield REFUSED.format(error.what)


def _missing(plan: LogSettings) -> Iterator[str]:
    if plan.odometry is None:
        yield "No topic tells odometry."
    if not plan.bearings:
        yield "No topic tells bearings."
    if plan.home is None:
        yield (
            "Nothing tells what the camera saw at home: name it under home in a topics file "
            "(csv, topic, or during: [from, until])."
        )


def _candidates(known: Survey) -> Iterator[str]:
    """Say what each topic could serve as."""
    for topic in known.topics:
        if topic.type == NAV_ODOMETRY:
            yield f"{topic.name} can tell odometry (use: twist, or use: pose)."
        elif topic.type == JOINT_STATE:
            yield f"{topic.name} can tell odometry, given wheel_radius and track_width."
        elif topic.type in TWISTS:
            yield f"{topic.name} can tell odometry."
        elif topic.type in POSES:
            yield f"{topic.name} can tell odometry, or the truth."
        elif topic.type in IN_IMAGE:
            yield f"{topic.name} can tell bearings, given a camera model."
        elif topic.type == POINT:
            yield f"{topic.name} can tell the bearings of one landmark."
        elif topic.type in READERS:
            yield f"{topic.name} can tell bearings."
