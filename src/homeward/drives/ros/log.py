"""Logs: ROS 1 bags, MCAP and sqlite3 files, the folders of ROS 2 bags, and WPILib data logs.

A separate process with limits reads the files with rosbags (`log_process`), except for data logs
(`wpilog`). This module does not need the extra bags.
"""

from __future__ import annotations

import atexit
import json
import marshal
import os
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, NamedTuple, TypeAlias

from homeward.drives.ros import wpilog
from homeward.drives.ros.kinds import (
    KINDS,
    LCM,
    METADATA,
    OLDER_ROSBAG,
    Kind,
    bare_files,
    first_bytes,
)
from homeward.errors import InputError
from homeward.io.reading import is_there, naming, opened
from homeward.io.table import quoted

_ROOT = "rosbag2_bagfile_information"
_ZSTD = b"\x28\xb5\x2f\xfd"
MAX_UNPACKED = 2**34
"""Maximum size of a temporary file unpacked from a compressed one [byte]."""
MIN_UNPACKED, MAX_GROWTH = 256 * 2**20, 100
"""Limits of an unpacked file: the larger of this size [bytes] and this multiple of its own size."""
MIN_MEMORY, MAX_MEMORY, MEMORY_PER_BYTE = 2**31, 2**33, 2
"""Memory limit of the reading process [byte]: rosbags keeps the index of all messages in memory."""
MIN_DISK, DISK_PER_BYTE = 2**26, 2
"""Limit of the temporary files of the reading process [byte]."""
MIN_SECONDS = 2.0
PACKED_BYTES_PER_SECOND, BYTES_PER_SECOND = 100_000, 1_000_000
"""Limit of processor time for a file: a constant [s], and this number of bytes per second, in files
with or without compression."""
MIN_MESSAGES = 100_000
"""Maximum number of messages, in addition to one for each byte of the file."""


@dataclass(frozen=True)
class Channel:
    """One topic of one publisher."""

    topic: str
    type: str
    """As in ``nav_msgs/msg/Odometry``."""
    encoding: str
    """``ros1``, ``cdr`` or ``wpilog``; others are listed, but not decoded."""
    definition: str = ""
    """Text of the message definition; empty when the log has none."""
    syntax: str = "msg"
    """Syntax of the definition: ``msg`` or ``idl``."""


Fields: TypeAlias = Callable[[str], Sequence[tuple[str, str, bool]]]
"""Returns the fields of a message type: name, type, and whether it is a list; none of a number."""


class Message(NamedTuple):
    """An encoded message."""

    channel: Channel
    receive: int
    """Receive time of the recorder [ns]."""
    data: bytes


class Log:
    """A log of any kind, whose messages can be read repeatedly."""

    def __init__(self, path: Path) -> None:
        """Find the files of a log; `InputError` for an unknown kind."""
        self.path = path
        self.done = 0.0
        """Fraction of the messages read, in [0, 1]."""
        self.cut_short: dict[str, int] = {}
        """Numbers of messages read from incomplete files, by description."""
        if path.is_dir():
            self._files, self._has_packed_messages = _contents(path)
            self.kind = f"ROS 2 bag folder ({len(self._files)} files)"
        else:
            self._files, self._has_packed_messages = [path], False
            self.kind = _kind(path).words

    def messages(
        self, topics: Collection[str] | None = None, prefix: int | None = None
    ) -> Iterator[Message]:
        """Read the messages of each file in order of time, of all or some topics.

        Data are cut to a length `prefix` [byte], except for the first message of each channel.
        `InputError` where a file is damaged, or exceeds the limits of memory or time.
        """
        for number, file in enumerate(self._files):
            with self._unpacked(file) as whole, _about(file):
                for message in self._of_file(whole, topics, prefix):
                    self.done = (number + self._done_of_file) / len(self._files)
                    yield message

    def _of_file(
        self, file: Path, topics: Collection[str] | None, prefix: int | None
    ) -> Iterator[Message]:
        kind, size = _kind(file), file.stat().st_size
        if kind.reader == "wpilog":
            yield from self._of_data_log(file, kind, size, topics)
            return
        wanted = None if topics is None else sorted(topics)
        words = (os.path.abspath(file), kind.reader, wanted, prefix, self._has_packed_messages)
        channels: dict[int, Channel] = {}
        count = 0
        for part, *values in self._ask(file, kind.repair, "walk", *words):
            match part:
                case "channels":
                    channels = {n: _channel(*texts) for n, texts in values[0].items()}
                case "messages":
                    batch, self._done_of_file = values
                    count += len(batch)
                    _require_few(count, size, file)
                    for number, receive, data in batch:
                        yield Message(channels[number], receive, data)
                case "cut":
                    self._remark_cut(file, kind, count, *values)

    def _of_data_log(
        self, file: Path, kind: Kind, size: int, topics: Collection[str] | None
    ) -> Iterator[Message]:
        with opened(file) as stream:
            log, count = wpilog.DataLog(stream, size), 0
            channels: dict[wpilog.Entry, Channel] = {}
            for entry, t, data in log.records(topics):
                count += 1
                self._done_of_file = log.at / size
                _require_few(count, size, file)
                if entry not in channels:
                    channels[entry] = Channel(*entry, "wpilog")
                yield Message(channels[entry], 1000 * t, data)
        if log.at < size:
            self._remark_cut(file, kind, count, log.at, size)

    def _remark_cut(self, file: Path, kind: Kind, count: int, at: int, size: int) -> None:
        """Add a remark about an incomplete file; `InputError` if it has no readable message."""
        if not count and not self.cut_short:
            raise InputError("damaged: no readable message", file, advice=kind.repair)
        self.cut_short.setdefault(
            f"messages read from {quoted(file.name)}, which is incomplete (not closed or cut off) "
            f"or damaged: up to byte {at:,} of {size:,}; {kind.repair}",
            count,
        )

    @contextmanager
    def _unpacked(self, file: Path) -> Iterator[Path]:
        """Yield a file, unpacked if it is compressed."""
        if not first_bytes(file).startswith(_ZSTD):
            yield file
            return
        with tempfile.TemporaryDirectory(prefix="homeward-") as folder, _about(file):
            whole = Path(folder) / file.stem
            growth = max(MIN_UNPACKED, MAX_GROWTH * file.stat().st_size)
            room = min(MAX_UNPACKED, growth, shutil.disk_usage(folder).free // 2)
            unpacking = "unpack", os.path.abspath(file), str(whole), room
            for _ in self._ask(file, "", *unpacking, disk=room):
                pass
            yield whole

    def _ask(
        self, file: Path, repair: str, command: str, *arguments: Any, disk: int | None = None
    ) -> Iterator[tuple[Any, ...]]:
        """Yield the answers of the reading process; `InputError` for a failure.

        The process may write files of `disk` bytes; None: temporary ones that suffice for sorting.
        """
        process = _reader_process()
        size = file.stat().st_size
        disk = MIN_DISK + DISK_PER_BYTE * size if disk is None else disk
        is_plain = command == "walk" and arguments[1] == "db3" and not self._has_packed_messages
        rate = BYTES_PER_SECOND if is_plain else PACKED_BYTES_PER_SECOND
        seconds = MIN_SECONDS + size / rate
        memory = min(MIN_MEMORY + MEMORY_PER_BYTE * size, MAX_MEMORY)
        request = {"command": command, "arguments": arguments, "seconds": seconds}
        request |= {"memory": memory, "disk": disk}
        assert process.stdin is not None
        is_answered = False
        try:
            process.stdin.write(json.dumps(request).encode() + b"\n")
            process.stdin.flush()
            while (answer := _receive(process))[0] not in ("end", "memory", "damaged", "died"):
                yield answer
            is_answered = answer[0] in ("end", "damaged")
        except BrokenPipeError:
            answer = ("died",)
        finally:
            if is_answered:
                _idle[os.getpid()].append(process)
            else:  # it may still write answers to this request
                _end(process)
        if answer[0] == "damaged":
            problem = f"damaged or incomplete: {one_line(answer[1])}"
            raise InputError(problem, file, advice=repair or None)
        if answer[0] == "memory":
            problem = (
                "unpacks to more than the limit, or needs more than "
                f"{memory / 2**30:.0f} GiB of memory"
            )
            raise InputError(problem, file, advice="split the recording if you trust it")
        if answer[0] == "died":
            if process.returncode == -getattr(signal, "SIGXCPU", 0):
                problem = f"takes more than {seconds:.0f} s of processor time"
            else:
                problem = f"crashes the process that reads it (status {process.returncode})"
            raise InputError(problem, file, advice="split the recording if you trust it")


_idle: defaultdict[int, list[subprocess.Popen[bytes]]] = defaultdict(list)
"""Idle reading processes, by the process that started them: a fork starts its own."""


@atexit.register
def _end_idle() -> None:
    for process in _idle.pop(os.getpid(), []):
        _end(process)


def _reader_process() -> subprocess.Popen[bytes]:
    """Return an idle or a new reading process."""
    idle = _idle[os.getpid()]
    while idle:
        if (process := idle.pop()).poll() is None:
            return process
        _end(process)
    script = Path(__file__).with_name("log_process.py")
    # It imports rosbags from the same path as this process.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    return subprocess.Popen(
        [sys.executable, "-P", str(script)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
    )


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a reading process, if it has not ended."""
    for stream in (process.stdout, process.stdin):
        if stream is not None:
            with suppress(BrokenPipeError):
                stream.close()
    if process.poll() is None:
        process.kill()
    process.wait()


def _receive(process: subprocess.Popen[bytes]) -> tuple[Any, ...]:
    """Return the next answer of a process; ``died`` when it ended."""
    assert process.stdout is not None
    head = process.stdout.read(8)
    if len(head) == 8:
        (size,) = struct.unpack("<Q", head)
        data = process.stdout.read(size)
        if len(data) == size:
            answer: tuple[Any, ...] = marshal.loads(data)
            return answer
    process.wait()
    return ("died",)


@contextmanager
def _about(file: Path) -> Iterator[None]:
    """Make errors name a file of the log, not its unpacked copy."""
    try:
        with naming(file, "cannot be read"):
            yield
    except InputError as error:
        error.file = file
        raise


def _require_few(count: int, size: int, file: Path) -> None:
    """Refuse a number of messages that is not possible for a file of `size` bytes."""
    if count > MIN_MESSAGES + size:
        raise InputError("more messages than possible for its size", file)


def _channel(topic: str, kind: str, *rest: str) -> Channel:
    """Return a channel, with ``/msg/`` in its type, which ROS 1 omits."""
    package, slash, name = kind.partition("/")
    kind = "" if kind == "__schemaless__" else kind
    return Channel(topic, f"{package}/msg/{name}" if slash and "/" not in name else kind, *rest)


def _kind(path: Path) -> Kind:
    first = first_bytes(path)
    for magic, kind in KINDS.items():
        if first.startswith(magic):
            return kind
    if first.startswith(OLDER_ROSBAG):
        advice = "convert it with rosbag fix"
        raise InputError("a ROS bag of a format before 2.0", path, advice=advice)
    if first.startswith(LCM):
        raise InputError(
            "an LCM event log, which does not contain the definitions of its messages",
            path,
            advice="export its channels to CSV files (lcm.EventLog in Python; "
            "docs/do/csv.md), then use homeward import",
        )
    raise InputError("neither a ROS bag, an MCAP file nor a .wpilog file", path)


def _contents(path: Path) -> tuple[list[Path], bool]:
    """Return a folder's files in order, and whether their messages are compressed."""
    from homeward.io.settings import read_tree

    file = path / METADATA
    if not is_there(file):
        if not (files := bare_files(path)):
            raise InputError("contains no ROS bag and no MCAP file", path)
        return files, False
    metadata = read_tree(file).get(_ROOT)
    if not isinstance(metadata, dict):
        raise InputError(f"{_ROOT} is missing or not a mapping", file)
    names, mode = metadata.get("relative_file_paths"), metadata.get("compression_mode") or ""
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise InputError("relative_file_paths is not a list of files", file)
    if mode and metadata.get("compression_format") not in ("zstd", "", None):
        compression = quoted(str(metadata["compression_format"]))
        advice = "use zstd"
        raise InputError(f"compression_format {compression} is not supported", file, advice=advice)
    # File names only: a bag must not refer to files outside its folder.
    files = [path / PurePath(name).name for name in names]
    for name in files:
        if not name.is_file():
            raise InputError(f"relative_file_paths: {quoted(name.name)} does not exist", file)
    return files, str(mode).lower() == "message"


def one_line(error: object) -> str:
    """Return an error message as one short line; it may quote untrusted text."""
    text = " ".join(str(error).split())
    return text if len(text) <= 200 else text[:200] + "..."
