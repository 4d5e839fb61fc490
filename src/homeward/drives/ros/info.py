"""What is in a log, and what homeward would make of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from homeward.drives import folder as csv
from homeward.drives.drive import Truth
from homeward.drives.images import IMAGES, read_images
from homeward.drives.importers.mrclam import is_mrclam, mrclam_command
from homeward.drives.one_clock import on_one_clock, without_bearing_delay
from homeward.drives.opening import is_image_folder, kind_of, located
from homeward.drives.ros.log import Log
from homeward.drives.ros.measurements.bearings import IN_IMAGE, POINT, READERS
from homeward.drives.ros.measurements.odometry import JOINT_STATE, NAV_ODOMETRY, POSES, TWISTS
from homeward.drives.ros.messages.stamps import NANO
from homeward.drives.ros.settings import NAME_HOME, LogSettings
from homeward.drives.ros.topics.choosing import OUR_SETTINGS, choose
from homeward.drives.ros.topics.survey import OnProgress, Topic, TopicSurvey, survey
from homeward.errors import InputError
from homeward.io.settings import read_settings, settings_yaml

REFUSED = "homeward run refuses it: {}."


@dataclass(frozen=True)
class LogInfo:
    """A log as `homeward info` tells of it."""

    kind: str
    topics: tuple[Topic, ...]
    """Of a log; of a folder, its files as if they were topics."""
    plan: LogSettings | None
    """What of a log is used; None where it is none, or there is no way to use it."""
    remarks: tuple[str, ...]
    """What serves for what, what is in the way, and what a reader counted, each a line."""
    folder: bool = False
    """Whether it is a folder of CSV files or images."""

    @property
    def settings(self) -> str:
        """The topics file that says what is used without one: YAML; empty when there is none."""
        return "" if self.plan is None else settings_yaml(self.plan)


def log_info(
    path: Path, topics: Path | None = None, on_progress: OnProgress | None = None
) -> LogInfo:
    """Look into a log, or a folder that holds a drive, complete or not, and try a topics file."""
    path = located(path)
    if is_mrclam(path):
        way = f"{mrclam_command(path)} makes a drive of it."
        return LogInfo("MRCLAM folder", (), None, (way,), folder=True)
    kind_of(path)  # refuses what is nothing
    if is_image_folder(path):
        return _folder_info("folder of images", path, (IMAGES, csv.ODOMETRY))
    if csv.is_drive_folder(path):
        return _folder_info("drive folder", path, csv.REQUIRED)
    from homeward.drives.ros.reading import calibrated

    told = LogSettings() if topics is None else read_settings(topics, LogSettings)
    log = Log(path)
    half = None if on_progress is None else lambda done: on_progress(done / 2)
    known = survey(
        log,
        keep=(OUR_SETTINGS, *(kind for kinds, _ in _SERVES for kind in kinds)),
        on_progress=half,
    )
    cut_short = [f"{number:,} {reason}" for reason, number in log.cut_short.items()]
    try:
        plan = choose(known, calibrated(told, path if topics is None else topics))
    except InputError as error:
        remarks = (*cut_short, f"{error.what}.", *_candidates(known))
        return LogInfo(log.kind, known.topics, None, remarks)
    missing = tuple(_missing(plan))
    remarks = (
        *cut_short,
        *missing,
        *(_candidates(known) if missing else ()),
        *_tried(known, plan, topics, on_progress),
    )
    return LogInfo(log.kind, known.topics, plan, tuple(dict.fromkeys(remarks)))


_Remarks = dict[str, int]
_TIMED: dict[str, tuple[str, Callable[[Path, _Remarks], np.ndarray]]] = {
    csv.ODOMETRY: ("t,v,omega", lambda file, told: csv.read_odometry(file, told).t),
    csv.BEARINGS: (
        "t,landmark,bearing",
        lambda file, told: np.unique(csv.read_sightings(file, told).t),
    ),
    IMAGES: ("t,file", lambda file, told: read_images(file.parent, told).t),
    csv.TRUTH: ("t,x,y,heading", lambda file, told: cast(Truth, csv.read_truth(file, told)).t),
}
"""Files with times: their columns, and what reads the times [s]."""


def _folder_info(kind: str, path: Path, needed: tuple[str, ...]) -> LogInfo:
    """Return what is in a folder, complete or not."""
    told: _Remarks = {}
    topics = tuple(
        Topic(name, columns, np.rint(times(path / name, told) * NANO).astype(np.int64), None)
        for name, (columns, times) in _TIMED.items()
        if (path / name).exists()
    )
    if (path / csv.HOME).exists():
        kind += f", {len(csv.read_home(path / csv.HOME, told))} landmarks seen at home"
    remarks: list[str] = []
    is_drive = needed == csv.REQUIRED
    if is_drive:
        missing = csv.missing_files(path)
    else:
        missing = [name for name in needed if not (path / name).exists()]
    if missing:
        remarks += [f"{number:,} {reason}" for reason, number in told.items()]
        remarks.append(REFUSED.format(f"there is no {', no '.join(missing)}"))
    elif is_drive:
        remarks += _judged(path)
    return LogInfo(kind, topics, None, tuple(remarks), folder=True)


def _judged(path: Path) -> Iterator[str]:
    """Yield what looked wrong with a drive, and why it is refused where it would run."""
    drive = csv.read_folder(path)
    if not drive.sightings.t.size:
        yield REFUSED.format(f"{csv.BEARINGS} has no rows")
    if not drive.home and not csv.has_home(path):
        yield REFUSED.format(f"{csv.HOME} has no rows")
    try:
        yield from on_one_clock(without_bearing_delay(drive), path).remark_lines
    except InputError as error:
        yield from drive.remark_lines
        yield REFUSED.format(error.what)


def _tried(
    known: TopicSurvey, plan: LogSettings, topics: Path | None, on_progress: OnProgress | None
) -> Iterator[str]:
    """Yield the remarks of reading a log as `homeward run` does, and why it is refused."""
    from homeward.drives.ros.reading import read_planned  # the extra bags

    if plan.odometry is None:
        return
    try:
        drive = on_one_clock(read_planned(known, plan, topics, on_progress), known.log.path)
    except InputError as error:
        yield REFUSED.format(error.what)
        return
    yield from drive.remark_lines
    if plan.bearings and not drive.sightings.t.size:
        yield REFUSED.format("no sightings of landmarks in it")


def _missing(plan: LogSettings) -> Iterator[str]:
    if plan.odometry is None:
        yield "No topic tells odometry."
    if not plan.bearings:
        yield "No topic tells bearings."
    if plan.home is None:
        yield f"Nothing tells what the camera saw at home: {NAME_HOME}."


_SERVES: tuple[tuple[tuple[str, ...], str], ...] = (
    ((NAV_ODOMETRY,), "odometry (use: twist, or use: pose)"),
    ((JOINT_STATE,), "odometry, given wheel_radius and track_width"),
    (TWISTS, "odometry"),
    (POSES, "odometry, or the truth"),
    (IN_IMAGE, "bearings, given a camera model"),
    ((POINT,), "the bearings of one landmark"),
    (tuple(READERS), "bearings"),
)
"""Types, and what they tell; the first that holds counts."""


def _candidates(known: TopicSurvey) -> Iterator[str]:
    """Say what each topic could serve as, if its messages can be decoded."""
    from homeward.drives.ros.messages.decoding import Decoder  # the extra bags

    for topic in known.topics:
        if words := next((words for types, words in _SERVES if topic.type in types), ""):
            first = known.kept[topic.name]
            try:
                Decoder().decode(first.channel, first.data)
                yield f"{topic.name} can tell {words}."
            except InputError as error:
                yield f"{error.what}."
