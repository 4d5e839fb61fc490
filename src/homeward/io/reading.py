"""Files that others wrote, opened with care: regular ones alone, whatever the name stands for."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import IO, Any

from homeward.errors import InputError


def opened(path: Path, mode: str = "rb", **options: Any) -> IO[Any]:
    """Open a regular file to read, as the built-in `open` does; refuse what is none (InputError).

    The open file is tested, so that nothing can be put in its place meanwhile; and opening never
    waits, as it would for somebody to write into a FIFO.
    """
    return open(path, mode, opener=_regular, **options)


def read_small(path: Path, largest: int, what: str) -> bytes:
    """Return the content of a regular file of at most `largest` bytes, as `what`, in words, has."""
    with naming(path, "cannot be read"), opened(path) as stream:
        data: bytes = stream.read(largest + 1)
    if len(data) > largest:
        raise InputError(f"larger than {what} may be, {largest / 2**20:g} MiB", path)
    return data


def is_there(path: Path) -> bool:
    """Whether anything has that name, also a link that leads nowhere: reading it says why."""
    return os.path.lexists(path)


@contextmanager
def naming(path: Path, trouble: str) -> Iterator[None]:
    """Make an InputError of whatever the system says about `path`."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{trouble}: {error.strerror or error}", path) from error


def shipped(*names: str) -> Path:
    """Return a file or folder of the data that come with homeward."""
    return Path(str(files("homeward").joinpath("data", *names)))


def shipped_yaml(folder: str) -> dict[str, Path]:
    """Return the YAML files of a folder of those data, by name."""
    return {file.stem: file for file in sorted(shipped(folder).glob("*.yaml"))}


def require_folder(path: Path) -> None:
    """Raise InputError when `path` is not a folder that can be looked into."""
    with naming(path, "cannot be read"):
        if not path.is_dir():
            raise InputError("not a folder" if is_there(path) else "no such folder", path)
        next(path.iterdir(), None)


def _regular(path: str, flags: int) -> int:
    """Open for `open`; Windows has neither FIFOs nor these flags."""
    flags |= getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
    descriptor = os.open(path, flags)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise InputError("not a regular file", Path(path))
    return descriptor
