"""Tables without a header whose columns are known from their structure: TUM, and ROS 2 as CSV."""

from __future__ import annotations

import math
from collections.abc import Sequence

STAMP = ("stamp.sec", "stamp.nanosec", "frame")
XYZ, XYZW = "xyz", "xyzw"
POSE = (*(f"position.{a}" for a in XYZ), *(f"orientation.{a}" for a in XYZW))
TWIST = (*(f"linear.{a}" for a in XYZ), *(f"angular.{a}" for a in XYZ))
COVARIANCE = tuple(f"covariance.{k}" for k in range(36))
TUM = ("t", "x", "y", "z", *(f"q{a}" for a in XYZW))
"""The columns of a TUM trajectory, as evo and others write it."""
ECHOED = {
    len(names): names
    for names in (
        (*STAMP, "child_frame", *POSE, *COVARIANCE, *TWIST, *COVARIANCE),  # nav_msgs/Odometry
        (*STAMP, *POSE),
        (*STAMP, *POSE, *COVARIANCE),
        (*STAMP, *TWIST),
        (*STAMP, *TWIST, *COVARIANCE),
    )
}
"""The columns of stamped poses and twists as ``ros2 topic echo --csv`` prints them, by number."""
UNIT_NORM = 0.01
"""Largest deviation of a quaternion's norm from 1; two digits in a file leave half of it."""


def layout(rows: Sequence[Sequence[str]]) -> tuple[str, ...] | None:
    """Return the names of the columns of a table without a header, from its first rows.

    None where they are of no known layout.
    """
    width = len(rows[0])
    if width == len(TUM) and all(map(_is_tum, rows)):
        return TUM
    return ECHOED[width] if width in ECHOED and all(map(_is_stamped, rows)) else None


def _is_tum(cells: Sequence[str]) -> bool:
    """Whether a row ends in a unit quaternion, and all of it is numbers."""
    try:
        numbers = [float(cell) for cell in cells]
    except ValueError:
        return False
    return len(numbers) == len(TUM) and abs(math.hypot(*numbers[4:]) - 1.0) <= UNIT_NORM


def _is_stamped(cells: Sequence[str]) -> bool:
    """Whether a row begins with seconds, nanoseconds and the name of a frame."""
    if len(cells) not in ECHOED:
        return False
    seconds, nanoseconds, frame = (cell.strip() for cell in cells[:3])
    whole = seconds.isdecimal() and nanoseconds.isdecimal()
    return whole and int(nanoseconds) < 10**9 and not frame.replace(".", "").isdecimal()
