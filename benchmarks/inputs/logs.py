"""ROS 1 and ROS 2 logs, with home bearings in a home.csv."""

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
) -> Content:
    """Return a writer of a log with odometry.

    `tags` makes the messages of a frame from its stamp [ns] and landmarks; `types` has the
    definitions of types by name.
    """

    def write(path: Path) -> None:
        with writing(path) as log:
            for name, text in (types or {}).items():
                if name not in log._store.fielddefs:
                    log._store.register(get_types_from_msg(text, name))
            frames = [(t, seen[seen.t == t]) for t in np.unique(seen.t)]
            rows: list[tuple[float, Any]] = [*frames, *((t, k) for k, t in enumerate(s.t))]
            for t, row in sorted(rows, key=lambda r: r[0]):
                stamp = EPOCH * NANO + round(t * NANO)
                made = (
                    tags(log, stamp, row)
                    if isinstance(row, Seen)
                    else {"/odom": nav(log, stamp, s, row)}
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


PART = "\n" + 80 * "=" + "\nMSG: "
"""Precedes the definition of a type that another one uses."""
DEFINITIONS = {
    "aruco_opencv_msgs/msg/ArucoDetection": "std_msgs/Header header\n"
    "aruco_opencv_msgs/MarkerPose[] markers\naruco_opencv_msgs/BoardPose[] boards"
    f"{PART}aruco_opencv_msgs/MarkerPose\nint32 marker_id\ngeometry_msgs/Pose pose"
    f"{PART}aruco_opencv_msgs/BoardPose\nstring board_name\ngeometry_msgs/Pose pose\n",
    "ros2_aruco_interfaces/msg/ArucoMarkers": "std_msgs/Header header\nint64[] marker_ids\n"
    "geometry_msgs/Pose[] poses\n",
    "aruco_msgs/msg/MarkerArray": "std_msgs/Header header\naruco_msgs/Marker[] markers"
    f"{PART}aruco_msgs/Marker\nstd_msgs/Header header\nuint32 id\n"
    "geometry_msgs/PoseWithCovariance pose\nfloat64 confidence\n",
    "fiducial_msgs/msg/FiducialTransformArray": "std_msgs/Header header\nint32 image_seq\n"
    "fiducial_msgs/FiducialTransform[] transforms"
    f"{PART}fiducial_msgs/FiducialTransform\nint32 fiducial_id\n"
    "geometry_msgs/Transform transform\nfloat64 image_error\nfloat64 object_error\n"
    "float64 fiducial_area\n",
}
"""Definitions of types that rosbags does not know."""


def tag_messages(
    name: str,
    file: str,
    topic: str,
    fields: Callable[[Seen, Any], dict[str, Any]],
) -> None:
    """Register a log with messages of a type; `fields` makes one from landmarks and a header."""
    package, kind_ = name.split("/")
    name = f"{package}/msg/{kind_}"
    types = {name: DEFINITIONS[name]} if name in DEFINITIONS else {}

    def files(s: Sample) -> Files:
        def tags(log: LogFile, stamp: int, seen: Seen) -> Messages:
            header = log.header(stamp, OPTICAL)
            own = {"header": header} if "header" in dict(log._store.fielddefs[name][1]) else {}
            return {topic: log.make(name, **own, **fields(seen, header))}

        return {file: log_of(s, s.seen.ahead, tags, types), "topics.yaml": HOME}

    kind(f"{package}/{kind_}, {Path(file).suffix}", f"run {file} --topics topics.yaml")(files)


tag_messages(
    "aruco_opencv_msgs/ArucoDetection",
    "log.mcap",
    "/aruco_detections",
    lambda seen, h: {"markers": [{"marker_id": i, "pose": p} for i, p in optical(seen)]},
)
tag_messages(
    "ros2_aruco_interfaces/ArucoMarkers",
    "log.db3",
    "/aruco_markers",
    lambda seen, h: {"marker_ids": seen.id, "poses": [p for _, p in optical(seen)]},
)
tag_messages(
    "aruco_msgs/MarkerArray",
    "log.bag",
    "/aruco_marker_publisher/markers",
    lambda seen, h: {
        "markers": [
            {"id": i, "pose": {"pose": p, "covariance": np.zeros(36)}} for i, p in optical(seen)
        ]
    },
)
tag_messages(
    "apriltag_ros/AprilTagDetectionArray",
    "log.bag",
    "/tag_detections",
    lambda seen, h: {
        "detections": [
            {
                "id": np.array([i], np.int32),
                "size": np.array([0.16]),
                "pose": {"header": h, "pose": {"pose": p, "covariance": np.zeros(36)}},
            }
            for i, p in optical(seen)
        ]
    },
)
tag_messages(
    "fiducial_msgs/FiducialTransformArray",
    "log.bag",
    "/fiducial_transforms",
    lambda seen, h: {
        "transforms": [
            {
                "fiducial_id": i,
                "transform": {"translation": p["position"], "rotation": p["orientation"]},
            }
            for i, p in optical(seen)
        ]
    },
)


def tag_list(log: LogFile, stamp: int, seen: Seen, frame: str = OPTICAL) -> Any:
    """Return a message of a type of one's own."""
    tags = [log.make("my_msgs/msg/Tag", tag_id=i, pose=pose) for i, pose in optical(seen)]
    return log.make("my_msgs/msg/TagList", header=log.header(stamp, frame), tags=tags)


TAG_LIST = {
    "my_msgs/msg/Tag": "int32 tag_id\nfloat32 margin\ngeometry_msgs/Pose pose\n",
    "my_msgs/msg/TagList": "std_msgs/Header header\nmy_msgs/Tag[] tags\n",
}


@kind("positions in a type of one's own", "run log.mcap --topics topics.yaml")
def _(s: Sample) -> Files:
    def tags(log: LogFile, stamp: int, seen: Seen) -> Messages:
        return {"/tags": tag_list(log, stamp, seen)}

    return {"log.mcap": log_of(s, s.seen.ahead, tags, TAG_LIST), "topics.yaml": HOME}
