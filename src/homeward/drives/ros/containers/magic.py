"""How logs begin: whether a path is one at all, told without what reads them (the extra bags)."""

from __future__ import annotations

from pathlib import Path

from homeward.drives.text.files import is_there, naming, opened

ROSBAG1 = b"#ROSBAG V2.0\n"
MCAP = b"\x89MCAP0\r\n"
SQLITE = b"SQLite format 3\x00"
OLDER_ROSBAG = b"#ROSBAG"
METADATA = "metadata.yaml"
"""Of the folder of a ROS 2 bag."""


def is_log(path: Path) -> bool:
    """Whether a file begins as a log does, or a folder holds a ROS 2 bag."""
    if path.is_dir():
        return is_there(path / METADATA) or bool(bare_files(path))
    return is_there(path) and first_bytes(path).startswith((ROSBAG1, MCAP, SQLITE, OLDER_ROSBAG))


def first_bytes(path: Path) -> bytes:
    """Return the bytes that tell what a file is."""
    with naming(path, "cannot be read"), opened(path) as stream:
        return bytes(stream.read(16))


def bare_files(path: Path) -> list[Path]:
    """Return the files of a bag folder whose recorder had no time to write its metadata."""
    with naming(path, "cannot be read"):
        return sorted(f for f in path.iterdir() if f.suffix in (".mcap", ".db3") and f.is_file())
