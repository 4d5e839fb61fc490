"""MCAP files (mcap.dev/spec) of ROS 2 or ROS 1, walked from front to end."""

from __future__ import annotations

import struct
from binascii import crc32
from collections.abc import Iterator

from homeward.drives.ros.containers.container import (
    Channel,
    DamagedLog,
    Message,
    RecordFile,
    ros2_type,
    sized,
)
from homeward.drives.ros.containers.magic import MCAP

_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
_CHUNK_INDEX, _STATISTICS = 0x08, 0x0B
_KEPT = (_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _CHUNK_INDEX, _STATISTICS)
_SYNTAX = {"ros2msg": "msg", "ros1msg": "msg", "ros2idl": "idl", "omgidl": "idl"}


class Mcap(RecordFile):
    """An MCAP file."""

    kind, magic = "MCAP", MCAP
    repair = "`mcap recover FILE -o NEW.mcap` saves the messages before the damage"

    def _walk(self) -> Iterator[Message]:
        self._schemas: dict[int, tuple[str, str, str]] = {}
        self._counted: int | None = None
        source, op = self._source, 0
        while op != _FOOTER:
            start = source.at
            op, size = struct.unpack("<BQ", source.take(9, "a record"))
            _check(op)
            if op not in _KEPT:
                source.skip(size, "a record")
                continue
            record = memoryview(source.take(size, "a record"))
            self.done = source.done
            if op == _CHUNK:
                self._chunks.add(start)
                for inner, content in _records(self._chunk(record)):
                    self._budget.record()
                    yield from self._record(inner, content)
            else:
                yield from self._record(op, record)
        if source.take(len(MCAP), "the last line") != MCAP:
            raise DamagedLog("damaged: it does not end as an MCAP file does", source.path)
        counted = self._met if self._counted is None else self._counted
        self._require(self._indexed in (set(), self._chunks) and counted == self._met)

    def _chunk(self, record: memoryview) -> memoryview:
        size, crc = struct.unpack_from("<QI", record, 16)
        compression, at = _string(record, 28)
        (packed,) = struct.unpack_from("<Q", record, at)
        if at + 8 + packed != len(record):
            raise ValueError("a chunk of another size than it says")
        raw = self._unpacker.unpack(record[at + 8 :], compression, size)
        if crc and crc32(raw) != crc:
            raise ValueError("a chunk with a wrong checksum")
        return memoryview(raw)

    def _record(self, op: int, record: memoryview) -> Iterator[Message]:
        if op == _MESSAGE:
            number, _, receive, _ = struct.unpack_from("<HIQQ", record)
            self._met += 1
            yield Message(self._channels[number], receive, record[22:])
        elif op == _SCHEMA:
            (number,) = struct.unpack_from("<H", record)
            name, at = _string(record, 2)
            encoding, at = _string(record, at)
            definition, _ = _string(record, at)
            self._schemas[number] = (name, encoding, definition)
        elif op == _CHANNEL:
            number, channel = self._read_channel(record)
            self._channels.setdefault(number, channel)
        elif op == _CHUNK_INDEX:
            self._indexed.add(struct.unpack_from("<Q", record, 16)[0])
        elif op == _STATISTICS:
            (self._counted,) = struct.unpack_from("<Q", record)

    def _read_channel(self, record: memoryview) -> tuple[int, Channel]:
        number, schema = struct.unpack_from("<HH", record)
        topic, at = _string(record, 4)
        encoding, _ = _string(record, at)
        name, syntax, definition = self._schemas.get(schema, ("", "", ""))
        known = _SYNTAX.get(syntax)
        return number, Channel(
            topic, ros2_type(name), encoding, definition if known else "", known or "msg"
        )


def _records(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield the kind and content of each record in a chunk."""
    at = 0
    while at < len(data):
        op = data[at]
        _check(op)
        content, at = sized(data, at + 1, "<Q")
        yield op, content


def _check(op: int) -> None:
    """Refuse the one kind of record that cannot be; a file of zeros would have millions of it."""
    if op == 0:
        raise ValueError("a record of kind 0")


def _string(data: memoryview, at: int) -> tuple[str, int]:
    """Return the text at `at`, and where it ends."""
    text, end = sized(data, at)
    return str(text, "utf-8"), end
