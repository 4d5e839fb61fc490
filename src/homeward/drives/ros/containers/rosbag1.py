"""ROS 1 bags, format 2.0 (wiki.ros.org/Bags/Format/2.0), walked from front to end."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import TypeAlias

from homeward.drives.ros.containers.container import (
    Channel,
    DamagedLog,
    Message,
    RecordFile,
    ros2_type,
    sized,
)
from homeward.drives.ros.containers.magic import ROSBAG1
from homeward.errors import InputError

_MESSAGE, _HEADER, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 5, 6, 7
LARGEST_HEADER = 2**20
"""Of a record [byte]."""

Fields: TypeAlias = dict[bytes, memoryview]


class Rosbag1(RecordFile):
    """A ROS 1 bag."""

    kind, magic = "ROS 1 bag", ROSBAG1
    repair = "`rosbag reindex FILE` repairs a bag that is cut short"

    def _walk(self) -> Iterator[Message]:
        self._counted = 0
        self._declared: tuple[int, int] | None = None
        source = self._source
        while source.at < source.size:
            start = source.at
            fields, size = self._head()
            op = fields[b"op"][0]
            if op == _CHUNK:
                self._chunks.add(start)
                chunk = source.take(size, "a chunk")
                self.done = source.done
                yield from self._chunk(fields, chunk)
            elif op in (_CONNECTION, _CHUNK_INFO, _HEADER, _MESSAGE):
                record = memoryview(source.take(size, "a record"))
                yield from self._record(op, fields, record)
            else:
                source.skip(size, "a record")
        whole = self._declared is not None and self._declared[1] == len(self._chunks)
        self._require(whole and self._indexed == self._chunks and self._counted == self._met)

    def _head(self) -> tuple[Fields, int]:
        """Read the header of a record of the file, and the size of its data."""
        (size,) = struct.unpack("<I", self._source.take(4, "a record's header"))
        if size > LARGEST_HEADER:
            raise DamagedLog(f"damaged: a record's header of {size} bytes", self._source.path)
        fields = _fields(memoryview(self._source.take(size, "a record's header")))
        (data_size,) = struct.unpack("<I", self._source.take(4, "a record"))
        return fields, data_size

    def _chunk(self, fields: Fields, data: bytes) -> Iterator[Message]:
        (size,) = struct.unpack("<I", fields[b"size"])
        raw = self._unpacker.unpack(data, str(fields[b"compression"], "utf-8"), size)
        for inner, record in _records(memoryview(raw)):
            self._budget.record()
            yield from self._record(inner[b"op"][0], inner, record)

    def _record(self, op: int, fields: Fields, data: memoryview) -> Iterator[Message]:
        if op == _MESSAGE:
            (number,) = struct.unpack("<I", fields[b"conn"])
            seconds, nanoseconds = struct.unpack("<II", fields[b"time"])
            self._met += 1
            yield Message(self._channels[number], seconds * 10**9 + nanoseconds, data)
        elif op == _CONNECTION:
            (number,) = struct.unpack("<I", fields[b"conn"])
            self._channels.setdefault(number, _channel(fields, data))
        elif op == _CHUNK_INFO:
            self._indexed.add(struct.unpack("<Q", fields[b"chunk_pos"])[0])
            self._counted += sum(count for _, count in struct.iter_unpack("<II", data))
        elif op == _HEADER:
            self._read_bag_header(fields)

    def _read_bag_header(self, fields: Fields) -> None:
        path = self._source.path
        if len(fields.get(b"encryptor", b"")):
            raise InputError("is encrypted", path)
        (index,) = struct.unpack("<Q", fields[b"index_pos"])
        (chunks,) = struct.unpack("<I", fields[b"chunk_count"])
        if index == 0:
            raise DamagedLog("was not closed by its recorder and has no index", path)
        if index > self._source.size:
            raise DamagedLog("truncated: its index lies beyond its end", path)
        self._declared = (index, chunks)


def _records(data: memoryview) -> Iterator[tuple[Fields, memoryview]]:
    """Yield header and data of each record in a chunk."""
    at = 0
    while at < len(data):
        header, at = sized(data, at)
        content, at = sized(data, at)
        yield _fields(header), content


def _fields(header: memoryview) -> Fields:
    """Return the fields of a record's header."""
    fields: Fields = {}
    at = 0
    while at < len(header):
        field, at = sized(header, at)
        name, equals, _ = bytes(field).partition(b"=")
        if not equals:
            raise ValueError("a header field without a name")
        fields[name] = field[len(name) + 1 :]
    return fields


def _channel(fields: Fields, data: memoryview) -> Channel:
    told = _fields(data)
    return Channel(
        topic=str(fields[b"topic"], "utf-8"),
        type=ros2_type(str(told[b"type"], "utf-8")),
        encoding="ros1",
        definition=str(told.get(b"message_definition", memoryview(b"")), "utf-8", "replace"),
    )
