"""Recognition of logs by their first bytes, and the names in those that homeward writes."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from homeward.io.reading import is_there, naming, opened

OUR_HOME = "/homeward/home"
OUR_TRUTH = "/homeward/truth"
OUR_SETTINGS = "/homeward/settings"
OUR_ODOMETRY = "/homeward/odometry"
OUR_BEARINGS = "/homeward/bearings"
"""Topics of the logs that homeward writes."""
ODOMETRY = "homeward_msgs/msg/Odometry"
BEARINGS = "homeward_msgs/msg/Bearings"
POSE = "homeward_msgs/msg/Pose"
METADATA = "metadata.yaml"
"""Metadata file of a ROS 2 bag folder."""
OLDER_ROSBAG = b"#ROSBAG"
LCM = b"\xed\xa1\xda\x01"
"""Beginning of each event in a log of LCM (lcm-proj.github.io, log file format)."""
WPILOG = b"WPILOG"


class Kind(NamedTuple):
    """A kind of log: its reader, its name, and the advice for a damaged file."""

    reader: str
    words: str
    repair: str


KINDS = {
    b"#ROSBAG V2.0\n": Kind("bag", "ROS 1 bag", "repair it with `rosbag reindex FILE`"),
    b"\x89MCAP0\r\n": Kind(
        "mcap",
        "MCAP",
        "recover the messages before the damage with `mcap recover FILE -o NEW.mcap`",
    ),
    b"SQLite format 3\x00": Kind(
        "db3", "ROS 2 bag (sqlite3)", 'recover it with `sqlite3 FILE ".recover" | sqlite3 NEW.db3`'
    ),
    WPILOG: Kind("wpilog", "WPILib data log", "copy it from the robot again"),
}
"""Kinds by the first bytes of a file."""


def is_log(path: Path) -> bool:
    """Whether a path is a log file or the folder of a ROS 2 bag."""
    if path.is_dir():
        return is_there(path / METADATA) or bool(bare_files(path))
    return is_there(path) and first_bytes(path).startswith((*KINDS, OLDER_ROSBAG, LCM))


def first_bytes(path: Path) -> bytes:
    """Return the bytes that identify the kind of a file."""
    with naming(path, "cannot be read"), opened(path) as stream:
        return bytes(stream.read(16))


def bare_files(path: Path) -> list[Path]:
    """Return the files of a bag folder, for one without metadata."""
    with naming(path, "cannot be read"):
        return sorted(f for f in path.iterdir() if f.suffix in (".mcap", ".db3") and f.is_file())
