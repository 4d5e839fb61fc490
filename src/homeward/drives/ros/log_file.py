"""A log that is being written: through rosbags, whole or not at all."""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin

from homeward.drives.ros.messages.definitions import typestore
from homeward.drives.ros.messages.stamps import NANO
from homeward.drives.text.files import is_there, naming
from homeward.errors import InputError

_STORAGE = {".mcap": StoragePlugin.MCAP, ".db3": StoragePlugin.SQLITE3}


class LogFile:
    """Takes messages in order of time; made by `writing`."""

    def __init__(self, writer: Any, ros1: bool) -> None:
        self._writer, self._ros1 = writer, ros1
        self._store = typestore(ros1)
        self._connections: dict[str, Any] = {}

    def make(self, kind: str, **fields: Any) -> Any:
        """Return a message of a type, as in ``nav_msgs/msg/Odometry``."""
        return self._store.types[kind](**fields)

    def time(self, stamp: int) -> Any:
        """Return a stamp [ns] as builtin_interfaces/Time."""
        whole, rest = divmod(stamp, NANO)
        return self.make("builtin_interfaces/msg/Time", sec=whole, nanosec=rest)

    def header(self, stamp: int, frame: str) -> Any:
        """Return a std_msgs/Header."""
        numbered = {"seq": 0} if self._ros1 else {}
        fields = {**numbered, "stamp": self.time(stamp), "frame_id": frame}
        return self.make("std_msgs/msg/Header", **fields)

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
def _naming_sqlite(path: Path) -> Iterator[None]:
    """Make an InputError of what sqlite says, which is no OSError when the disk is full."""
    try:
        yield
    except sqlite3.Error as error:
        raise InputError(f"cannot be written: {error}", path) from error


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
    with naming(path, "cannot be written"), _naming_sqlite(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        # Beside it, so that moving it into place is no copy.
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}-") as scratch:
            made = Path(scratch) / "log"
            if path.suffix == ".bag":
                with rosbag1.Writer(made) as old:
                    yield LogFile(old, ros1=True)
            else:
                storage = _STORAGE[path.suffix]
                writer = rosbag2.Writer(made, version=9, storage_plugin=storage)
                if storage is StoragePlugin.MCAP:
                    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
                with writer as new:
                    yield LogFile(new, ros1=False)
                (made,) = made.glob(f"*{path.suffix}")
            made.rename(path)
