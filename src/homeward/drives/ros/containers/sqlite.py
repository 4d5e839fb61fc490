"""The sqlite3 files of ROS 2 bags (rosbag2_storage_sqlite3), read only."""

from __future__ import annotations

import os
import sqlite3
import struct
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

from homeward.drives.ros.containers.container import (
    LARGEST_BLOCK,
    Budget,
    Channel,
    DamagedLog,
    Message,
    in_short,
    ros2_type,
    walking,
)
from homeward.drives.text.files import opened
from homeward.errors import InputError

_SYNTAX = {"ros2msg": "msg", "ros2idl": "idl"}
_READ = {"topics", "messages", "message_definitions"}
STEPS_A_LOOK = 100_000
"""Steps of sqlite's machine between two looks at how many there were."""
LEAST_STEPS, STEPS_PER_BYTE = 50_000_000, 10
"""Of a file: a row takes about ten steps, and a message some fifty bytes."""


class Sqlite:
    """A sqlite3 file of a ROS 2 bag."""

    kind = "ROS 2 bag (sqlite3)"
    repair = '`sqlite3 FILE ".recover" | sqlite3 NEW.db3` saves what is sound'

    def __init__(self, path: Path) -> None:
        self.path = path
        self.done = 0.0

    def messages(self) -> Iterator[Message]:
        """Walk the messages; see `Log`."""
        with walking(self.path, self.repair):
            self._check_length()
            try:
                yield from self._messages()
            except sqlite3.Error as error:
                reason = f"not a bag that sqlite can read: {in_short(error)}"
                kind: type[InputError] = DamagedLog
                if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_INTERRUPT:
                    reason, kind = "takes more steps to read than a bag of its size can", InputError
                raise kind(reason, self.path) from error

    def _check_length(self) -> None:
        """Refuse a file that is shorter than its header says; sqlite may not notice."""
        with opened(self.path) as stream:
            head = stream.read(100)
        page, changes, pages = struct.unpack_from(">H6xII", head, 16)
        (valid_for,) = struct.unpack_from(">I", head, 92)
        # The count of pages holds only when the last writer was one that keeps it.
        if (
            changes == valid_for
            and pages * (65536 if page == 1 else page) > self.path.stat().st_size
        ):
            raise DamagedLog("truncated: the file is shorter than its header says", self.path)

    def _messages(self) -> Iterator[Message]:
        # Immutable: nothing is written beside it, not even a lock.
        address = f"file:{quote(os.path.realpath(self.path))}?mode=ro&immutable=1"
        budget = Budget(self.path)
        # Pages that point at each other make a few kilobytes into rows without end.
        most = LEAST_STEPS + STEPS_PER_BYTE * self.path.stat().st_size
        looks = iter(range(most // STEPS_A_LOOK))
        with closing(sqlite3.connect(address, uri=True)) as database:
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_BLOCK)
            database.execute("PRAGMA trusted_schema = OFF")
            database.set_progress_handler(lambda: next(looks, None) is None, STEPS_A_LOOK)
            self._require_plain(database)
            database.set_authorizer(_only_reading)
            channels = self._channels(database)
            last = max(self._last(database), 1)
            rows = database.execute("SELECT id, topic_id, timestamp, data FROM messages")
            for number, topic, receive, data in rows:
                if not isinstance(number, int):
                    raise ValueError(f"a message has {number!r} for its number")
                if not isinstance(receive, int):
                    raise ValueError(f"message {number} came at {receive!r}, which is no time")
                if not isinstance(data, bytes):
                    raise ValueError(f"message {number} holds {type(data).__name__}, not bytes")
                budget.record()
                budget.unpacked(len(data))
                self.done = number / last
                yield Message(channels[topic], receive, data)

    def _require_plain(self, database: sqlite3.Connection) -> None:
        """Refuse what is read from other than a plain table: it could compute for ever."""
        tables = "SELECT name FROM sqlite_master WHERE type = 'table' AND sql NOT LIKE ?"
        self._tables = {name for (name,) in database.execute(tables, ("create virtual%",))} & _READ
        if missing := sorted({"topics", "messages"} - self._tables):
            what = " and ".join(missing)
            raise InputError(f"not a bag: a database without a table {what}", self.path)
        for name in sorted(self._tables):
            columns = database.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,))
            if any(hidden for (hidden,) in columns):
                raise InputError(f"not a bag: its table {name} has computed columns", self.path)

    def _channels(self, database: sqlite3.Connection) -> dict[int, Channel]:
        """Return the topics by number; older bags hold no message definitions."""
        definitions = {}
        if "message_definitions" in self._tables:
            rows = database.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            told = (_texts(row) for row in rows)
            definitions = {name: (text, _SYNTAX[how]) for name, how, text in told if how in _SYNTAX}
        rows = database.execute("SELECT id, name, type, serialization_format FROM topics")
        topics = ((number, *_texts(texts)) for number, *texts in rows)
        return {
            number: Channel(name, ros2_type(kind), encoding, *definitions.get(kind, ("", "msg")))
            for number, name, kind, encoding in topics
        }

    def _last(self, database: sqlite3.Connection) -> int:
        (last,) = database.execute("SELECT max(id) FROM messages").fetchone()
        return last if isinstance(last, int) else 0


def _texts(cells: Sequence[object]) -> list[str]:
    """Return cells that must hold text."""
    for cell in cells:
        if not isinstance(cell, str):
            raise ValueError(f"a topic or type that is {type(cell).__name__}, not text")
    return [str(cell) for cell in cells]


def _only_reading(action: int, what: str | None, column: str | None, *_: Any) -> int:
    """Let sqlite read the tables of a bag, whatever the file would have it do besides."""
    allowed = (
        action == sqlite3.SQLITE_SELECT
        or (action == sqlite3.SQLITE_READ and what in _READ)
        or (action == sqlite3.SQLITE_FUNCTION and column == "max")
    )
    return sqlite3.SQLITE_OK if allowed else sqlite3.SQLITE_DENY
