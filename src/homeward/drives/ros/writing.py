"""Writing of a drive as a log, which `read_log` reads back exactly, and the known message types."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from homeward.drives.drive import Drive
from homeward.drives.robot import require_one_camera
from homeward.drives.ros.kinds import (
    BEARINGS,
    ODOMETRY,
    OUR_BEARINGS,
    OUR_HOME,
    OUR_ODOMETRY,
    OUR_SETTINGS,
    OUR_TRUTH,
    POSE,
)
from homeward.drives.ros.stamps import NANO, split
from homeward.errors import InputError
from homeward.io.reading import is_there, naming
from homeward.io.settings import settings_yaml
from homeward.io.table import is_identifier, quoted
from homeward.io.writing import whole_file

WELL_KNOWN = {
    f"{file.parent.name}/msg/{file.stem}": file.read_text("utf-8")
    for file in sorted(Path(__file__).with_name("msg").glob("*/*.msg"))
}
"""Definitions by type; sqlite3 files of ROS 2 before Iron contain none."""
DEFINITIONS = {kind: text for kind, text in WELL_KNOWN.items() if kind.startswith("homeward_msgs/")}
"""Those of `homeward_msgs`, which represent a drive exactly.

`residue` is the part of a time [s] that a stamp in whole nanoseconds cannot represent.
"""


@cache
def typestore(ros1: bool) -> Any:
    """Return rosbags' store of all known types, as in ROS 1 Noetic or ROS 2 Humble."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name, text in WELL_KNOWN.items():
        store.register(get_types_from_msg(text, name))
    return store


_STORAGE = {".mcap": StoragePlugin.MCAP, ".db3": StoragePlugin.SQLITE3}


class LogFile:
    """Writer of messages in order of time; made by `writing`."""

    def __init__(self, writer: Any, ros1: bool) -> None:
        self._writer, self._ros1 = writer, ros1
        self._store = copy(typestore(ros1))
        for name in ("types", "fielddefs", "cache"):  # types of this log are not known to others
            setattr(self._store, name, getattr(self._store, name).copy())
        self._connections: dict[str, Any] = {}

    def make(self, kind: str, **fields: Any) -> Any:
        """Return a message of a type, as in ``nav_msgs/msg/Odometry``.

        Missing fields are zero or empty; a message within it may be a dict of its fields.
        """
        known = dict(self._store.fielddefs[kind][1])
        if unknown := fields.keys() - known:
            raise TypeError(f"{kind} has no {', '.join(sorted(unknown))}")
        values = {name: self._value(form, fields.get(name)) for name, form in known.items()}
        return self._store.types[kind](**values)

    def header(self, stamp: int, frame: str) -> Any:
        """Return a std_msgs/Header with a stamp [ns]."""
        time = dict(zip(("sec", "nanosec"), divmod(stamp, NANO), strict=True))
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame)

    def _value(self, form: tuple[Nodetype, Any], given: Any) -> Any:
        """Return the value of a field: `given`, or zeros where that is None."""
        kind, of = form
        if kind is Nodetype.NAME:
            return self.make(of, **(given or {})) if given is None or type(given) is dict else given
        if kind is Nodetype.BASE:
            return ("" if of[0] == "string" else 0) if given is None else given
        inner, size = of
        if inner[0] is Nodetype.BASE and inner[1][0] != "string":
            return np.zeros(size, inner[1][0]) if given is None else given
        return [self._value(inner, each) for each in given or [None] * size]

    def encoded(self, message: Any) -> bytes | memoryview:
        """Return a message as it is written."""
        encode = self._store.serialize_ros1 if self._ros1 else self._store.serialize_cdr
        data: memoryview = encode(message, message.__msgtype__)
        return data

    def write(self, topic: str, stamp: int, message: Any) -> None:
        """Write a message with its stamp as receive time [ns]."""
        self.write_encoded(topic, message.__msgtype__, stamp, self.encoded(message))

    def write_encoded(self, topic: str, kind: str, stamp: int, data: bytes | memoryview) -> None:
        """Write a message of a type as `encoded` returns it."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self._store
            )
        self._writer.write(self._connections[topic], stamp, data)


@contextmanager
def writing(path: Path) -> Iterator[LogFile]:
    """Yield a log that becomes the file `path` when the block ends without an error.

    Its suffix is .bag, .mcap or .db3. Missing parent folders are made. `InputError` where the file
    exists or cannot be written.
    """
    if is_there(path):
        raise InputError("exists already", path, advice="choose another name")
    with naming(path, "cannot be written"):
        try:
            with whole_file(path) as made:
                log = made.with_name("log")
                if path.suffix == ".bag":
                    with rosbag1.Writer(log) as old:
                        yield LogFile(old, ros1=True)
                else:
                    storage = _STORAGE[path.suffix]
                    writer = rosbag2.Writer(log, version=9, storage_plugin=storage)
                    if storage is StoragePlugin.MCAP:
                        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
                    with writer as new:
                        yield LogFile(new, ros1=False)
                    (log,) = log.glob(f"*{path.suffix}")
                log.rename(made)
        except sqlite3.Error as error:  # raised instead of OSError when the disk is full
            raise InputError(f"cannot be written: {error}", path) from error


BASE, CAMERA, HOME = "base_link", "camera", "home"
"""Frames: the robot's centre, its camera with x along the axis, and the home frame."""


def write_log(drive: Drive, path: Path, on_progress: Callable[[float], None] | None = None) -> None:
    """Write a drive as a ROS 1 bag, an MCAP file or a sqlite3 bag file: .bag, .mcap or .db3.

    Name and remarks are not written. `InputError` where the file cannot be written, or the drive
    has a number that is not finite, or an invalid id.
    """
    if not drive.odometry.t.size:
        raise InputError("the drive has no odometry", path)
    _require_writable(drive, path)
    with writing(path) as log:
        # A stable sort by stamp.
        rows = sorted(_messages(log, drive), key=lambda row: row[0])
        for number, (stamp, topic, message) in enumerate(rows):
            log.write(topic, stamp, message)
            if on_progress is not None and number % 500 == 0:
                on_progress(number / len(rows))


def _require_writable(drive: Drive, path: Path) -> None:
    require_one_camera(drive, "logs hold the bearings of one camera; write a drive folder", path)
    odometry = drive.odometry
    if odometry.moves_sideways:
        raise InputError("logs hold no sideways speed", path, advice="write a drive folder")
    unknown = np.isnan(odometry.v) & np.isnan(odometry.omega)
    arrays = [odometry.t, odometry.v[~unknown], odometry.omega[~unknown]]
    arrays += [drive.sightings.t, drive.sightings.bearing]
    arrays.append(np.array([seen.bearing for seen in drive.home.values()], float))
    if drive.truth is not None:
        arrays += vars(drive.truth).values()
    if not all(np.isfinite(array).all() for array in arrays):
        raise InputError("the drive contains a number that is not finite", path)
    for landmark in {*map(str, drive.sightings.landmark), *drive.home}:
        if not is_identifier(landmark):
            problem = f"landmark {quoted(landmark)} is not a valid id (printable, no outer spaces)"
            raise InputError(problem, path)


def _messages(log: LogFile, drive: Drive) -> Iterator[tuple[int, str, Any]]:
    """Yield stamp [ns], topic and message of each sample of a drive."""
    epoch, begin = drive.settings.epoch or 0, drive.span[0]

    def message(topic: str, kind: str, t: float, frame: str, **fields: Any) -> tuple[int, str, Any]:
        stamp, residue = split(t, epoch)
        header = log.header(stamp, frame)
        return stamp, topic, log.make(kind, header=header, residue=residue, **fields)

    def bearings(
        topic: str, t: float, ids: list[str], bearing: list[float], sigma: list[float]
    ) -> tuple[int, str, Any]:
        known = [] if all(map(math.isnan, sigma)) else sigma
        numbers = {"bearings": np.array(bearing, float), "sigmas": np.array(known, float)}
        return message(topic, BEARINGS, t, CAMERA, landmarks=ids, **numbers)

    text = settings_yaml(drive.settings)
    yield split(begin, epoch)[0], OUR_SETTINGS, log.make("std_msgs/msg/String", data=text)
    if drive.home:
        home = list(drive.home.values())
        at_home = [seen.bearing for seen in home], [seen.sigma for seen in home]
        yield bearings(OUR_HOME, begin, list(drive.home), *at_home)
    odometry, sightings = drive.odometry, drive.sightings
    twists = odometry.t.tolist(), odometry.v.tolist(), odometry.omega.tolist()
    for t, v, omega in zip(*twists, strict=True):
        yield message(OUR_ODOMETRY, ODOMETRY, t, BASE, v=v, omega=omega)
    edges = np.flatnonzero(np.diff(sightings.t, prepend=np.nan, append=np.nan) != 0)
    for a, b in pairwise(edges.tolist()):
        ids = [str(i) for i in sightings.landmark[a:b]]
        seen = sightings.bearing[a:b].tolist(), sightings.sigma[a:b].tolist()
        yield bearings(OUR_BEARINGS, float(sightings.t[a]), ids, *seen)
    if drive.truth is not None:
        poses = (values.tolist() for values in vars(drive.truth).values())
        for t, x, y, heading in zip(*poses, strict=True):
            yield message(OUR_TRUTH, POSE, t, HOME, x=x, y=y, heading=heading)
