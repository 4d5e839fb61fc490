"""ROS 2 bag folders: metadata.yaml, and one or several files of messages."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath
from typing import Any

from homeward.drives.ros.containers.container import (
    Budget,
    Log,
    Message,
    Unpacker,
    in_short,
    walking,
    zstd,
)
from homeward.drives.ros.containers.magic import (
    MCAP,
    METADATA,
    OLDER_ROSBAG,
    ROSBAG1,
    SQLITE,
    bare_files,
    first_bytes,
)
from homeward.drives.ros.containers.mcap import Mcap
from homeward.drives.ros.containers.rosbag1 import Rosbag1
from homeward.drives.ros.containers.sqlite import Sqlite
from homeward.drives.text.files import is_there, opened
from homeward.drives.text.settings import read_tree
from homeward.drives.text.table import quoted
from homeward.errors import InputError

_ROOT = "rosbag2_bagfile_information"
LARGEST_UNPACKED = 2**34
"""Of a file that was compressed as a whole; it is unpacked to a temporary one [byte]."""

_KINDS: dict[bytes, Callable[[Path], Log]] = {
    ROSBAG1: Rosbag1,
    MCAP: Mcap,
    SQLITE: Sqlite,
}
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def open_log(path: Path) -> Log:
    """Return the log at `path`, by what is in it.

    Raises
    ------
    InputError
        When it is none that is known.
    """
    if path.is_dir():
        return BagFolder(path)
    first = first_bytes(path)
    for magic, kind in _KINDS.items():
        if first.startswith(magic):
            return kind(path)
    if first.startswith(OLDER_ROSBAG):
        raise InputError("a ROS bag of a format before 2.0; rosbag fix converts it", path)
    raise InputError("neither a ROS bag nor an MCAP file", path)


class BagFolder:
    """A ROS 2 bag of one or several files."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.done = 0.0
        self._files, self._packed_messages = _contents(path)
        self.kind = f"ROS 2 bag folder ({len(self._files)} files)"

    def messages(self) -> Iterator[Message]:
        """Walk the messages of all files; see `Log`."""
        for number, file in enumerate(self._files):
            with walking(file), _unpacked(file) as whole:
                log = open_log(whole)
                unpacker = Unpacker(Budget(whole))
                for channel, receive, data in log.messages():
                    self.done = (number + log.done) / len(self._files)
                    if self._packed_messages:
                        data = _message(unpacker, bytes(data), file)
                    yield Message(channel, receive, data)


def _contents(path: Path) -> tuple[list[Path], bool]:
    """Return a folder's files in order, and whether their messages are compressed."""
    file = path / METADATA
    if not is_there(file):
        if not (files := bare_files(path)):
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


@contextmanager
def _unpacked(file: Path) -> Iterator[Path]:
    """Lend a file as it is, or unpacked when it was compressed as a whole."""
    if not first_bytes(file).startswith(_ZSTD_MAGIC):
        yield file
        return
    with tempfile.TemporaryDirectory(prefix="homeward-") as folder:
        whole = Path(folder) / file.stem
        try:
            with opened(file) as stream, zstd.open(stream, "rb") as packed, whole.open("wb") as out:
                _copy(packed, out, file)
        except (zstd.ZstdError, EOFError) as error:
            raise InputError(f"damaged: {in_short(error)}", file) from error
        try:
            yield whole
        except InputError as error:
            raise InputError(error.what, file) from error


def _copy(packed: Any, out: Any, file: Path) -> None:
    """Copy to a file, no more than a log may hold nor than the disk has room for."""
    room = min(LARGEST_UNPACKED, shutil.disk_usage(Path(out.name).parent).free // 2)
    budget = Budget(file)
    while block := packed.read(2**20):
        room -= len(block)
        budget.unpacked(len(block))
        if room < 0:
            raise InputError("unpacks to more than a log may hold", file)
        out.write(block)


def _message(unpacker: Unpacker, data: bytes, file: Path) -> bytes:
    try:
        return unpacker.unpack_whole(data)
    except zstd.ZstdError as error:
        raise InputError(f"a message is not zstd: {in_short(error)}", file) from error
