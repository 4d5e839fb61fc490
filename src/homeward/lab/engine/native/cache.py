"""Cache of compiled code: a folder that only its owner can read and write.

A file's name consists of the key of its source and the checksum of its content, so that one rename
puts both in place at once, and a truncated or replaced file is never loaded.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
from contextlib import suppress
from pathlib import Path


class Cache:
    """Folder of compiled code, which is created when needed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def problem(self) -> str | None:
        """Create the folder if needed; return the reason why it cannot be used, or None."""
        try:
            self.folder.parent.mkdir(parents=True, exist_ok=True)
            self.folder.mkdir(mode=0o700, exist_ok=True)
            status = os.lstat(self.folder)
        except OSError as error:
            return f"{self.folder} cannot be created: {error.strerror}"
        if not stat.S_ISDIR(status.st_mode):
            return f"{self.folder} is not a folder"
        if hasattr(os, "getuid"):
            if status.st_uid != os.getuid():
                return f"{self.folder} belongs to another user"
            if stat.S_IMODE(status.st_mode) & 0o077:
                return f"{self.folder} is accessible to other users (run chmod 700 on it)"
        if not os.access(self.folder, os.W_OK):
            return f"{self.folder} cannot be written"
        return None

    def find(self, key: str) -> Path | None:
        """Return the file of a key, or None; delete its files with a wrong checksum."""
        for file in sorted(self.folder.glob(f"{key}-*.so")):
            if file.stem == f"{key}-{_checksum(file)}":
                return file
            with suppress(OSError):
                file.unlink()
        return None

    def keep(self, key: str, file: Path) -> Path:
        """Move a file of the same file system into the folder atomically; return its new path."""
        kept = self.folder / f"{key}-{_checksum(file)}.so"
        os.replace(file, kept)
        return kept


def default_folder() -> Path:
    """Return homeward's folder in the user's cache folder, as the platform defines it."""
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA", "")
        other = Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base, other = os.environ.get("XDG_CACHE_HOME", ""), Path.home() / "Library" / "Caches"
    else:
        base, other = os.environ.get("XDG_CACHE_HOME", ""), Path.home() / ".cache"
    # The XDG specification requires that relative paths are ignored.
    return (Path(base) if os.path.isabs(base) else other) / "homeward"


def key_of(*parts: str) -> str:
    """Return the key of everything that determines the content of a file."""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


def _checksum(file: Path) -> str:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return ""
