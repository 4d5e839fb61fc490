"""Reader of the records of a WPILib data log (.wpilog).

Source: "WPILib Data Log File Format Specification, Version 1.0" (wpilibsuite/allwpilib,
wpiutil/doc/datalog.adoc): the magic, a version, an extra header, and records of variable-length
fields. Control records, of entry 0, start and finish the other entries.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from typing import IO, NamedTuple

from homeward.drives.ros.messages import wpilib
from homeward.errors import InputError

MAX_PAYLOAD = 256 * 2**20
"""Maximum size of a record [byte]."""
REPEAT_US = 500_000
"""Interval at which the last value of odometry is repeated [us]: a twist is valid for 1 s."""
MAX_REPEATS = 100_000
"""Maximum number of repeated values; for one entry it is reached after 14 h."""
_START, _FINISH = 0, 1


class Entry(NamedTuple):
    """A named sequence of values."""

    name: str
    type: str
    """As in `wpilib.type_of`."""


class Record(NamedTuple):
    """A value of an entry."""

    entry: Entry
    t: int
    """Time since the start of the robot's program [us]."""
    data: bytes


class _Damaged(Exception):
    """The file ends within a record, or a record is invalid."""


class DataLog:
    """The records of an open data log of a size [byte], read once."""

    def __init__(self, stream: IO[bytes], size: int) -> None:
        self._stream, self._size = stream, size
        self._repeats_left = MAX_REPEATS
        self.at = 0
        """End of the last readable record [byte]."""

    def records(self, names: Collection[str] | None = None) -> Iterator[Record]:
        """Yield the records up to the end of the file, or up to the first damage.

        With `names`, only of these entries; then the last values of odometry are repeated while
        they do not change. `InputError` for another version, or a record beyond `MAX_PAYLOAD`.
        """
        entries: dict[int, Entry] = {}
        last: dict[Entry, Record] = {}
        repeat_from = 0
        try:
            self._header()
            while self.at < self._size:
                number, t, data, end = self._next()
                if last and t > repeat_from:
                    yield from self._repeats(last, t)
                    repeat_from = t + REPEAT_US // 10
                if number == 0:
                    _control(data, entries)
                elif number in entries and (names is None or entries[number].name in names):
                    entry = entries[number]
                    if entry.type == wpilib.PHOTON_RESULT:
                        t = wpilib.exposure_time(t, data)
                    record = Record(entry, t, data)
                    if names is not None and entry.type in wpilib.ON_CHANGE:
                        last[entry] = record
                    yield record
                self.at = end
        except _Damaged:
            return

    def _repeats(self, last: dict[Entry, Record], now: int) -> Iterator[Record]:
        """Yield the values that did not change before `now` [us] again, and update `last`."""
        for entry, record in last.items():
            for t in range(record.t + REPEAT_US, now, REPEAT_US)[: self._repeats_left]:
                self._repeats_left -= 1
                last[entry] = record._replace(t=t)
                yield last[entry]

    def _header(self) -> None:
        _, version, extra = struct.unpack("<6sHI", self._read(12, 0))
        if version >> 8 != 1:
            what = f"a WPILib data log of version {version >> 8}.{version & 255}; 1.0 is supported"
            raise InputError(what)
        self._read(extra, 12)
        self.at = 12 + extra

    def _next(self) -> tuple[int, int, bytes, int]:
        """Return entry number, time [us] and payload of the next record, and its end [byte]."""
        widths = self._read(1, self.at)[0]
        if widths > 0x7F:
            raise _Damaged
        to_length = (widths & 3) + 1
        to_time = to_length + (widths >> 2 & 3) + 1
        to_data = to_time + (widths >> 4) + 1
        at = self.at + 1 + to_data
        head = self._read(to_data, self.at + 1)
        length = int.from_bytes(head[to_length:to_time], "little")
        number = int.from_bytes(head[:to_length], "little")
        t = int.from_bytes(head[to_time:], "little")
        return number, t, self._read(length, at), at + length

    def _read(self, count: int, at: int) -> bytes:
        """Return the next bytes, which are at a position [byte]."""
        if count > self._size - at:
            raise _Damaged
        if count > MAX_PAYLOAD:
            raise InputError(f"a record of {count:,} bytes; at most {MAX_PAYLOAD:,} are allowed")
        return self._stream.read(count)


def _control(data: bytes, entries: dict[int, Entry]) -> None:
    """Add the entry that a control record starts, or remove the one that it finishes."""
    try:
        kind, number = struct.unpack_from("<BI", data)
        if kind == _FINISH:
            entries.pop(number, None)
        elif kind == _START:
            name, at = _text(data, 5)
            entries[number] = Entry(name, wpilib.type_of(name, _text(data, at)[0]))
    except struct.error:
        raise _Damaged from None


def _text(data: bytes, at: int) -> tuple[str, int]:
    """Return a text with its length before it, and the position after it [byte]."""
    (length,) = struct.unpack_from("<I", data, at)
    end = at + 4 + length
    if end > len(data):
        raise _Damaged
    return data[at + 4 : end].decode("utf-8", "replace"), end
