"""Safe reading of untrusted files: only regular files, of limited size."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import IO, Any

from homeward.errors import InputError


def opened(path: Path, mode: str = "rb", **options: Any) -> IO[Any]:
    """Open a regular file for reading, as the built-in `open` does; `InputError` for any other.

    The test is on the open descriptor, so that the file cannot be replaced in between. Opening a
    FIFO does not block.
    """
    return open(path, mode, opener=_regular, **options)


def read_small(path: Path, max_size: int, what: str) -> bytes:
    """Return the content of a regular file of at most `max_size` bytes; `what` is its content."""
    with naming(path, "cannot be read"), opened(path) as stream:
        data: bytes = stream.read(max_size + 1)
    if len(data) > max_size:
        raise InputError(f"too large for {what}: more than {max_size / 2**20:g} MiB", path)
    return data


def is_there(path: Path) -> bool:
    """Whether a path exists; also True for a broken link, which then gives an error when read."""
    return os.path.lexists(path)


@contextmanager
def naming(path: Path, trouble: str) -> Iterator[None]:
    """Convert an OSError about `path` to an InputError."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{trouble}: {error.strerror or error}", path) from error


def shipped(*names: str) -> Path:
    """Return a file or folder of the package data."""
    return Path(str(files("homeward").joinpath("data", *names)))


def shipped_yaml(folder: str) -> dict[str, Path]:
    """Return the YAML files of a folder of the package data, by name."""
    return {file.stem: file for file in sorted(shipped(folder).glob("*.yaml"))}


def shipped_or_file(source: str, kind: str, names: Iterable[str] = ()) -> Path:
    """Return the path of a YAML file: one of `shipped_yaml(kind)` by name, or the user's.

    Callers that resolve names themselves pass them as `names`, for the message of the `InputError`.
    """
    files = shipped_yaml(kind)
    path = files.get(source, Path(source))
    if not source or not is_there(path):
        known = ", ".join((*names, *files))
        raise InputError(f"neither a file nor one of the {kind}: {known}", path if source else None)
    return path


def require_folder(path: Path) -> None:
    """Raise InputError when `path` is not a readable folder."""
    with naming(path, "cannot be read"):
        if not path.is_dir():
            raise InputError("not a folder" if is_there(path) else "no such folder", path)
        next(path.iterdir(), None)


def _regular(path: str, flags: int) -> int:
    """Open a regular file for `open`; Windows has neither FIFOs nor these flags."""
    flags |= getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
    descriptor = os.open(path, flags)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise InputError("not a regular file", Path(path))
    return descriptor
