"""A drive out of a log: a second walk, in which the chosen topics are decoded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from pydantic import ValidationError

from homeward.drives.drive import Drive, DriveSettings, HomeBearing, Odometry, Sightings, Truth
from homeward.drives.folder import (
    REPEATED_ODOMETRY,
    REPEATED_TRUTH,
    count_repeats,
    read_home,
    without_repeats,
    wrapped,
)
from homeward.drives.ros.bag_folder import open_log
from homeward.drives.ros.bearings import SightingRows
from homeward.drives.ros.camera import Intrinsics, from_camera_info
from homeward.drives.ros.choosing import OUR_SETTINGS, choose
from homeward.drives.ros.decoding import Decoder
from homeward.drives.ros.home import home_during
from homeward.drives.ros.odometry import (
    JOINT_STATE,
    SIDEWAYS,
    SIDEWAYS_SHARE,
    Wheels,
    choose_twists,
    pose_of,
    twist_of,
    twists_from_poses,
)
from homeward.drives.ros.settings import BearingsTopic, LogSettings
from homeward.drives.ros.survey import Survey, Tell, survey
from homeward.drives.ros.times import Clock
from homeward.drives.settings import parse_settings, read_settings
from homeward.drives.table import Table, quoted
from homeward.errors import InputError
from homeward.frames import Pose, between

NOT_FINITE = "{} with a number that is not finite, left out"
LATE = "{} that came late, put in order by their stamps"


def read_log(path: Path, topics: Path | None = None, tell: Tell | None = None) -> Drive:
    """Read a drive from a ROS 1 bag, a ROS 2 bag or an MCAP file.

    Parameters
    ----------
    path : Path
        A file, or the folder of a ROS 2 bag.
    topics : Path, optional
        A YAML file of `LogSettings`; what it does not say is guessed.
    tell : callable, optional
        Told the fraction done, in [0, 1].

    Returns
    -------
    Drive
        Times are header stamps unless asked otherwise, counted from `DriveSettings.epoch` where
        they are Unix time. Its remarks count what was left out.

    Raises
    ------
    InputError
        When the log is damaged, or the topics in it do not make a drive.
    """
    told = LogSettings() if topics is None else read_settings(topics, LogSettings)
    log = open_log(path)
    first_half = None if tell is None else lambda done: tell(done / 2)
    known = survey(log, keep=(OUR_SETTINGS,), tell=first_half)
    plan = choose(known, told)
    try:
        return _Reading(known, plan, topics).drive(tell)
    except InputError as error:
        _named(error, path)


def _named(error: InputError, path: Path) -> NoReturn:
    """Raise an error that names the log, unless it names a file already."""
    raise error if error.file is not None else InputError(error.what, path) from error


class _Reading:
    """The second walk."""

    def __init__(self, known: Survey, plan: LogSettings, topics: Path | None) -> None:
        self._known, self._plan, self._topics = known, plan, topics
        self._path, self._decoder = known.log.path, Decoder()
        self._remarks: dict[str, int] = {}
        if plan.odometry is None:
            raise InputError("no topic with odometry in it; homeward info lists what there is")
        self._settings, epoch = self._drive_settings()
        self._clock = Clock(known, plan, epoch)
        self._takers: dict[str, list[Callable[[float, Any], None]]] = {}

    def drive(self, tell: Tell | None) -> Drive:
        """Walk, and put together what was met."""
        plan = self._plan
        poses: list[tuple[float, ...]] = []
        odometry = self._take_odometry()
        sightings = [self._take_sightings(topic) for topic in plan.bearings]
        cameras = [self._take_camera(topic) for topic in plan.bearings]
        home = None
        if plan.home is not None and plan.home.topic is not None:
            home = self._take_sightings(BearingsTopic(topic=plan.home.topic))
        if plan.truth is not None:
            self._take(plan.truth.topic, lambda t, m: poses.append((t, *map(float, pose_of(m)))))
        self._walk(tell)
        twists = odometry()
        seen = self._sightings([r.columns(c()) for r, c in zip(sightings, cameras, strict=True)])
        for rows in (*sightings, *([home] if home is not None else [])):
            for reason, count in rows.remarks.items():
                self._remarks[reason] = self._remarks.get(reason, 0) + count
        return Drive(
            name=self._path.resolve().stem,
            odometry=twists,
            sightings=seen,
            home=self._home(home, twists, seen),
            settings=self._clock.in_settings(self._settings),
            truth=self._truth(poses),
            remarks=self._remarks,
        )

    def _walk(self, tell: Tell | None) -> None:
        log, clock = self._known.log, self._clock
        for number, message in enumerate(log.messages()):
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
            if tell is not None and number % 500 == 0:
                tell((1 + log.done) / 2)

    def _take(self, topic: str, taker: Callable[[float, Any], None]) -> None:
        self._takers.setdefault(topic, []).append(taker)

    def _drive_settings(self) -> tuple[DriveSettings, int | None]:
        """Return the drive's settings, the user's before the log's own, and the log's epoch [s]."""
        told = self._plan.drive
        kept = self._known.kept.get(OUR_SETTINGS)
        if kept is None:
            return told or DriveSettings(), None
        text = self._decoder.decode(kept.channel, kept.data)
        if not isinstance(getattr(text, "data", None), str):
            raise InputError(f"{OUR_SETTINGS} is a {kept.channel.type}, not text")
        place = Path(f"{self._path}, {OUR_SETTINGS}")
        own = parse_settings(text.data, DriveSettings, place)
        return told or own, own.epoch or 0

    def _take_odometry(self) -> Callable[[], Odometry]:
        """Have the odometry collected; return what makes it of that."""
        told = self._plan.odometry
        assert told is not None
        kind = self._known.topic(told.topic).type
        rows: list[tuple[float, ...]] = []
        wheels = Wheels(told) if kind == JOINT_STATE else None

        def take(t: float, message: Any) -> None:
            if wheels is not None:
                if (row := wheels.row(message)) is not None:
                    rows.append((t, *map(float, row)))
                return
            nothing = (np.nan,) * 3
            twist = twist_of(message) if hasattr(message, "twist") or _bare(message) else nothing
            pose = pose_of(message) if hasattr(message, "pose") else nothing
            rows.append((t, *map(float, (*twist, *pose))))

        def make() -> Odometry:
            table = np.array(rows, float).reshape(len(rows), -1)
            if not len(rows):
                raise InputError(f"{told.topic}: no message tells odometry")
            if wheels is not None:
                clean = self._clean(table, "odometry messages", told.topic, REPEATED_ODOMETRY)
                return Odometry(clean[:, 0], *wheels.twists(clean[:, 0], clean[:, 1:]))
            if choose_twists(told, kind, table[:, 1:]):
                self._remark_sideways(table)
                clean = self._clean(
                    table[:, :3], "odometry messages", told.topic, REPEATED_ODOMETRY
                )
                return Odometry(*clean.T.copy())
            poses = table[:, [0, 4, 5, 6]]
            clean = self._clean(poses, "odometry messages", told.topic, REPEATED_ODOMETRY)
            return Odometry(clean[:, 0], *twists_from_poses(clean[:, 0], clean[:, 1:]))

        self._take(told.topic, take)
        return make

    def _remark_sideways(self, table: np.ndarray) -> None:
        with np.errstate(invalid="ignore"):
            sideways = np.abs(table[:, 3]) > SIDEWAYS_SHARE * np.abs(table[:, 1]) + 1e-3
        if sideways.any():
            self._remarks[SIDEWAYS] = int(sideways.sum())

    def _take_sightings(self, told: BearingsTopic) -> SightingRows:
        rows = SightingRows(told, self._known.topic(told.topic).type)
        self._take(told.topic, rows.add)
        return rows

    def _take_camera(self, told: BearingsTopic) -> Callable[[], Intrinsics | None]:
        """Have the first CameraInfo kept; return what tells it."""
        if not isinstance(told.camera, str):
            model = told.camera
            return lambda: model
        name = told.camera
        met: list[Any] = []
        self._take(name, lambda _, message: met.append(message) if not met else None)

        def tell() -> Intrinsics | None:
            try:
                return from_camera_info(met[0], told.rectified) if met else None
            except (ValidationError, IndexError, AttributeError):
                reason = f"{name}: not the model of a calibrated camera that is known here"
                raise InputError(reason) from None

        return tell

    def _sightings(self, parts: list[dict[str, np.ndarray]]) -> Sightings:
        if not parts:
            nothing = np.empty(0)
            return Sightings(nothing, np.empty(0, object), nothing, nothing)
        columns = {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}
        order = self._order(columns["t"], "sightings")
        rows = Table(self._path, order + 1, {n: c[order] for n, c in columns.items()})
        _require_sigma(rows)
        sightings = Sightings(
            rows["t"], rows["landmark"], wrapped(rows, "bearing", self._remarks), rows["sigma"]
        )
        count_repeats(sightings, self._remarks)
        return sightings

    def _home(
        self, rows: SightingRows | None, odometry: Odometry, seen: Sightings
    ) -> dict[str, HomeBearing]:
        told = self._plan.home
        if told is None:
            return {}
        if told.csv is not None:
            beside = self._topics.parent if self._topics is not None else self._path.parent
            return read_home(beside / told.csv, self._remarks)
        if told.during is not None:
            return home_during(told.during, odometry, seen)
        assert rows is not None
        columns = rows.columns(None)
        first = columns["t"] == columns["t"][:1]
        table = Table(
            self._path, np.flatnonzero(first) + 1, {n: c[first] for n, c in columns.items()}
        )
        table.require_unique("landmark")
        _require_sigma(table)
        pairs = zip(
            wrapped(table, "bearing", self._remarks).tolist(), table["sigma"].tolist(), strict=True
        )
        homes = (HomeBearing(*pair) for pair in pairs)
        return dict(zip(table["landmark"].tolist(), homes, strict=True))

    def _truth(self, poses: list[tuple[float, ...]]) -> Truth | None:
        told = self._plan.truth
        if told is None or not poses:
            return None
        clean = self._clean(np.array(poses, float), "true poses", told.topic, REPEATED_TRUTH)
        t, x, y, heading = clean.T.copy()
        if told.home is None:
            return Truth(t, x, y, heading)
        return Truth(t, *between(Pose(*told.home), Pose(x, y, heading)))

    def _clean(self, table: np.ndarray, what: str, topic: str, repeats: str) -> np.ndarray:
        """Return the rows of a topic in order of time, finite, one a stamp; count the others."""
        finite = np.isfinite(table).all(axis=1)
        if not finite.all():
            self._remarks[NOT_FINITE.format(what)] = int((~finite).sum())
        rows = table[finite]
        if not len(rows):
            raise InputError(f"{topic}: no message has finite numbers")
        rows = rows[self._order(rows[:, 0], what)]
        columns = {"t": rows[:, 0], "row": np.arange(len(rows))}
        kept = without_repeats(Table(self._path, columns["row"], columns), self._remarks, repeats)
        return np.asarray(rows[kept["row"]])

    def _order(self, t: np.ndarray, what: str) -> np.ndarray:
        """Return the order of times [s]; equal ones stay as they came."""
        if t.size and (late := int((t < np.maximum.accumulate(t)).sum())):
            self._remarks[LATE.format(what)] = late
        return np.argsort(t, kind="stable")


def _bare(message: Any) -> bool:
    """Whether a message is itself a twist, or ours."""
    return hasattr(message, "linear") or hasattr(message, "omega")


def _require_sigma(table: Table) -> None:
    sigma = table["sigma"]
    table.require("sigma", np.isnan(sigma) | ((sigma > 0) & np.isfinite(sigma)), "not above 0")
