"""Read a log through rosbags and write its messages to standard output; see `log.Log`.

`log` runs this file as a separate process. rosbags allocates memory according to length fields and
unpacks chunks of any size, so the limits apply to the whole process, and a hostile log ends only
that. It imports nothing of homeward, so that it starts quickly.
"""

from __future__ import annotations

import json
import marshal
import math
import struct
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote

import apsw
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import storage_mcap
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

try:
    import resource
except ImportError:  # Windows has no limits
    resource = None  # type: ignore[assignment]

BATCH = 2**20
"""Size of a batch of messages [byte]."""
MESSAGE_OVERHEAD = 100
"""Size of a message in a batch, in addition to its data [byte]."""
MAX_MESSAGE = 256 * 2**20
"""[byte]"""
_FORMATS = {"ros1msg": "ros2msg", "ros2msg": "ros2msg", "ros2idl": "ros2idl", "omgidl": "omgidl"}
MIN_ROW = 8
"""Minimum size of a row of messages in a database, in addition to its data [byte]."""
MIN_LENGTH = 2**20
"""Minimum of the limit of a text or blob of a database [byte]; its schema needs less."""
_TABLES = ("messages", "topics", "schema", "message_definitions")
"""Tables of a ROS 2 bag."""
_MCAP_END = 37
"""Size of the footer and magic at the end of an MCAP file [byte]."""


class Mcap(McapReader):
    """Reader of MCAP files from any system; without index or end they are scanned sequentially."""

    is_whole = has_index = False
    size = at = 0

    def _open(self) -> None:
        assert self.bio is not None
        magic, self.size = self.bio.read(8), self.bio.seek(0, 2)
        self.bio.seek(max(self.size - 8, 0))
        self.is_whole = self.bio.read() == magic and self.size > _MCAP_END
        self.bio.seek(17)
        self.has_index = self.is_whole and storage_mcap.read_string(self.bio) == "ros2"
        if self.has_index:
            self.bio.seek(0)
            super()._open()
            self.has_index = bool(self.chunks)
            return
        self.data_start, self.data_end = 8, self.size - _MCAP_END * self.is_whole
        try:
            self.meta_scan()
        except Exception as error:
            if self.is_whole or isinstance(error, MemoryError):
                raise

    def messages(
        self, connections: Any, start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Read the messages of `connections`; set `at` to the end of the readable part [byte]."""
        if self.has_index:
            yield from super().messages(connections, start, stop)
            return
        assert self.bio is not None
        try:
            for message in self.messages_scan(connections, start, stop):
                self.at = self.bio.tell()
                yield message
            if self.bio.tell() != self.data_end:
                raise ValueError("a record longer than its chunk")
        except Exception as error:
            if self.is_whole or isinstance(error, MemoryError):
                raise


def _definition(schema: storage_mcap.Schema | None) -> MessageDefinition:
    """Return a channel's definition; empty where rosbags would refuse the whole log."""
    if schema is None or schema.encoding not in _FORMATS:
        return MessageDefinition(MessageDefinitionFormat.NONE, "")
    return _rosbags_definition(schema._replace(encoding=_FORMATS[schema.encoding]))


def _string(bio: BinaryIO) -> str:
    """Return a text, also where bytes are not UTF-8, as in schemas of other systems."""
    return storage_mcap.read_bytes(bio).decode("utf-8", "replace")


_rosbags_definition = storage_mcap.get_msgdef
storage_mcap.get_msgdef, storage_mcap.read_string = _definition, _string


class Sqlite(Sqlite3Reader):
    """Reader of the sqlite3 file of a ROS 2 bag."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as stream:
            head = stream.read(100)
        page, changes, pages = struct.unpack_from(">H6xII", head, 16)
        (valid_for,) = struct.unpack_from(">I", head, 92)
        # sqlite may not detect this; the number of pages is valid if the last writer updated it.
        is_counted = changes == valid_for
        if is_counted and pages * (65536 if page == 1 else page) > path.stat().st_size:
            raise ValueError("the file is shorter than its header specifies")
        self._size = path.stat().st_size
        super().__init__(Path(quote(str(path.resolve()))))  # rosbags puts it into a URI

    def _open(self) -> None:
        assert self.dbconn is not None
        _require_stored(self.dbconn)
        super()._open()

    def messages(
        self, connections: Any, start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Read messages; ReaderError where the file cannot contain that many."""
        room = self._size
        for message in super().messages(connections, start, stop):
            data: object = message[2]
            room -= MIN_ROW + (len(data) if isinstance(data, (bytes, str)) else 0)
            if room < 0:
                raise rosbag2.ReaderError("more data than possible for its size")
            yield message


def _require_stored(database: apsw.Connection) -> None:
    """Refuse tables whose content is computed, and rows of topics that multiply messages."""
    for schema, name, kind, *_ in database.execute("PRAGMA table_list").fetchall():
        if schema != "main" or str(name).lower() not in _TABLES:
            continue
        if kind != "table":
            raise rosbag2.ReaderError(f"{name} is a {kind}, not a table")
        columns = "SELECT count(*) FROM pragma_table_xinfo(?) WHERE hidden != 0"
        if database.execute(columns, (name,)).fetchall() != [(0,)]:
            raise rosbag2.ReaderError(f"{name} has computed columns")
        twice = "SELECT count(*) != count(DISTINCT id) FROM main.topics"
        if name == "topics" and database.execute(twice).fetchall() != [(0,)]:
            raise rosbag2.ReaderError("two topics have the same id")


def _harden(database: apsw.Connection) -> None:
    """Disable code in a database, and hide definitions that rosbags would refuse."""
    database.config(apsw.SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0)
    size = Path(database.filename).stat().st_size
    database.limit(apsw.SQLITE_LIMIT_LENGTH, min(max(size, MIN_LENGTH), MAX_MESSAGE + MIN_LENGTH))
    for table in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'"):
        if table == ("message_definitions",):
            known = "encoding IN ('ros2msg', 'ros2idl')"
            view = f"SELECT * FROM main.message_definitions WHERE {known}"
            database.execute(f"CREATE TEMP VIEW message_definitions AS {view}")


apsw.connection_hooks.append(_harden)
READERS = {"bag": rosbag1.Reader, "mcap": Mcap, "db3": Sqlite}


def walk(
    path: str, kind: str, topics: list[str] | None, prefix: int | None, is_packed: bool
) -> Iterator[tuple[Any, ...]]:
    """Yield parts of the file `path` for `log.Log`; `kind` is a key of `READERS`.

    `topics` None: all. Data are cut to a length `prefix` [byte], except for the first message of
    each channel. `is_packed`: each message is compressed separately.
    """
    reader: Any = READERS[kind](Path(path))
    reader.open()
    with closing(reader):
        yield "channels", {c.id: _channel(c) for c in reader.connections}
        chosen = [c for c in reader.connections if topics is None or c.topic in topics]
        total, count, size = sum(c.msgcount for c in chosen), 0, 0
        batch: list[tuple[int, int, bytes]] = []
        seen: set[int] = set()
        for connection, receive, data in reader.messages(chosen) if chosen else ():
            number, whole = connection.id, _whole(receive, data, is_packed)
            batch.append((number, receive, whole[:prefix] if number in seen else whole))
            seen.add(number)
            count, size = count + 1, size + len(batch[-1][2]) + MESSAGE_OVERHEAD
            if size > BATCH:
                at = getattr(reader, "at", 0) / Path(path).stat().st_size
                yield "messages", batch, count / total if total else at
                batch, size = [], 0
        yield "messages", batch, 1.0
        if isinstance(reader, Mcap) and not reader.is_whole:
            yield "cut", reader.at, reader.size


def _whole(receive: object, data: object, is_packed: bool) -> bytes:
    """Return the data of a message, unpacked."""
    if type(receive) is not int or type(data) is not bytes:
        kinds = f"{type(receive).__name__} and {type(data).__name__}"
        raise ValueError(f"a message whose time and data are {kinds}, not int and bytes")
    whole: bytes = zstd.decompress(data) if is_packed else data
    if len(whole) > MAX_MESSAGE:
        raise ValueError(f"a message of {len(whole):,} bytes")
    return whole


def _channel(connection: Connection) -> tuple[str, ...]:
    """Return topic, type, encoding, definition and syntax of the definition."""
    definition, ext = connection.msgdef, connection.ext
    is_idl = definition.format is MessageDefinitionFormat.IDL
    texts = (
        connection.topic,
        connection.msgtype,
        getattr(ext, "serialization_format", "ros1"),
        definition.data,
        "idl" if is_idl else "msg",
    )
    if not all(type(text) is str for text in texts):
        raise ValueError("a topic or type that is not text")
    return texts


def unpack(path: str, target: str, room: int) -> Iterator[tuple[Any, ...]]:
    """Unpack a compressed file to at most `room` bytes; yield nothing."""
    with Path(path).open("rb") as stream, zstd.open(stream) as packed, open(target, "wb") as out:
        while block := packed.read(2**20):
            room -= len(block)
            if room < 0:
                raise MemoryError
            out.write(block)
    yield from ()


def limit(memory: int, disk: int, seconds: float) -> None:
    """Limit address space and files that are written [byte], and further processor time [s].

    Nothing is limited where the platform cannot.
    """
    if resource is None:
        return
    until = math.ceil(time.process_time() + seconds)
    limits = (
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_FSIZE, disk),  # sqlite sorts large tables in files
        (resource.RLIMIT_CPU, until),
        (resource.RLIMIT_CORE, 0),  # no core file when the time limit is exceeded
    )
    for which, value in limits:
        _, hard = resource.getrlimit(which)
        if hard != resource.RLIM_INFINITY:
            value = min(value, hard)
        try:
            resource.setrlimit(which, (value, hard))
        except (ValueError, OSError):  # such as the address space on macOS
            continue


COMMANDS: dict[str, Callable[..., Iterator[tuple[Any, ...]]]] = {"walk": walk, "unpack": unpack}


def answer(request: dict[str, Any]) -> Iterator[tuple[Any, ...]]:
    """Yield the answers to a request, and finally its end or an error."""
    try:
        limit(request["memory"], request["disk"], request["seconds"])
        yield from COMMANDS[request["command"]](*request["arguments"])
        yield ("end",)
    except MemoryError:
        yield ("memory",)
    except (KeyboardInterrupt, BrokenPipeError):
        raise
    except (rosbag1.ReaderError, rosbag2.ReaderError) as error:
        yield "damaged", str(error).rstrip(".")
    except Exception as error:  # rosbags raises many types for damaged files
        yield "damaged", f"{type(error).__name__}: {error}"


def main() -> None:
    """Answer the requests on standard input, each a line of JSON."""
    out = sys.stdout.buffer
    for line in sys.stdin.buffer:
        for part in answer(json.loads(line)):
            data = marshal.dumps(part)
            out.write(struct.pack("<Q", len(data)))
            out.write(data)
            out.flush()


if __name__ == "__main__":
    main()
