"""Logs: ROS 1 bags, MCAP and sqlite3 files, and the folders of ROS 2 bags.

The files are read by rosbags, in a process of its own with limits (`log_process`). Nothing here
needs the extra bags.
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
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, NamedTuple

from homeward.errors import InputError
from homeward.io.reading import is_there, naming, opened
from homeward.io.table import quoted

METADATA = "metadata.yaml"
"""Of the folder of a ROS 2 bag."""
_ROOT = "rosbag2_bagfile_information"
_ZSTD = b"\x28\xb5\x2f\xfd"
_OLDER_ROSBAG = b"#ROSBAG"
MAX_UNPACKED = 2**34
"""Of a file that is compressed as a whole, which is unpacked to a temporary one [byte]."""
MIN_UNPACKED, MAX_GROWTH = 256 * 2**20, 100
"""Limits of an unpacked file: the larger of this size [bytes] and this multiple of its own size."""
MIN_MEMORY, MAX_MEMORY, MEMORY_PER_BYTE = 2**31, 2**33, 2
"""Of the process that reads a file [byte]: rosbags keeps the index of all messages in memory."""
MIN_SECONDS, BYTES_PER_SECOND = 10.0, 100_000
"""Processor time for a file: this much, and a second more for so many bytes."""
MIN_MESSAGES = 1_000_000
"""A log may always have so many messages, and one for each byte of its file."""


class _Kind(NamedTuple):
    reader: str
    words: str
    repair: str


_KINDS = {
    b"#ROSBAG V2.0\n": _Kind("bag", "ROS 1 bag", "`rosbag reindex FILE` repairs it"),
    b"\x89MCAP0\r\n": _Kind(
        "mcap", "MCAP", "`mcap recover FILE -o NEW.mcap` saves the messages before the damage"
    ),
    b"SQLite format 3\x00": _Kind(
        "db3",
        "ROS 2 bag (sqlite3)",
        '`sqlite3 FILE ".recover" | sqlite3 NEW.db3` saves what can be read',
    ),
}
"""By the first bytes of a file."""


@dataclass(frozen=True)
class Channel:
    """One topic of one publisher."""

    topic: str
    type: str
    """As in ``nav_msgs/msg/Odometry``."""
    encoding: str
    """``ros1`` or ``cdr``; any other is listed, never decoded."""
    definition: str = ""
    """Text of the message definition; empty when the log has none."""
    syntax: str = "msg"
    """Of the definition: ``msg`` or ``idl``."""


class Message(NamedTuple):
    """One message, not yet decoded."""

    channel: Channel
    receive: int
    """When the recorder received it [ns]."""
    data: bytes


def is_log(path: Path) -> bool:
    """Whether a file begins as a log does, or a folder holds a ROS 2 bag."""
    if path.is_dir():
        return is_there(path / METADATA) or bool(_bare_files(path))
    return is_there(path) and _first_bytes(path).startswith((*_KINDS, _OLDER_ROSBAG))


class Log:
    """A log of any kind, whose messages may be read several times."""

    def __init__(self, path: Path) -> None:
        """Find the files of a log; `InputError` where it is of no known kind."""
        self.path = path
        self.done = 0.0
        """Fraction of the messages read, in [0, 1]."""
        self.cut_short: dict[str, int] = {}
        """Number of messages read from files without an end, by a description of that."""
        if path.is_dir():
            self._files, self._has_packed_messages = _contents(path)
            self.kind = f"ROS 2 bag folder ({len(self._files)} files)"
        else:
            self._files, self._has_packed_messages = [path], False
            self.kind = _kind(path).words

    def messages(
        self, topics: Collection[str] | None = None, prefix: int | None = None
    ) -> Iterator[Message]:
        """Read the messages of each file in order of time: of all topics, or of some.

        Data are cut to a length `prefix` [byte], except for the first message of each channel.
        `InputError` where a file is damaged, or needs more memory or time than a log may.
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
        wanted = None if topics is None else sorted(topics)
        words = (os.path.abspath(file), kind.reader, wanted, prefix, self._has_packed_messages)
        channels: dict[int, Channel] = {}
        count = 0
        for what, *told in self._ask(file, kind.repair, "walk", *words):
            match what:
                case "channels":
                    channels = {n: _channel(*texts) for n, texts in told[0].items()}
                case "messages":
                    batch, self._done_of_file = told
                    count += len(batch)
                    if count > MIN_MESSAGES + size:
                        raise InputError("has more messages than a log of its size can", file)
                    for number, receive, data in batch:
                        yield Message(channels[number], receive, data)
                case "cut":
                    self._remark_cut(file, kind, count, *told)

    def _remark_cut(self, file: Path, kind: _Kind, count: int, at: int, size: int) -> None:
        """Remark how far a file without an end was read; refuse it when that is nowhere."""
        if not count and not self.cut_short:
            raise InputError(f"damaged: no message in it can be read; {kind.repair}", file)
        self.cut_short.setdefault(
            f"messages read from {quoted(file.name)}, which is cut short or was not closed: up to "
            f"byte {at:,} of {size:,}; {kind.repair}",
            count,
        )

    @contextmanager
    def _unpacked(self, file: Path) -> Iterator[Path]:
        """Lend a file as it is, or unpacked when it is compressed as a whole."""
        if not _first_bytes(file).startswith(_ZSTD):
            yield file
            return
        with tempfile.TemporaryDirectory(prefix="homeward-") as folder, _about(file):
            whole = Path(folder) / file.stem
            growth = max(MIN_UNPACKED, MAX_GROWTH * file.stat().st_size)
            room = min(MAX_UNPACKED, growth, shutil.disk_usage(folder).free // 2)
            for _ in self._ask(file, "", "unpack", os.path.abspath(file), str(whole), room):
                pass
            yield whole

    def _ask(
        self, file: Path, repair: str, command: str, *arguments: Any
    ) -> Iterator[tuple[Any, ...]]:
        """Yield the answers of the reading process; a failure is an InputError."""
        process = _lent()
        size = file.stat().st_size
        seconds = MIN_SECONDS + size / BYTES_PER_SECOND
        memory = min(MIN_MEMORY + MEMORY_PER_BYTE * size, MAX_MEMORY)
        request = {"command": command, "arguments": arguments, "seconds": seconds, "memory": memory}
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
            else:  # what it may still write belongs to this request
                _end(process)
        if answer[0] == "damaged":
            way = f"; {repair}" if repair else ""
            raise InputError(f"damaged or cut short: {one_line(answer[1])}{way}", file)
        if answer[0] == "memory":
            raise InputError(
                f"unpacks to more than a log may hold, or needs more than {memory / 2**30:.0f} GiB "
                "of memory; split the recording if it is your own",
                file,
            )
        if answer[0] == "died":
            if process.returncode == -getattr(signal, "SIGXCPU", 0):
                why = f"takes more than {seconds:.0f} s of processor time"
            else:
                why = f"ends the process that reads it (status {process.returncode})"
            raise InputError(f"{why}; split the recording if it is your own", file)


_idle: defaultdict[int, list[subprocess.Popen[bytes]]] = defaultdict(list)
"""Processes that wait for a request, by the process that started them: a fork uses its own."""


@atexit.register
def _end_idle() -> None:
    for process in _idle.pop(os.getpid(), []):
        _end(process)


def _lent() -> subprocess.Popen[bytes]:
    """Return a process that reads files: an idle one, or a new one."""
    idle = _idle[os.getpid()]
    while idle:
        if (process := idle.pop()).poll() is None:
            return process
        _end(process)
    script = Path(__file__).with_name("log_process.py")
    # It finds rosbags where this process does.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    return subprocess.Popen(
        [sys.executable, "-P", str(script)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
    )


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a process that reads files, if it has not ended."""
    for stream in (process.stdout, process.stdin):
        if stream is not None:
            with suppress(BrokenPipeError):
                stream.close()
    if process.poll() is None:
        process.kill()
    process.wait()


def _receive(process: subprocess.Popen[bytes]) -> tuple[Any, ...]:
    """Return the next answer of a process; ``died`` when none comes."""
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
    """Let errors speak of a file of the log, not of its unpacked copy."""
    try:
        with naming(file, "cannot be read"):
            yield
    except InputError as error:
        raise InputError(error.what, file) from error


def _channel(topic: str, kind: str, *rest: str) -> Channel:
    """Return a channel; ROS 1 leaves ``/msg/`` out of the names of types."""
    package, slash, name = kind.partition("/")
    kind = "" if kind == "__schemaless__" else kind
    return Channel(topic, f"{package}/msg/{name}" if slash and "/" not in name else kind, *rest)


def _kind(path: Path) -> _Kind:
    first = _first_bytes(path)
    for magic, kind in _KINDS.items():
        if first.startswith(magic):
            return kind
    if first.startswith(_OLDER_ROSBAG):
        raise InputError("a ROS bag of a format before 2.0; rosbag fix converts it", path)
    raise InputError("neither a ROS bag nor an MCAP file", path)


def _first_bytes(path: Path) -> bytes:
    """Return the bytes that identify the kind of a file."""
    with naming(path, "cannot be read"), opened(path) as stream:
        return bytes(stream.read(16))


def _bare_files(path: Path) -> list[Path]:
    """Return the files of a bag folder whose recorder had no time to write its metadata."""
    with naming(path, "cannot be read"):
        return sorted(f for f in path.iterdir() if f.suffix in (".mcap", ".db3") and f.is_file())


def _contents(path: Path) -> tuple[list[Path], bool]:
    """Return a folder's files in order, and whether their messages are compressed."""
    from homeward.io.settings import read_tree

    file = path / METADATA
    if not is_there(file):
        if not (files := _bare_files(path)):
            raise InputError("no ROS bag and no MCAP file in it", path)
        return files, False
    told = read_tree(file).get(_ROOT)
    if not isinstance(told, dict):
        raise InputError(f"no {_ROOT} in it with keys and values", file)
    names, how = told.get("relative_file_paths"), told.get("compression_mode") or ""
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise InputError("names no files in relative_file_paths", file)
    if how and told.get("compression_format") not in ("zstd", "", None):
        raise InputError(f"compressed by {quoted(str(told['compression_format']))}", file)
    # Names alone: a bag reads nothing outside its own folder.
    files = [path / PurePath(name).name for name in names]
    for name in files:
        if not name.is_file():
            raise InputError(f"names a file that is not there: {quoted(name.name)}", file)
    return files, str(how).lower() == "message"


def one_line(error: object) -> str:
    """Return what an error says as one line of bounded length; it may quote hostile text."""
    text = " ".join(str(error).split())
    return text if len(text) <= 200 else text[:200] + "..."
