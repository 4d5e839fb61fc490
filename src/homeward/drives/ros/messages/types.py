"""Message types with a definition in the package, for writing, and for logs without definitions."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

WELL_KNOWN = {
    f"{file.parent.name}/msg/{file.stem}": file.read_text("utf-8")
    for file in sorted(Path(__file__).with_name("msg").glob("*/*.msg"))
}
"""Definitions by type; sqlite3 files of ROS 2 before Iron contain none."""
DEFINITIONS = {kind: text for kind, text in WELL_KNOWN.items() if kind.startswith("homeward_msgs/")}
"""Those of `homeward_msgs`, which represent a drive exactly.

`residue` is the part of a time [s] that a stamp in whole nanoseconds cannot represent.
"""


@cache
def typestore(ros1: bool) -> Any:
    """Return rosbags' store of all known types, as in ROS 1 Noetic or ROS 2 Humble."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name, text in WELL_KNOWN.items():
        store.register(get_types_from_msg(text, name))
    return store
