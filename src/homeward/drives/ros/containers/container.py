"""What the log files have in common: channels, and messages one after the other.

rosbags decodes and writes messages; the files themselves are walked here, from front to end. Its
own readers allocate what a length field claims, inflate what a chunk holds and keep the index of
every message in memory, which a log of unknown origin must not be able to ask for.
"""

from __future__ import annotations

import bz2
import os
import struct
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, NamedTuple, Protocol

import lz4.frame

from homeward.drives.text.files import naming, opened
from homeward.drives.text.table import quoted
from homeward.errors import InputError

if sys.version_info >= (3, 14):
    from compression import zstd as zstd
else:
    from backports import zstd as zstd

LARGEST_BLOCK = 256 * 2**20
"""No chunk, no message and no index may be larger [byte]; recorders write chunks of 1 to 16 MiB."""
LEAST_TOTAL = 256 * 2**20
"""A log may always unpack to this much in all [byte]."""
LARGEST_GROWTH = 100
"""And beyond it to this many times the size of its file."""
LEAST_RECORDS = 1_000_000
"""A log may always have so many records, and one for each byte of its file: some seconds' work."""


@dataclass(frozen=True)
class Channel:
    """One topic as one publisher told it."""

    topic: str
    type: str
    """As in ``nav_msgs/msg/Odometry``."""
    encoding: str
    """``ros1`` or ``cdr``; any other is listed, never decoded."""
    definition: str = ""
    """Text of the message definition; empty when the log holds none."""
    syntax: str = "msg"
    """Of the definition: ``msg`` or ``idl``."""


class Message(NamedTuple):
    """One message, not yet decoded."""

    channel: Channel
    receive: int
    """When the recorder received it [ns]."""
    data: bytes | memoryview


class Log(Protocol):
    """A log of any kind, which may be walked several times."""

    path: Path
    kind: str
    """In words."""
    done: float
    """How far the walk is, in [0, 1]."""

    def messages(self) -> Iterator[Message]:
        """Walk the messages in the order of the file.

        Raises
        ------
        InputError
            When the file is damaged, or asks for more memory than a log may.
        """


class DamagedLog(InputError):
    """A log whose bytes are not sound: cut short, overwritten, or not closed by its recorder."""


class Source:
    """A file read from front to end; nothing is read before its length was found to be possible."""

    def __init__(self, path: Path, stream: IO[bytes]) -> None:
        self.path, self._stream = path, stream
        self.size = os.fstat(stream.fileno()).st_size
        self.at = 0

    @property
    def done(self) -> float:
        """The fraction read."""
        return self.at / max(self.size, 1)

    def take(self, size: int, what: str) -> bytes:
        """Read `size` bytes of `what`."""
        self._check(size, what)
        if size > LARGEST_BLOCK:
            raise InputError(f"{what} at byte {self.at} has {size} bytes, too many", self.path)
        data = self._stream.read(size)
        self.at += size
        return data

    def skip(self, size: int, what: str) -> None:
        """Pass over `size` bytes of `what`."""
        self._check(size, what)
        self._stream.seek(size, 1)
        self.at += size

    def _check(self, size: int, what: str) -> None:
        if size > self.size - self.at:
            raise DamagedLog(
                f"truncated or damaged: {what} at byte {self.at} is said to have {size} bytes, "
                f"and {self.size - self.at} are left",
                self.path,
            )


class RecordFile(ABC):
    """A `Log` that is one file of records behind a line that says what it is.

    At the end of a walk the file's index must tell of what was met.
    """

    kind: str
    magic: bytes
    repair: str
    """The command that repairs such a file, as a clause."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.done = 0.0

    def messages(self) -> Iterator[Message]:
        """Walk the messages; see `Log`."""
        with walking(self.path, self.repair), opened(self.path) as stream:
            self._source, self._budget = Source(self.path, stream), Budget(self.path)
            self._unpacker = Unpacker(self._budget)
            self._channels: dict[int, Channel] = {}
            self._chunks: set[int] = set()
            self._indexed: set[int] = set()
            self._met = 0
            self._source.take(len(self.magic), "the first line")
            yield from self._walk()

    @abstractmethod
    def _walk(self) -> Iterator[Message]:
        """Walk the messages behind the first line."""

    def _require(self, fits: bool) -> None:
        """Refuse a file whose index does not fit what was met."""
        if not fits:
            raise DamagedLog("damaged: its index tells of other messages", self.path)


class Budget:
    """What one file may come to in all; more is no recording, but meant to keep us busy."""

    def __init__(self, path: Path) -> None:
        self.path = path
        size = path.stat().st_size
        self._bytes = max(LEAST_TOTAL, LARGEST_GROWTH * size)
        self._records = LEAST_RECORDS + size

    def unpacked(self, size: int) -> None:
        """Take note of so many bytes that came out of a chunk or a cell."""
        self._bytes -= size
        if size > LARGEST_BLOCK or self._bytes < 0:
            raise InputError("unpacks to more than a log may hold", self.path)

    def record(self) -> None:
        """Take note of a record."""
        self._records -= 1
        if self._records < 0:
            raise InputError("unpacks to more records than a log may hold", self.path)


class Unpacker:
    """Inflates the chunks of one file, none beyond what it declares."""

    def __init__(self, budget: Budget) -> None:
        self._path, self._budget = budget.path, budget

    def unpack(self, data: bytes | memoryview, compression: str, size: int) -> bytes | memoryview:
        """Return a chunk's `size` bytes.

        Raises
        ------
        InputError
            For an unknown compression, another size than declared, or more than a log may hold.
        """
        self._budget.unpacked(size)
        if compression in ("", "none"):
            raw: bytes | memoryview = data
        elif compression in _INFLATERS:
            try:
                raw = _INFLATERS[compression](bytes(data), size + 1)
            except (OSError, RuntimeError, EOFError, ValueError, zstd.ZstdError) as error:
                raise DamagedLog(
                    f"a chunk is not {compression}: {in_short(error)}", self._path
                ) from error
        else:
            raise InputError(f"chunks are compressed by {quoted(compression)}", self._path)
        if len(raw) != size:
            more = "more" if len(raw) > size else len(raw)
            raise DamagedLog(f"a chunk of {size} bytes unpacks to {more}", self._path)
        return raw

    def unpack_whole(self, data: bytes) -> bytes:
        """Return what a zstd frame of unknown size holds."""
        raw = _INFLATERS["zstd"](data, LARGEST_BLOCK + 1)
        self._budget.unpacked(len(raw))
        return raw


_INFLATERS: dict[str, Callable[[bytes, int], bytes]] = {
    "bz2": lambda data, limit: bz2.BZ2Decompressor().decompress(data, limit),
    "lz4": lambda data, limit: lz4.frame.LZ4FrameDecompressor().decompress(data, limit),
    "zstd": lambda data, limit: zstd.ZstdDecompressor().decompress(data, limit),
}
"""By their names in logs; of the data given so many bytes at most come out."""


@contextmanager
def walking(path: Path, repair: str = "") -> Iterator[None]:
    """Make an InputError of whatever a damaged file gives rise to, with the way to `repair` it."""
    try:
        with naming(path, "cannot be read"):
            yield
    except DamagedLog as error:
        what = error.what
    except KeyError as error:  # as of a message whose channel was not told
        what = f"damaged: it refers to {in_short(error)}, which is not in it"
    except (struct.error, ValueError, IndexError, OverflowError) as error:
        what = f"damaged: {in_short(error)}"
    else:
        return
    raise InputError(f"{what}; {repair}" if repair else what, path)


def sized(data: memoryview, at: int, length: str = "<I") -> tuple[memoryview, int]:
    """Return what a length at `at`, of a format of `struct`, announces, and where that ends."""
    (size,) = struct.unpack_from(length, data, at)
    begin = at + struct.calcsize(length)
    if size > len(data) - begin:
        raise ValueError(f"{size} bytes announced where {len(data) - begin} are left")
    return data[begin : begin + size], begin + size


def in_short(error: Exception) -> str:
    """Return what an error says as one line of bounded length; it may quote hostile text."""
    text = " ".join(str(error).split())
    return text if len(text) <= 200 else text[:200] + "..."


def ros2_type(name: str) -> str:
    """Return a type's name with its ``/msg/`` in it, which ROS 1 leaves out.

    The name of another kind of type, as of protobuf, stays as it is.
    """
    package, slash, rest = name.partition("/")
    return f"{package}/msg/{rest}" if slash and "/" not in rest else name
