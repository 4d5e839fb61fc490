"""The message types that homeward reads and writes beside those that rosbags knows.

`homeward_msgs` holds a drive to the last bit. Its stamps are whole nanoseconds, as everywhere in
ROS; `residue` is what a stamp cannot hold of a time in seconds, and 0, as a message begins, where
there is nothing of the kind.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore


def _told(package: str) -> dict[str, str]:
    """Return the .msg files of a package, by the names of their types."""
    folder = Path(str(files("homeward.drives.ros.messages").joinpath("msg", package)))
    return {f"{package}/msg/{f.stem}": f.read_text("utf-8") for f in sorted(folder.glob("*.msg"))}


DEFINITIONS = _told("homeward_msgs")
"""The types of `homeward_msgs`, with their .msg files."""
_WELL_KNOWN = _told("vision_msgs") | _told("apriltag_msgs") | _told("apriltag_ros")
"""For logs that hold no definitions, as those of ROS 2 before Iron in sqlite3."""


@cache
def typestore(ros1: bool) -> Any:
    """Return rosbags' store of every type known here, as ROS 1 Noetic or ROS 2 Humble has them."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name, text in {**DEFINITIONS, **_WELL_KNOWN}.items():
        store.register(get_types_from_msg(text, name))
    return store
