"""Atomic and durable writing of files and folders.

They are written in a scratch folder on the file system of their destination, synchronised to disk,
and then renamed. A killed process leaves at most that scratch folder, which the next process that
writes there deletes: a process locks its scratch folders, and the lock ends with the process.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
import sys
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from homeward.errors import InputError
from homeward.io.reading import is_there, naming

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

SCRATCH = ".writing-"
"""Prefix of the names of scratch folders."""
_SCRATCH_NAME = re.compile(re.escape(SCRATCH) + "[0-9a-f]{16}")
UNLOCKED_TIMEOUT_S = 3600.0
"""Where folders cannot be locked, scratch folders of this age are left over [s]."""
MAX_SYNCED = 200
"""Number of files that are synchronised one by one; more are synchronised with the whole system."""
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_CANNOT_WRITE = (*_FULL, errno.EIO, errno.EBADF)
_CANNOT_SYNC = (errno.EINVAL, errno.ENOTSUP, errno.EBADF)
_checked: set[str] = set()
"""Folders in which this process has looked for abandoned scratch folders."""


def is_of_stdout(error: OSError) -> bool:
    """Whether an error that no other function has handled is of a write to standard output."""
    return error.filename is None and error.errno in _CANNOT_WRITE


def stdout_error(error: OSError) -> InputError:
    """Return the error of a standard output that cannot be written, and discard what follows."""
    with open(os.devnull, "w") as nowhere:  # for the rest of the buffer
        os.dup2(nowhere.fileno(), sys.stdout.fileno())
    advice = "free space there or choose another destination" if error.errno in _FULL else None
    return InputError(f"cannot be written: {error.strerror}", part="standard output", advice=advice)


def state_folder() -> Path:
    """Return the folder of what outlasts a process on this machine."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "homeward"


@contextmanager
def scratch_folder(parent: Path) -> Iterator[Path]:
    """Make a folder in `parent` with the usual permissions; delete it at the end unless renamed.

    The first time, scratch folders that killed processes have left in `parent` are deleted.
    """
    new = [folder for folder in (parent, *parent.parents) if not folder.exists()]
    parent.mkdir(parents=True, exist_ok=True)
    for folder in reversed(new):
        sync_folder(folder.parent)
    if (place := os.path.abspath(parent)) not in _checked:
        _checked.add(place)
        remove_abandoned(parent)
    scratch, lock = _locked_folder(parent)
    try:
        yield scratch
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def remove_abandoned(parent: Path) -> None:
    """Delete scratch folders of processes that were killed; those of live processes stay."""
    with suppress(OSError):
        for name in os.listdir(parent):
            if _SCRATCH_NAME.fullmatch(name):
                _remove_if_abandoned(parent / name)


def _remove_if_abandoned(scratch: Path) -> None:
    with suppress(OSError):  # locked by its process, finished meanwhile, or not accessible
        lock = _lock(scratch)
        try:
            if lock is not None or time.time() - scratch.stat().st_mtime > UNLOCKED_TIMEOUT_S:
                shutil.rmtree(scratch, ignore_errors=True)
        finally:
            if lock is not None:
                os.close(lock)


def _locked_folder(parent: Path) -> tuple[Path, int | None]:
    """Make a scratch folder; return it with its lock, or None where folders cannot be locked."""
    while True:
        scratch = parent / f"{SCRATCH}{secrets.token_hex(8)}"
        scratch.mkdir()
        # Before it is locked, another process may consider it abandoned, and delete it.
        with suppress(BlockingIOError, FileNotFoundError):
            lock = _lock(scratch)
            if lock is None or scratch.exists():
                return scratch, lock
            os.close(lock)


def _lock(folder: Path) -> int | None:
    """Lock a folder until its descriptor is closed; None where the platform cannot.

    `BlockingIOError` where another process has locked it.
    """
    if fcntl is None:
        return None
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except PermissionError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        if isinstance(error, BlockingIOError):
            raise
        return None  # some network file systems
    return descriptor


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield the path of a new file that replaces `path` when the block ends without an error.

    The file is on disk before it replaces the old one, and its name when the block has ended.
    """
    with scratch_folder(path.parent) as scratch:
        yield (new := scratch / path.name)
        sync(new)
        os.replace(new, path)
        sync_folder(path.parent)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file atomically; `InputError` where it cannot be written."""
    with naming(path, "cannot be written"), whole_file(path) as new:
        new.write_bytes(content)


def check_output(directory: Path, marker: str) -> None:
    """Refuse an output folder that has files, but not the `marker` file of earlier output.

    The folder may not exist yet. `InputError` also where it is not a folder, not writable or has a
    name that is too long, before a long computation.
    """
    with naming(directory, "cannot be written"), suppress(FileNotFoundError, NotADirectoryError):
        os.lstat(directory)
    existing = next(p for p in (directory, *directory.absolute().parents) if is_there(p))
    if not existing.is_dir():
        raise InputError("is not a folder", existing, advice="choose another output folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError("is not writable", existing, advice="choose another output folder")
    if existing != directory:
        return
    names = {p.name for p in directory.iterdir() if not p.name.startswith(SCRATCH)}
    if names and marker not in names:
        problem = f"contains other files and no {marker} of earlier output"
        raise InputError(problem, directory, advice="choose another output folder")


@contextmanager
def whole_folder(
    folder: Path, marker: str | None = None, merge: bool = False, owned: Collection[str] = ()
) -> Iterator[Path]:
    """Yield a scratch folder whose entries move to `folder` when the block ends without an error.

    A new folder appears by one rename. In an existing one, entries of the same names are replaced.
    The `marker` file moves last, so a folder that has it is complete, also after a power cut. By
    default a new subfolder replaces the old one; with `merge`, other files in subfolders stay.
    Files of an existing folder that are `owned` and not replaced are deleted. `InputError` as
    `check_output`, if there is a marker, or where the folder cannot be written.
    """
    with naming(folder, "cannot be written"):
        if marker is not None:
            check_output(folder, marker)
        new = not is_there(folder)
        # Inside an existing folder, since its parent may be on another file system.
        with scratch_folder(folder.parent if new else folder) as scratch:
            yield scratch
            inner = _sync_tree(scratch)
            if new:
                scratch.rename(folder)
                sync_folder(folder.parent)
                return
            entries = sorted(scratch.iterdir(), key=lambda entry: entry.name == marker)
            for entry in entries:
                place = folder / entry.name
                if entry.name == marker:
                    sync_folder(folder)
                if merge and entry.is_dir():
                    shutil.copytree(entry, place, copy_function=os.replace, dirs_exist_ok=True)
                    continue
                if place.is_dir() and not place.is_symlink():
                    shutil.rmtree(place)
                os.replace(entry, place)
            for name in set(owned) - {entry.name for entry in entries}:
                (folder / name).unlink(missing_ok=True)
            for name in inner:  # with `merge`, files have moved into subfolders
                sync_folder(folder / name)
            sync_folder(folder)


def sync(path: Path) -> None:
    """Wait until a file is on disk."""
    descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(folder: Path) -> None:
    """Wait until the entries of a folder are on disk, where the platform can."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:  # Windows, or a folder that cannot be read
        return
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _CANNOT_SYNC:
            raise
    finally:
        os.close(descriptor)


def _sync_tree(folder: Path) -> list[str]:
    """Wait until everything in a folder is on disk; return the relative paths of its subfolders."""
    files, folders = [], []
    for root, _, names in os.walk(folder):
        folders.append(Path(root))
        files += [file for name in names if not (file := Path(root) / name).is_symlink()]
    if len(files) > MAX_SYNCED and hasattr(os, "sync"):
        os.sync()
    else:
        for file in files:
            sync(file)
    for inner in reversed(folders):
        sync_folder(inner)
    return [str(inner.relative_to(folder)) for inner in folders if inner != folder]
