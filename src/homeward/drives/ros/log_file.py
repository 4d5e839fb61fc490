"""A log that is being written: through rosbags, whole or not at all."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin

from homeward.drives.ros.messages.definitions import typestore
from homeward.drives.ros.messages.stamps import NANO
from homeward.errors import InputError
from homeward.io.reading import is_there, naming
from homeward.io.writing import whole_file

_STORAGE = {".mcap": StoragePlugin.MCAP, ".db3": StoragePlugin.SQLITE3}


class LogFile:
    """Takes messages in order of time; made by `writing`."""

    def __init__(self, writer: Any, ros1: bool) -> None:
        self._writer, self._ros1 = writer, ros1
        self._store = typestore(ros1)
        self._connections: dict[str, Any] = {}

    def make(self, kind: str, **fields: Any) -> Any:
        """Return a message of a type, as in ``nav_msgs/msg/Odometry``.

        What is not given is zero or empty; a message in it may be given as a dict of its fields.
        """
        known = dict(self._store.fielddefs[kind][1])
        if strange := fields.keys() - known:
            raise TypeError(f"{kind} has no {', '.join(sorted(strange))}")
        values = {name: self._value(form, fields.get(name)) for name, form in known.items()}
        return self._store.types[kind](**values)

    def header(self, stamp: int, frame: str) -> Any:
        """Return a std_msgs/Header of a stamp [ns]."""
        time = dict(zip(("sec", "nanosec"), divmod(stamp, NANO), strict=True))
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame)

    def _value(self, form: tuple[Nodetype, Any], given: Any) -> Any:
        """Return what a field of a form holds: what is `given`, or zeros where that is None."""
        kind, of = form
        if kind is Nodetype.NAME:
            return self.make(of, **(given or {})) if given is None or type(given) is dict else given
        if kind is Nodetype.BASE:
            return ("" if of[0] == "string" else 0) if given is None else given
        inner, size = of
        if inner[0] is Nodetype.BASE and inner[1][0] != "string":
            return np.zeros(size, inner[1][0]) if given is None else given
        return [self._value(inner, each) for each in given or [None] * size]

    def write(self, topic: str, stamp: int, message: Any) -> None:
        """Write a message, as if it had been received at its stamp [ns]."""
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self._store
            )
        serialize = self._store.serialize_ros1 if self._ros1 else self._store.serialize_cdr
        self._writer.write(self._connections[topic], stamp, serialize(message, kind))


@contextmanager
def writing(path: Path) -> Iterator[LogFile]:
    """Lend a log that becomes the file `path` when the block ends without an error.

    Its suffix is .bag, .mcap or .db3. Missing parents are made.

    Raises
    ------
    InputError
        When it exists or cannot be written.
    """
    if is_there(path):
        raise InputError("exists already; choose another name", path)
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
        except sqlite3.Error as error:  # no OSError where the disk is full
            raise InputError(f"cannot be written: {error}", path) from error
