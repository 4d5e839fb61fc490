"""Reading of a drive from a log: a second pass decodes the chosen topics."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from homeward.drives.cameras.calibration import from_camera_info
from homeward.drives.cameras.lens import Lens
from homeward.drives.drive import Drive, HomeBearing, Sightings, Tilt, Truth
from homeward.drives.folder import SAMPLES, home_of, read_home, sightings_of
from homeward.drives.home.when import with_home
from homeward.drives.measure import roll_and_pitch, with_yaw_rate
from homeward.drives.robot import with_calibration
from homeward.drives.ros.decoding import Decoder
from homeward.drives.ros.kinds import OUR_SETTINGS
from homeward.drives.ros.log import Log
from homeward.drives.ros.measurements.extrinsics import (
    LINKED,
    TF,
    TF_STATIC,
    Transforms,
    extrinsics,
)
from homeward.drives.ros.measurements.odometry import OdometryRows
from homeward.drives.ros.measurements.sightings import (
    SightingRows,
    TagDetector,
    frame_of,
    landmark_of,
    parts_of,
)
from homeward.drives.ros.presets import IMU, MOTIONS, TRANSFORMS, orientation_of, row_of
from homeward.drives.ros.settings import (
    NAME_BEARINGS,
    PICTURES,
    BearingsTopic,
    LogSettings,
    calibrated,
)
from homeward.drives.ros.stamps import NANO, Remarks, clean_rows, in_order
from homeward.drives.ros.topics.choosing import choose
from homeward.drives.ros.topics.survey import IS_READ, MessageTimes, OnProgress, TopicSurvey, survey
from homeward.drives.settings import DriveSettings, Mount, OtherCamera, RobotSettings, Wheels
from homeward.errors import InputError, naming_file
from homeward.geometry.frames import Pose
from homeward.io.settings import parse_settings, read_settings
from homeward.io.table import Table, quoted

BOTH_CAMERAS = (
    "sightings of landmarks that another camera saw at the same stamp, stamped 1 ns later"
)
REPEATED_YAW_RATES = "yaw rates with the time of another, left out"
Handler: TypeAlias = Callable[[float, Any], None]
"""Receives the time [s] of a message, and the message."""


def read_log(
    path: Path,
    topics: Path | None = None,
    on_progress: OnProgress | None = None,
    detector: TagDetector | None = None,
    robot: RobotSettings | None = None,
) -> Drive:
    """Read a drive from a ROS 1 bag, a ROS 2 bag or an MCAP file.

    `topics` is a YAML file of `LogSettings`; missing keys are guessed. `on_progress` receives the
    fraction done, in [0, 1]. `detector` finds tags in images; without it, image topics are ignored.
    `robot` is as for `with_calibration`. Times are header stamps by default, counted from
    `DriveSettings.epoch` where they are Unix time. Remarks count the messages that were left out.
    `InputError` where the log is damaged, or its topics do not make a drive.
    """
    settings = LogSettings() if topics is None else read_settings(topics, LogSettings)
    settings = calibrated(settings, path if topics is None else topics)
    known = survey(Log(path), (OUR_SETTINGS,), on_progress)
    plan = choose(known, settings, pictures=detector is not None)
    return read_planned(known, plan, topics, on_progress, detector, robot)


def read_planned(
    known: TopicSurvey,
    plan: LogSettings,
    topics: Path | None = None,
    on_progress: OnProgress | None = None,
    detector: TagDetector | None = None,
    robot: RobotSettings | None = None,
) -> Drive:
    """Read a drive from the topics of a `plan`; other parameters as `read_log`."""
    odometry, wheels = plan.odometry, None if robot is None else robot.wheels
    if odometry is not None and wheels is not None and wheels.modules:
        known_wheels = {k: v for k, v in wheels if v and not getattr(odometry, k)}
        plan = plan.model_copy(update={"odometry": odometry.model_copy(update=known_wheels)})
    with naming_file(known.log.path):
        return _Reading(known, plan, topics, detector).drive(on_progress, robot)


class _Reading:
    """The second pass: handlers of topics, and the drive from their results."""

    def __init__(
        self,
        known: TopicSurvey,
        plan: LogSettings,
        topics: Path | None,
        detector: TagDetector | None,
    ) -> None:
        self._detector = detector
        self._known, self._plan, self._topics = known, plan, topics
        self._path, self._decoder = known.log.path, Decoder()
        if plan.odometry is None:
            names = {topic.name for topic in known.topics}
            of_tf = ", or, for the transforms odom -> base_link, use odometry: {topic: /tf}"
            advice = "run homeward info, which lists the topics" + of_tf * (TF in names)
            raise InputError("no topic with odometry", advice=advice)
        self._settings, epoch = self._drive_settings()
        self._clock = MessageTimes(known, plan, epoch)
        self._remarks = Remarks()
        self._handlers: dict[str, list[Handler]] = {}
        odometry = plan.odometry
        self._odometry = OdometryRows(odometry, known.topic(odometry.topic).type)
        self._subscribe(odometry.topic, self._odometry.add)
        self._yaw_rates = self._rows(odometry.yaw_rate, row_of(MOTIONS[IMU]))
        self._seen = [self._subscribe_sightings(topic) for topic in plan.bearings]
        self._at_home: SightingRows | None = None
        if plan.home is not None and plan.home.topic is not None:
            self._at_home = self._rows_of(BearingsTopic(topic=plan.home.topic))("")
            self._subscribe(plan.home.topic, self._at_home.add)
        self._transforms = Transforms()
        if plan.mount is not None and not plan.bearings:
            raise InputError(f"mount needs topics of bearings: {NAME_BEARINGS}")
        has_frames = any(given.frames for given in plan.bearings)
        if plan.mount is not None or len(plan.bearings) > 1 or has_frames:
            self._subscribe_transforms()
        self._tilts = self._rows(plan.tilt, lambda m: roll_and_pitch(orientation_of(m)))
        self._poses: list[tuple[float, ...]] = []
        if plan.truth is not None:
            paths = MOTIONS[known.topic(plan.truth.topic).type]
            pose = row_of({role: paths[role] for role in ("x", "y", "heading")})
            self._poses = self._rows(plan.truth.topic, pose)

    def drive(self, on_progress: OnProgress | None, robot: RobotSettings | None) -> Drive:
        """Read the messages and return the drive."""
        sensors = [part.sensor for part in (self._settings, robot) if part is not None]
        is_given = any(not s.model_fields_set.isdisjoint(Mount.model_fields) for s in sensors)
        names = {topic.name for topic in self._known.topics}
        if not is_given and TF_STATIC in names - self._handlers.keys():
            self._subscribe(TF_STATIC, lambda _, given: self._transforms.offer(given))
        self._read(on_progress)
        self._set_extrinsics()
        odometry = self._odometry.odometry(self._remarks)
        if (source := self._plan.odometry) is not None:
            if source.yaw_rate is not None:
                given = self._yaw_rates, source.yaw_rate, "yaw rates", REPEATED_YAW_RATES
                t, rate = clean_rows(*given, self._remarks).T
                odometry = with_yaw_rate(odometry, t, rate, source.yaw_rate, self._remarks)
            wheels = Wheels(**{k: v for k, v in source if k in Wheels.model_fields and v})
            if wheels != Wheels() and source.yaw_rate is None:
                self._settings = self._settings.model_copy(update={"wheels": wheels})
            fields = f"v = {source.v}, omega = {source.omega}"
            fields += f", vy = {source.vy}" * bool(source.vy)
            self._remark_fields(source.topic, fields, "odometry samples", odometry.t.size)
        sightings = self._sightings()
        found = Drive(
            name=self._path.resolve().stem,
            odometry=odometry,
            sightings=sightings,
            home=self._home(sightings),
            settings=self._clock.in_settings(self._settings),
            truth=self._truth(),
            tilt=self._tilt(),
            remarks=self._known.log.cut_short | self._clock.remarks | dict(self._remarks),
        )
        drive, home = with_calibration(found, robot), self._plan.home
        return drive if home is None else with_home(drive, home, on_progress)

    def _drive_settings(self) -> tuple[DriveSettings, int | None]:
        """Return the settings of the user, or else of the log, and the log's epoch [s]."""
        given = self._plan.drive
        kept = self._known.kept.get(OUR_SETTINGS)
        if kept is None:
            return given or DriveSettings(), None
        text = self._decoder.decode(kept.channel, kept.data)
        if not isinstance(getattr(text, "data", None), str):
            raise InputError(f"{OUR_SETTINGS} is a {quoted(kept.channel.type)}, not text")
        place = Path(f"{self._path}, {OUR_SETTINGS}")
        own = parse_settings(text.data, DriveSettings, place)
        return given or own, own.epoch or 0

    def _set_extrinsics(self) -> None:
        """Set the extrinsics, and transform all bearings to the frame of the first camera."""
        for given, by_frame in zip(self._plan.bearings, self._seen, strict=True):
            if given.frames and not by_frame:
                advice = "run homeward info without a topics file to list frames of tags"
                raise InputError(f"no frame in {given.topic} matches {given.frames}", advice=advice)
        self._cameras = [rows for by_frame in self._seen for rows in by_frame.values() if len(rows)]
        for rows in self._cameras:
            rows.use_axes_of_data()
            self._remark_fields(rows.given.topic, str(rows.given.layout), "sightings", len(rows))
        others: dict[str, OtherCamera] = {}
        sensor = extrinsics(self._cameras, self._transforms, self._plan, others)
        if sensor is None:
            return
        if self._plan.mount is None and len(self._cameras) == 1:
            (rows,) = self._cameras
            if rows.given.sensor is None and rows.kind not in TRANSFORMS:
                self._remarks.count(LINKED.format(rows.frame, *sensor.pose), len(rows))
        update: dict[str, Any] = dict(sensor)
        if others or any(abs(camera.in_reference.heading) > 0 for camera in self._cameras):
            update["field_of_view"] = None  # several cameras have no common one
        sensor_now = self._settings.sensor.model_copy(update=update)
        known: dict[str, Any] = {"sensor": sensor_now}
        if others:
            known["cameras"] = {**self._settings.cameras, **others}
        self._settings = self._settings.model_copy(update=known)

    def _remark_fields(self, topic: str, fields: str, what: str, number: int) -> None:
        if (kind := self._known.topic(topic).type) not in IS_READ:
            found = f"{what} in {topic}, of the unknown type {quoted(kind)}, read by fields"
            self._remarks.count(f"{found}: {fields}", number)

    def _subscribe(self, topic: str, handler: Handler) -> None:
        self._handlers.setdefault(topic, []).append(handler)

    def _rows(
        self, topic: str | None, row: Callable[[Any], tuple[float, ...]]
    ) -> list[tuple[float, ...]]:
        """Return the rows (t, values) of a topic, which are filled while the log is read."""
        rows = list[tuple[float, ...]]()
        if topic is not None:
            self._subscribe(topic, lambda t, message: rows.append((t, *row(message))))
        return rows

    def _subscribe_transforms(self) -> None:
        """Collect the frames of the robot; those of landmarks are not needed."""
        names = {topic.name for topic in self._known.topics}
        if self._plan.mount is not None and TF not in names:
            self._known.topic(TF_STATIC)
        if TF_STATIC in names:
            self._subscribe(TF_STATIC, lambda _, given: self._transforms.put(given))
        if TF in names:
            tags = [given for given in self._plan.bearings if given.frames]
            self._subscribe(
                TF,
                lambda _, given: (
                    None
                    if any(landmark_of(given, topic) for topic in tags)
                    else self._transforms.follow(given)
                ),
            )

    def _subscribe_sightings(self, given: BearingsTopic) -> dict[str, SightingRows]:
        """Return the sightings of a topic by frame, which are filled while the log is read."""
        rows: dict[str, SightingRows] = {}
        new = self._rows_of(given)

        def add(t: float, message: Any) -> None:
            if given.frames and not landmark_of(message, given):
                return
            frame = frame_of(message)
            if frame not in rows:
                rows[frame] = new(frame)
            rows[frame].add(t, message)

        self._subscribe(given.topic, add)
        return rows

    def _rows_of(self, given: BearingsTopic) -> Callable[[str], SightingRows]:
        """Return a function that returns empty rows of a topic for a frame."""
        kind = self._known.topic(given.topic).type
        detector = self._detector if kind in PICTURES else None
        camera = self._camera_of(given)
        return lambda frame: SightingRows(given, kind, self._remarks, camera, detector, frame)

    def _camera_of(self, given: BearingsTopic) -> Callable[[], Lens | None]:
        """Return a function that returns the camera of a topic after the log was read."""
        if not isinstance(given.camera, str):
            known = given.camera
            return lambda: known
        topic, infos = given.camera, list[Any]()
        self._subscribe(topic, lambda _, info: None if infos else infos.append(info))

        def model() -> Lens | None:
            try:
                return from_camera_info(infos[0], given.rectified) if infos else None
            except (ValueError, IndexError, AttributeError):
                problem = "the camera is not calibrated, or its model is unknown"
                raise InputError(problem, part=topic) from None

        return model

    def _read(self, on_progress: OnProgress | None) -> None:
        log, clock = self._known.log, self._clock
        layouts = {given.topic: given.layout for given in self._plan.bearings}
        for number, message in enumerate(log.messages(topics=self._handlers)):
            topic = message.channel.topic
            if topic in self._handlers:
                decoded = self._decoder.decode(message.channel, message.data)
                try:
                    for part in parts_of(message.channel.type, decoded, layouts.get(topic)):
                        t = clock.time(message, part)
                        for handle in self._handlers[topic]:
                            handle(t, part)
                except InputError as error:
                    error.at(part=topic)
                    raise
                except (AttributeError, TypeError, ValueError, IndexError) as error:
                    # The definition in the log lacks a field, or has another type of it.
                    kind = quoted(message.channel.type)
                    problem = f"the fields of its {kind} differ from the known type"
                    raise InputError(problem, part=topic) from error
            if on_progress is not None and number % 500 == 0:
                on_progress((1 + log.done) / 2)

    def _sightings(self) -> Sightings:
        parts = [camera.columns() for camera in self._cameras]
        if not parts:
            return Sightings.of_rows(())
        for part in parts:
            in_order(part["t"], "sightings", self._remarks)  # counted for each camera
        self._separate(parts)
        columns = {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}
        order = np.argsort(columns["t"], kind="stable")
        rows = Table(self._path, order + 1, {n: c[order] for n, c in columns.items()})
        return sightings_of(rows, self._remarks)

    def _separate(self, parts: list[dict[str, np.ndarray]]) -> None:
        """Make the frames of cameras with the same landmark at the same stamp differ by 1 ns.

        So both are sightings; at equal stamps the last would replace the others.
        """
        known: set[tuple[float, str]] = set()
        for part in parts:
            pairs = list(zip(part["t"].tolist(), part["landmark"].tolist(), strict=True))
            while shared := {t for t, landmark in pairs if (t, landmark) in known}:
                self._remarks.count(BOTH_CAMERAS, sum(pair in known for pair in pairs))
                part["t"] = part["t"] + 1 / NANO * np.isin(part["t"], list(shared))
                pairs = list(zip(part["t"].tolist(), part["landmark"].tolist(), strict=True))
            known.update(pairs)

    def _home(self, seen: Sightings) -> dict[str, HomeBearing]:
        given = self._plan.home
        if given is None or (given.csv is None and given.topic is None):
            return {}
        if given.csv is not None:
            source = self._path if self._topics is None else self._topics
            return read_home(source.parent / given.csv, self._remarks, seen)
        assert self._at_home is not None
        columns = self._at_home.columns()
        first = columns["t"] == columns["t"][:1]
        rows = np.flatnonzero(first) + 1
        table = Table(self._path, rows, {n: c[first] for n, c in columns.items()})
        return home_of(table, self._remarks, seen)

    def _tilt(self) -> Tilt | None:
        if (topic := self._plan.tilt) is None:
            return None
        found = np.reshape(self._tilts, (-1, 3))
        rows = clean_rows(found, topic, "orientations", SAMPLES[Tilt][1], self._remarks)
        return Tilt(*rows.T.copy())

    def _truth(self) -> Truth | None:
        given = self._plan.truth
        if given is None or not self._poses:
            return None
        rows = clean_rows(self._poses, given.topic, "true poses", SAMPLES[Truth][1], self._remarks)
        truth = Truth(*rows.T.copy())
        return truth if given.home is None else truth.seen_from(Pose(*given.home))
