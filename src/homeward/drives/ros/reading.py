"""A drive out of a log: a second walk, in which the chosen topics are decoded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from homeward.drives.cameras.calibration import CameraRows, is_calibration, read_calibration
from homeward.drives.cameras.lens import Lens
from homeward.drives.drive import Drive, HomeBearing, Sightings, Truth
from homeward.drives.folder import REPEATED_TRUTH, home_of, read_home, sightings_of
from homeward.drives.home.spin import with_home
from homeward.drives.one_clock import without_bearing_delay
from homeward.drives.ros.log import Log
from homeward.drives.ros.measurements.bearings import Eye, SightingRows, frame_of
from homeward.drives.ros.measurements.extrinsics import (
    TF_STATIC,
    TopicSightings,
    Transforms,
    extrinsics,
)
from homeward.drives.ros.measurements.odometry import OdometryRows, pose_of
from homeward.drives.ros.measurements.rows import Remarks, clean_rows, in_order
from homeward.drives.ros.messages.decoding import Decoder
from homeward.drives.ros.settings import NAME_BEARINGS, PICTURES, BearingsTopic, LogSettings
from homeward.drives.ros.topics.choosing import OUR_SETTINGS, choose
from homeward.drives.ros.topics.survey import MessageTimes, OnProgress, TopicSurvey, survey
from homeward.drives.settings import DriveSettings
from homeward.errors import InputError, naming_file
from homeward.geometry.frames import Pose
from homeward.io.settings import parse_settings, read_settings
from homeward.io.table import Table, quoted

Taker: TypeAlias = Callable[[float, Any], None]
"""Takes the time [s] of a message, and the message."""


def read_log(
    path: Path,
    topics: Path | None = None,
    on_progress: OnProgress | None = None,
    eye: Eye | None = None,
) -> Drive:
    """Read a drive from a ROS 1 bag, a ROS 2 bag or an MCAP file.

    `topics` is a YAML file of `LogSettings`; missing keys are guessed. `on_progress` receives the
    fraction done, in [0, 1]. `eye` detects tags in images; without it, image topics are not used.
    Times are header stamps by default, counted from `DriveSettings.epoch` where they are Unix time.
    Remarks count the messages that were left out. `InputError` where the log is damaged, or its
    topics do not make a drive.
    """
    told = LogSettings() if topics is None else read_settings(topics, LogSettings)
    first_half = None if on_progress is None else lambda done: on_progress(done / 2)
    told = calibrated(told, path if topics is None else topics)
    known = survey(Log(path), keep=(OUR_SETTINGS,), on_progress=first_half)
    return read_planned(
        known, choose(known, told, pictures=eye is not None), topics, on_progress, eye
    )


def read_planned(
    known: TopicSurvey,
    plan: LogSettings,
    topics: Path | None = None,
    on_progress: OnProgress | None = None,
    eye: Eye | None = None,
) -> Drive:
    """Read a drive from the topics of a `plan`; the others as `read_log`, which see."""
    with naming_file(known.log.path):
        return _Reading(known, plan, topics, eye).drive(on_progress)


def calibrated(told: LogSettings, beside: Path) -> LogSettings:
    """Return settings in which calibration files are read."""
    topics = tuple(
        topic.model_copy(update={"camera": read_calibration(beside.parent, topic.camera)})
        if isinstance(topic.camera, str) and is_calibration(topic.camera)
        else topic
        for topic in told.bearings
    )
    return told.model_copy(update={"bearings": topics}) if topics else told


class _Reading:
    """The second walk: who takes which topic, and what they make of it together."""

    def __init__(
        self, known: TopicSurvey, plan: LogSettings, topics: Path | None, eye: Eye | None
    ) -> None:
        self._eye = eye
        self._known, self._plan, self._topics = known, plan, topics
        self._path, self._decoder = known.log.path, Decoder()
        if plan.odometry is None:
            raise InputError("no topic with odometry in it; homeward info lists what there is")
        self._settings, epoch = self._drive_settings()
        self._clock = MessageTimes(known, plan, epoch)
        self._remarks = Remarks()
        self._takers: dict[str, list[Taker]] = {}
        told = plan.odometry
        self._odometry = OdometryRows(told, known.topic(told.topic).type)
        self._take(told.topic, self._odometry.add)
        self._seen = [self._take_sightings(topic) for topic in plan.bearings]
        self._at_home: SightingRows | None = None
        if plan.home is not None and plan.home.topic is not None:
            self._at_home = self._rows_of(BearingsTopic(topic=plan.home.topic))()
            self._take(plan.home.topic, self._at_home.add)
        self._transforms = Transforms()
        if plan.mount is not None:
            if not plan.bearings:
                raise InputError(f"mount is for topics of bearings: {NAME_BEARINGS}")
            known.topic(TF_STATIC)
        if plan.mount is not None or (
            len(plan.bearings) > 1 and TF_STATIC in (topic.name for topic in known.topics)
        ):
            self._take(TF_STATIC, self._transforms.add)
        self._poses: list[tuple[float, ...]] = []
        if plan.truth is not None:
            self._take(
                plan.truth.topic, lambda t, m: self._poses.append((t, *map(float, pose_of(m))))
            )

    def drive(self, on_progress: OnProgress | None) -> Drive:
        """Walk, and put together what was met."""
        self._walk(on_progress)
        self._mount()
        odometry = self._odometry.odometry(self._remarks)
        sightings = self._sightings()
        found = Drive(
            name=self._path.resolve().stem,
            odometry=odometry,
            sightings=sightings,
            home=self._home(),
            settings=self._clock.in_settings(self._settings),
            truth=self._truth(),
            remarks=self._known.log.cut_short | dict(self._remarks),
        )
        drive, told = without_bearing_delay(found), self._plan.home
        return drive if told is None else with_home(drive, told)

    def _drive_settings(self) -> tuple[DriveSettings, int | None]:
        """Return the drive's settings, the user's before the log's own, and the log's epoch [s]."""
        told = self._plan.drive
        kept = self._known.kept.get(OUR_SETTINGS)
        if kept is None:
            return told or DriveSettings(), None
        text = self._decoder.decode(kept.channel, kept.data)
        if not isinstance(getattr(text, "data", None), str):
            raise InputError(f"{OUR_SETTINGS} is a {quoted(kept.channel.type)}, not text")
        place = Path(f"{self._path}, {OUR_SETTINGS}")
        own = parse_settings(text.data, DriveSettings, place)
        return told or own, own.epoch or 0

    def _mount(self) -> None:
        """Set the extrinsics of the camera, and give all bearings in the frame of the first one."""
        self._cameras = [
            TopicSightings(frame, rows)
            for by_frame in self._seen
            for frame, rows in by_frame.items()
            if len(rows)
        ]
        sensor = extrinsics(self._cameras, self._transforms, self._plan)
        if sensor is None:
            return
        update: dict[str, Any] = dict(sensor)
        if any(abs(camera.rows.in_reference.heading) > 0 for camera in self._cameras):
            update["field_of_view"] = None  # that of one camera is not that of all
        sensor_now = self._settings.sensor.model_copy(update=update)
        self._settings = self._settings.model_copy(update={"sensor": sensor_now})

    def _take(self, topic: str, taker: Taker) -> None:
        self._takers.setdefault(topic, []).append(taker)

    def _take_sightings(self, told: BearingsTopic) -> dict[str, SightingRows]:
        """Return the sightings of a topic by frame, as they will come in."""
        rows: dict[str, SightingRows] = {}
        new = self._rows_of(told)

        def add(t: float, message: Any) -> None:
            frame = frame_of(message)
            if frame not in rows:
                rows[frame] = new()
            rows[frame].add(t, message)

        self._take(told.topic, add)
        return rows

    def _rows_of(self, told: BearingsTopic) -> Callable[[], SightingRows]:
        kind = self._known.topic(told.topic).type
        eye = self._eye if kind in PICTURES else None
        camera = self._take_camera(told)
        return lambda: SightingRows(told, kind, self._remarks, camera, eye)

    def _take_camera(self, told: BearingsTopic) -> Callable[[], Lens | None]:
        """Return what tells the camera of a topic when the walk is over."""
        if not isinstance(told.camera, str):
            model = told.camera
            return lambda: model
        rows = CameraRows(told.camera, told.rectified)
        self._take(told.camera, rows.add)
        return rows.model

    def _walk(self, on_progress: OnProgress | None) -> None:
        log, clock = self._known.log, self._clock
        for number, message in enumerate(log.messages(topics=self._takers)):
            topic = message.channel.topic
            if topic in self._takers:
                decoded = self._decoder.decode(message.channel, message.data)
                try:
                    t = clock.time(message, decoded)
                    for taker in self._takers[topic]:
                        taker(t, decoded)
                except (AttributeError, TypeError, ValueError, IndexError) as error:
                    # The definition in the log lacks a field, or has another kind of it.
                    kind = quoted(message.channel.type)
                    raise InputError(f"{topic}: its {kind} is none that is known here") from error
            if on_progress is not None and number % 500 == 0:
                on_progress((1 + log.done) / 2)

    def _sightings(self) -> Sightings:
        parts = [camera.rows.columns() for camera in self._cameras]
        if not parts:
            return Sightings.of_rows(())
        columns = {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}
        for part in parts:
            in_order(part["t"], "sightings", self._remarks)  # counted for each camera
        order = np.argsort(columns["t"], kind="stable")
        rows = Table(self._path, order + 1, {n: c[order] for n, c in columns.items()})
        return sightings_of(rows, self._remarks)

    def _home(self) -> dict[str, HomeBearing]:
        told = self._plan.home
        if told is None or (told.csv is None and told.topic is None):
            return {}
        if told.csv is not None:
            beside = self._topics.parent if self._topics is not None else self._path.parent
            return read_home(beside / told.csv, self._remarks)
        assert self._at_home is not None
        columns = self._at_home.columns()
        first = columns["t"] == columns["t"][:1]
        rows = np.flatnonzero(first) + 1
        table = Table(self._path, rows, {n: c[first] for n, c in columns.items()})
        return home_of(table, self._remarks)

    def _truth(self) -> Truth | None:
        told = self._plan.truth
        if told is None or not self._poses:
            return None
        rows = clean_rows(self._poses, told.topic, "true poses", REPEATED_TRUTH, self._remarks)
        t, x, y, heading = rows.T.copy()
        if told.home is None:
            return Truth(t, x, y, heading)
        return Truth(t, x, y, heading).seen_from(Pose(*told.home))
