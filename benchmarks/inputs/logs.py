"""ROS 1 and ROS 2 logs, with home bearings in a home.csv."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import get_types_from_msg

from benchmarks.inputs.kinds import EPOCH, Content, Files, Sample, Seen, kind
from homeward.drives.ros.messages.stamps import NANO
from homeward.drives.ros.writing import LogFile, writing

Messages = Mapping[str, Any]
"""Messages by topic."""
HOME = "home: {csv: home.csv}\n"
OPTICAL = "camera_optical_frame"


def log_of(
    s: Sample,
    seen: Seen,
    tags: Callable[[LogFile, int, Seen], Messages],
    types: Mapping[str, str] | None = None,
    odometry: Callable[[LogFile, int, int], Messages] | None = None,
    first: Callable[[LogFile, int], Messages] = lambda log, stamp: {},
) -> Content:
    """Return a writer of a log.

    `tags` makes the messages of a frame from its stamp [ns] and landmarks, `odometry` those of a
    number of `s.t`, `first` those at the start; `types` has the definitions of types by name.
    """
    twists = odometry or (lambda log, stamp, k: {"/odom": nav(log, stamp, s, k)})

    def write(path: Path) -> None:
        with writing(path) as log:
            for name, text in (types or {}).items():
                if name not in log._store.fielddefs:
                    log._store.register(get_types_from_msg(text, name))
            frames = [(t, seen[seen.t == t]) for t in np.unique(seen.t)]
            rows: list[tuple[float, Any]] = [*frames, *((t, k) for k, t in enumerate(s.t))]
            rows.append((0.0, None))
            for t, row in sorted(rows, key=lambda r: (r[0], r[1] is not None)):
                stamp = EPOCH * NANO + round(t * NANO)
                made = (
                    first(log, stamp)
                    if row is None
                    else tags(log, stamp, row)
                    if isinstance(row, Seen)
                    else twists(log, stamp, row)
                )
                for topic, message in made.items():
                    log.write(topic, stamp, message)

    return write


def nav(log: LogFile, stamp: int, s: Sample, k: int) -> Any:
    """Return a nav_msgs/Odometry with the pose and the twist of number `k`."""
    half, zeros = s.path.heading[k] / 2, np.zeros(36)
    turn = {"x": 0.0, "y": 0.0, "z": float(np.sin(half)), "w": float(np.cos(half))}
    place = {"x": float(s.path.x[k]), "y": float(s.path.y[k]), "z": 0.0}
    twist = {"linear": {"x": float(s.v[k])}, "angular": {"z": float(s.omega[k])}}
    return log.make(
        "nav_msgs/msg/Odometry",
        header=log.header(stamp, "odom"),
        child_frame_id="base_link",
        pose={"pose": {"position": place, "orientation": turn}, "covariance": zeros},
        twist={"twist": twist, "covariance": zeros},
    )


def optical(seen: Seen) -> list[tuple[str, dict[str, Any]]]:
    """Return the ids and poses of tags in an optical frame."""
    rows = zip(seen.id.tolist(), (-seen.left).tolist(), seen.forward.tolist(), strict=True)
    turn = {"x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0}
    return [
        (i, {"position": {"x": x, "y": -0.3 - 0.01 * i, "z": z}, "orientation": turn})
        for i, x, z in rows
    ]


ARUCO_OPENCV = {
    "aruco_opencv_msgs/msg/MarkerPose": "int32 marker_id\ngeometry_msgs/Pose pose\n",
    "aruco_opencv_msgs/msg/BoardPose": "string board_name\ngeometry_msgs/Pose pose\n",
    "aruco_opencv_msgs/msg/ArucoDetection": "std_msgs/Header header\n"
    "aruco_opencv_msgs/MarkerPose[] markers\naruco_opencv_msgs/BoardPose[] boards\n",
}


@kind("aruco_opencv in an MCAP file", "run log.mcap --topics topics.yaml")
def _(s: Sample) -> Files:
    def tags(log: LogFile, stamp: int, seen: Seen) -> Messages:
        make, header = log.make, log.header(stamp, OPTICAL)
        found = [
            make("aruco_opencv_msgs/msg/MarkerPose", marker_id=i, pose=pose)
            for i, pose in optical(seen)
        ]
        kind = "aruco_opencv_msgs/msg/ArucoDetection"
        return {"/aruco_detections": make(kind, header=header, markers=found, boards=[])}

    return {"log.mcap": log_of(s, s.seen.ahead, tags, ARUCO_OPENCV), "topics.yaml": HOME}
