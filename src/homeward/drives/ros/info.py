"""The contents of a log or drive folder, and how homeward would use them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from homeward.drives import folder as csv
from homeward.drives.drive import Truth
from homeward.drives.home.when import PROPOSED, first_rest
from homeward.drives.images import IMAGES, cameras_in, read_images
from homeward.drives.importers.mrclam import is_mrclam, mrclam_command, robots_in
from homeward.drives.opening import is_image_folder, kind_of, located
from homeward.drives.plausibility import with_clock_remarks
from homeward.drives.robot import with_calibration
from homeward.drives.ros.kinds import OUR_SETTINGS
from homeward.drives.ros.log import Log
from homeward.drives.ros.measurements.sightings import axes_of
from homeward.drives.ros.presets import POSES_OF_TAGS
from homeward.drives.ros.settings import (
    NAME_HOME,
    PICTURES,
    BearingsTopic,
    LogSettings,
    OdometryTopic,
    calibrated,
    wildcard_part,
)
from homeward.drives.ros.stamps import NANO
from homeward.drives.ros.topics.by_fields import candidates, first_frame, shown, unread
from homeward.drives.ros.topics.choosing import (
    LASER_SCAN,
    NO_IDS_IN_SCAN,
    OTHER_THAN_SCAN,
    USES,
    choose,
    draft_of,
    use_of,
)
from homeward.drives.ros.topics.survey import MIN_TAGS, OnProgress, Topic, TopicSurvey, survey
from homeward.drives.senses import with_sense_remark
from homeward.errors import InputError
from homeward.io.naming import command
from homeward.io.settings import read_settings, settings_yaml
from homeward.io.table import quoted

FIRST_POSE = "--home", "at:0"
"""Options of a next command where home is not given: any other time works, too."""
NO_LANDMARKS = (
    "This log contains no landmarks: record detections of tags (or other landmarks with an id), or "
    "camera images for `homeward see`; docs/do/logs.md lists the message types."
)
REFUSED = "homeward run cannot use it: {}."


@dataclass(frozen=True)
class LogInfo:
    """The report of `homeward info`."""

    kind: str
    topics: tuple[Topic, ...]
    """Topics of a log; the files of a folder in the same form."""
    plan: LogSettings | None
    """The settings with which a log is used; None for a folder or an unusable log."""
    remarks: tuple[str, ...]
    """Usable topics, obstacles, and remarks of the reader, each a line."""
    folder: bool = False
    """Whether it is a folder of CSV files or images."""
    next: str = ""
    """The next command to type; empty where the remarks report the missing data."""
    draft: str = ""
    """A topics file to complete, where the choice of topics is not complete."""

    @property
    def settings(self) -> str:
        """The plan as a topics file in YAML; empty without a plan."""
        return "" if self.plan is None else settings_yaml(self.plan)


def log_info(
    path: Path, topics: Path | None = None, on_progress: OnProgress | None = None
) -> LogInfo:
    """Inspect a log, or a complete or incomplete drive folder, and try a topics file."""
    path, given = located(path), path
    if is_mrclam(path):
        words = f"Robots: {robots_in(path)}. Home is any pose in the frame of the survey."
        return LogInfo("MRCLAM folder", (), None, (words,), True, mrclam_command(given))
    kind_of(path)  # refuses an unknown kind
    if is_image_folder(path):
        listed = () if cameras_in(path) else (IMAGES,)
        return _folder_info("folder of images", path, given, (*listed, csv.ODOMETRY))
    if csv.is_drive_folder(path):
        return _folder_info("drive folder", path, given, csv.REQUIRED)
    settings = LogSettings() if topics is None else read_settings(topics, LogSettings)
    log = Log(path)
    keep = OUR_SETTINGS, *(kind for kinds, *_ in USES for kind in kinds)
    known = survey(log, keep, on_progress)
    cut_short = [f"{number:,} {reason}" for reason, number in log.cut_short.items()]
    try:
        plan = choose(known, calibrated(settings, path if topics is None else topics))
    except InputError as error:
        remarks = (*cut_short, f"{error.what}.", *_candidates(known))
        draft = draft_of(known.topics, None)
        return LogInfo(log.kind, known.topics, None, remarks, False, _with_topics(given), draft)
    absent = {
        "No topic contains odometry.": plan.odometry is None,
        "No topic has a type that is read as bearings without a topics file.": not plan.bearings,
        f"No home bearings found: {NAME_HOME}.": plan.home is None,
    }
    missing = [words for words, is_absent in absent.items() if is_absent]
    used = {(topic.topic, topic.frames) for topic in plan.bearings if topic.frames}
    remarks = (
        *cut_short,
        *missing,
        *(_candidates(known) if missing else ()),
        *(
            f"Bearings from the positions of frames in {tags.topic}: {tags}."
            for tags in (known.tag_frames if used else ())
            if (tags.topic, tags.frames) in used
        ),
        *_tried(known, plan, topics, on_progress),
    )
    following = _next(given, plan, topics, known, remarks)
    draft = "" if plan.bearings and plan.odometry else draft_of(known.topics, plan)
    if not (plan.bearings or draft or unread(known)) and following == _with_topics(given):
        remarks, following = (*remarks, NO_LANDMARKS), ""
    return LogInfo(
        log.kind, known.topics, plan, tuple(dict.fromkeys(remarks)), False, following, draft
    )


def _next(
    log: Path, plan: LogSettings, topics: Path | None, known: TopicSurvey, remarks: Sequence[str]
) -> str:
    """Return the next command for a log; remarks contain the reason why a run cannot use it."""
    has_pictures = any(topic.type in PICTURES for topic in known.topics)
    if plan.odometry is not None and not plan.bearings and has_pictures:
        return command("see", log, "--tags", "36h11", "--out", f"out/{log.stem}")
    if plan.odometry is None or not plan.bearings or _is_refused(remarks):
        return _with_topics(log)
    home = () if plan.home is not None else _home_options(remarks, log)
    return command("run", log, *(() if topics is None else ("--topics", topics)), *home)


def _home_options(remarks: Sequence[str], log: Path | None = None) -> Sequence[object]:
    """Return the options that give home where it is missing: a home.csv, or the proposed rest."""
    if log is not None and (home := (log if log.is_dir() else log.parent) / csv.HOME).exists():
        return "--home", home
    proposed = re.search(r"--home (during:[\d.]+,\d+(\.\d+)?)", " ".join(remarks))
    return FIRST_POSE if proposed is None else ("--home", proposed[1])


def _with_topics(log: Path) -> str:
    """Return the command that tries a topics file, which the user has to write."""
    return command("info", log, "--topics", "topics.yaml")


def _is_refused(remarks: Sequence[str]) -> bool:
    return any(remark.startswith(REFUSED.partition("{")[0]) for remark in remarks)


_Remarks = dict[str, int]
_TIMED: dict[str, tuple[str, Callable[[Path, _Remarks], np.ndarray]]] = {
    csv.ODOMETRY: ("t,v,omega", lambda file, remarks: csv.read_odometry(file, remarks).t),
    csv.BEARINGS: (
        "t,landmark,bearing",
        lambda file, remarks: np.unique(csv.read_sightings(file, remarks).t),
    ),
    IMAGES: ("t,file", lambda file, remarks: read_images(file.parent, remarks).t),
    csv.TRUTH: (
        "t,x,y,heading",
        lambda file, remarks: cast(Truth, csv.read_samples(Truth, file, remarks)).t,
    ),
}
"""Files with times: their columns, and the function that reads the times [s]."""


def _folder_info(kind: str, path: Path, given: Path, needed: tuple[str, ...]) -> LogInfo:
    """Return the contents of a folder, complete or not, which the user calls `given`."""
    counts: _Remarks = {}
    timed = _TIMED | {f"{camera}/{IMAGES}": _TIMED[IMAGES] for camera in cameras_in(path)}
    topics = tuple(
        Topic(name, columns, np.rint(times(path / name, counts) * NANO).astype(np.int64), None)
        for name, (columns, times) in timed.items()
        if (path / name).exists()
    )
    remarks, is_drive = list[str](), needed == csv.REQUIRED
    absent = [name for name in needed if not (path / name).exists()]
    missing = csv.missing_files(path) if is_drive else absent
    has_no_home = missing == [csv.HOME]
    if (path / csv.HOME).exists():
        bearings = len(csv.read_home(path / csv.HOME, counts))
        kind += f", {bearings} home bearings"
        has_no_home = is_drive and not (bearings or missing or csv.has_home(path))
    if has_no_home:
        remarks.append(f"No home bearings found: {csv.HOME_ADVICE}.")
    elif missing:
        remarks += [f"{number:,} {reason}" for reason, number in counts.items()]
        remarks.append(REFUSED.format(f"there is no {', no '.join(missing)}"))
    if is_drive and (has_no_home or not missing):
        remarks += _checked(path, not has_no_home)
    if _is_refused(remarks):
        following = ""
    elif is_drive:
        following = command("run", given, *(_home_options(remarks) if has_no_home else ()))
    else:
        following = command("see", given, "--out", f"out/{path.name}")
    return LogInfo(kind, topics, None, tuple(remarks), True, following)


def _checked(path: Path, home_needed: bool) -> Iterator[str]:
    """Yield the remarks about a drive, and the reason where `homeward run` cannot use it."""
    drive = csv.read_folder(path, home_needed=home_needed)
    if not drive.sightings.t.size:
        yield REFUSED.format(f"{csv.BEARINGS} has no rows")
    if not home_needed and (rest := first_rest(drive)) is not None:
        yield f"{PROPOSED.format(*rest).capitalize()}."
    try:
        yield from with_sense_remark(with_clock_remarks(with_calibration(drive), path)).remark_lines
    except InputError as error:
        yield from drive.remark_lines
        yield REFUSED.format(error.what)


def _tried(
    known: TopicSurvey, plan: LogSettings, topics: Path | None, on_progress: OnProgress | None
) -> Iterator[str]:
    """Yield the remarks about a log read as by `homeward run`, and the reason for an error."""
    from homeward.drives.ros.reading import read_planned  # the extra bags

    if plan.odometry is None:
        return
    try:
        drive = read_planned(known, plan, topics, on_progress)
        drive = with_sense_remark(with_clock_remarks(drive, known.log.path))
    except InputError as error:
        yield REFUSED.format(error.what)
        return
    if plan.home is None and (rest := first_rest(drive)) is not None:
        yield f"{PROPOSED.format(*rest).capitalize()}."
    yield from drive.remark_lines
    if plan.bearings and not drive.sightings.t.size:
        yield REFUSED.format("it contains no sightings of landmarks")


def _numbered(names: list[str]) -> list[str]:
    """Return patterns of names that differ in one integer, for at least `MIN_TAGS` names."""
    numbers = ((name, m) for name in names for m in re.finditer(r"\d+", name))
    patterns = Counter(f"{name[: m.start()]}*{name[m.end() :]}" for name, m in numbers)
    return [pattern for pattern, count in patterns.items() if count >= MIN_TAGS]


def _uses_by_fields(known: TopicSurvey, name: str) -> Iterator[str]:
    """Yield the possible uses of a topic of an unknown type."""
    for option in candidates(known, OdometryTopic(topic=name)):
        fields = f"v = {option.v}, omega = {option.omega}" + f", vy = {option.vy}" * bool(option.vy)
        yield f"odometry: {fields}, as in {shown([option])}"
    for given in candidates(known, BearingsTopic(topic=name)):
        axes = ""
        if given.position:
            frame = first_frame(known, given)
            by = f"frame_id {quoted(frame)}" if frame else "the missing frame_id"
            axes = f", axes from {by}: {axes_of(frame, given)}"
        yield f"bearings: {given.layout}{axes}, as in {shown([given])}"


def _candidates(known: TopicSurvey) -> Iterator[str]:
    """Yield the possible use of each topic, if its messages can be decoded."""
    from homeward.drives.ros.decoding import Decoder  # the extra bags

    patterns = _numbered([t.name for t in known.topics if t.type in POSES_OF_TAGS])
    for pattern in patterns:
        yield f'Topics {pattern} can be used as bearings: {{topic: "{pattern}"}}.'
    custom, unknown, undefined = unread(known), [], []
    for topic in known.topics:
        if any(wildcard_part(pattern, topic.name) for pattern in patterns):
            continue
        if topic.type == LASER_SCAN:
            yield f"{topic.name}: {NO_IDS_IN_SCAN}; {OTHER_THAN_SCAN}."
        elif words := use_of(topic)[0]:
            first = known.kept[topic.name]
            try:
                Decoder().decode(first.channel, first.data)
                yield f"{topic.name} can be used as {words}."
            except InputError as error:
                yield f"{error.what}."
        elif topic in custom:
            name = f"{topic.name} ({topic.type})"
            try:
                uses = list(_uses_by_fields(known, topic.name))
            except InputError as error:
                lacks = not known.channels[topic.name].definition
                undefined += [name] if lacks else []
                yield from () if lacks else (f"{error.what}.",)
                continue
            yield from (f"{name}: can be used as {use}." for use in uses)
            unknown += [] if uses else [name]
    if undefined:
        yield (
            f"The log has no definition of {', '.join(undefined)}, as usual in .db3 files before "
            "ROS 2 Iron; `ros2 bag convert` to MCAP, where that package is installed, adds it."
        )
    if unknown:
        yield f"Types that are not read yet: {', '.join(unknown)}."
