"""The sqlite3 files of ROS 2 bags (rosbag2_storage_sqlite3), read only."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from homeward.drives.ros.container import (
    LARGEST_BLOCK,
    Channel,
    Message,
    in_short,
    ros2_type,
    walking,
)
from homeward.errors import InputError

MAGIC = b"SQLite format 3\x00"
_SYNTAX = {"ros2msg": "msg", "ros2idl": "idl"}


class Sqlite:
    """A sqlite3 file of a ROS 2 bag."""

    kind = "ROS 2 bag (sqlite3)"

    def __init__(self, path: Path) -> None:
        self.path = path
        self.done = 0.0

    def messages(self) -> Iterator[Message]:
        """Walk the messages; see `Log`."""
        with walking(self.path):
            self._check_length()
            try:
                yield from self._messages()
            except sqlite3.Error as error:
                reason = f"not a bag that sqlite can read: {in_short(error)}"
                raise InputError(reason, self.path) from error

    def _check_length(self) -> None:
        """Refuse a file that is shorter than its header says; sqlite may not notice."""
        with self.path.open("rb") as stream:
            head = stream.read(100)
        page, changes, pages = struct.unpack_from(">H6xII", head, 16)
        (valid_for,) = struct.unpack_from(">I", head, 92)
        # The count of pages holds only when the last writer was one that keeps it.
        if (
            changes == valid_for
            and pages * (65536 if page == 1 else page) > self.path.stat().st_size
        ):
            raise InputError("truncated: the file is shorter than its header says", self.path)

    def _messages(self) -> Iterator[Message]:
        # Immutable: nothing is written beside it, not even a lock.
        address = f"file:{quote(str(self.path.resolve()))}?mode=ro&immutable=1"
        database = sqlite3.connect(address, uri=True)
        try:
            # A column that is computed could ask for a gigabyte a row.
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_BLOCK)
            channels = self._channels(database)
            last = max(self._last(database), 1)
            rows = database.execute("SELECT id, topic_id, timestamp, data FROM messages")
            for number, topic, receive, data in rows:
                if not (isinstance(receive, int) and isinstance(data, bytes)):
                    raise ValueError(f"message {number} holds {type(data).__name__}, not bytes")
                self.done = number / last
                yield Message(channels[topic], receive, data)
        finally:
            database.close()

    def _channels(self, database: sqlite3.Connection) -> dict[int, Channel]:
        """Return the topics by number; older bags hold no message definitions."""
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master")}
        definitions = {}
        if missing := {"topics", "messages"} - tables:
            raise InputError(f"not a bag: a database without {' and '.join(missing)}", self.path)
        if "message_definitions" in tables:
            rows = database.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            definitions = {name: (text, _SYNTAX[how]) for name, how, text in rows if how in _SYNTAX}
        topics = database.execute("SELECT id, name, type, serialization_format FROM topics")
        return {
            number: Channel(name, ros2_type(kind), encoding, *definitions.get(kind, ("", "msg")))
            for number, name, kind, encoding in topics
        }

    def _last(self, database: sqlite3.Connection) -> int:
        (last,) = database.execute("SELECT max(id) FROM messages").fetchone()
        return last if isinstance(last, int) else 0
