"""Cache of compiled code: a folder that only its owner can read and write.

A file's name is the key of what was asked for and the checksum of what is in it, so that one
rename puts both in place at once, and a file that was cut short or exchanged is never loaded.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
from contextlib import suppress
from pathlib import Path


class Cache:
    """A folder of compiled code of one kind.

    It is made when something is first kept; its files' names end in `suffix`.
    """

    def __init__(self, folder: Path, suffix: str = ".so") -> None:
        self.folder, self._suffix = folder, suffix

    def problem(self) -> str | None:
        """Return in words why the folder cannot be trusted or used; None if it can.

        It is made if it is not there.
        """
        try:
            self.folder.parent.mkdir(parents=True, exist_ok=True)
            self.folder.mkdir(mode=0o700, exist_ok=True)
            told = os.lstat(self.folder)
        except OSError as error:
            return f"{self.folder} cannot be made: {error.strerror}"
        if not stat.S_ISDIR(told.st_mode):
            return f"{self.folder} is no folder"
        if hasattr(os, "getuid"):
            if told.st_uid != os.getuid():
                return f"{self.folder} belongs to another user"
            if stat.S_IMODE(told.st_mode) & 0o077:
                return f"{self.folder} is open to other users (chmod 700 it)"
        if not os.access(self.folder, os.W_OK):
            return f"{self.folder} cannot be written"
        return None

    def find(self, key: str) -> Path | None:
        """Return the file kept under a key, or None; files that are not what they were go."""
        for file in sorted(self.folder.glob(f"{key}-*{self._suffix}")):
            if file.stem == f"{key}-{_checksum(file)}":
                return file
            with suppress(OSError):
                file.unlink()
        return None

    def keep(self, key: str, file: Path) -> Path:
        """Move a file of the same file system into the folder, in one step; return where it is."""
        place = self.folder / f"{key}-{_checksum(file)}{self._suffix}"
        os.replace(file, place)
        return place


def default_folder() -> Path:
    """Return homeward's folder in the user's cache folder, by the rule of the platform."""
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA", "")
        other = Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base, other = os.environ.get("XDG_CACHE_HOME", ""), Path.home() / "Library" / "Caches"
    else:
        base, other = os.environ.get("XDG_CACHE_HOME", ""), Path.home() / ".cache"
    # The XDG rule: a relative path is to be ignored.
    return (Path(base) if os.path.isabs(base) else other) / "homeward"


def key_of(*parts: str) -> str:
    """Return a key for everything that decides what a file holds."""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


def _checksum(file: Path) -> str:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return ""
