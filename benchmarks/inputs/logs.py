"""ROS 1 and ROS 2 logs, with home bearings in a home.csv."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import get_types_from_msg

from benchmarks.inputs.kinds import EPOCH, Content, Files, Sample, Seen, kind
from homeward.drives.ros.stamps import NANO
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
                match row:
                    case None:
                        made = first(log, stamp)
                    case Seen():
                        made = tags(log, stamp, row)
                    case _:
                        made = twists(log, stamp, row)
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
    "ar_track_alvar_msgs/msg/AlvarMarkers": "std_msgs/Header header\n"
    "ar_track_alvar_msgs/AlvarMarker[] markers"
    f"{PART}ar_track_alvar_msgs/AlvarMarker\nstd_msgs/Header header\nuint32 id\n"
    "uint32 confidence\ngeometry_msgs/PoseStamped pose\n",
    "apriltags_ros/msg/AprilTagDetectionArray": "apriltags_ros/AprilTagDetection[] detections"
    f"{PART}apriltags_ros/AprilTagDetection\nint32 id\nfloat64 size\n"
    "geometry_msgs/PoseStamped pose\n",
    "fiducial_msgs/msg/FiducialTransformArray": "std_msgs/Header header\nint32 image_seq\n"
    "fiducial_msgs/FiducialTransform[] transforms"
    f"{PART}fiducial_msgs/FiducialTransform\nint32 fiducial_id\n"
    "geometry_msgs/Transform transform\nfloat64 image_error\nfloat64 object_error\n"
    "float64 fiducial_area\n",
}
"""Definitions of types that rosbags does not know."""
FX, CX, CY = 57.0, 228.0, 120.0
"""A fisheye camera, of which half a pixel is the noise of the bearings [px]."""


def tag_messages(
    name: str,
    file: str,
    topic: str,
    topics: str = HOME,
    of: Callable[[Seen], list[tuple[Any, Any]]] = optical,
    camera: bool = False,
    **fields: Callable[[Any, Any, Any], Any],
) -> None:
    """Register a log with messages of a type.

    `fields` are lists with an item for each tag, made of a header, the id, and the pose or what
    else `of` gives.
    """
    package, kind_ = name.split("/")
    name = f"{package}/msg/{kind_}"
    types = {name: DEFINITIONS[name]} if name in DEFINITIONS else {}

    def files(s: Sample) -> Files:
        def tags(log: LogFile, stamp: int, seen: Seen) -> Messages:
            header, found = log.header(stamp, OPTICAL), of(seen)
            own: dict[str, Any] = (
                {"header": header} if "header" in dict(log._store.fielddefs[name][1]) else {}
            )
            for k, made in fields.items():
                items = [made(header, *tag) for tag in found]
                own[k] = np.array(items) if isinstance(items[0], int) else items
            return {topic: log.make(name, **own)}

        first = camera_info if camera else lambda log, stamp: {}
        return {file: log_of(s, s.seen.ahead, tags, types, first=first), "topics.yaml": topics}

    kind(f"{package}/{kind_}, {Path(file).suffix}", f"run {file} --topics topics.yaml")(files)


def camera_info(log: LogFile, stamp: int) -> Messages:
    """Return the calibration of the camera."""
    k = np.array([FX, 0, CX, 0, FX, CY, 0, 0, 1])
    values = {"d": np.zeros(4), "k": k, "r": np.eye(3).ravel(), "p": np.zeros(12)}
    if "K" in dict(log._store.fielddefs["sensor_msgs/msg/CameraInfo"][1]):
        values = {name.upper(): value for name, value in values.items()}
    size = {"height": 240, "width": 456, "distortion_model": "equidistant"}
    header = log.header(stamp, OPTICAL)
    info = log.make("sensor_msgs/msg/CameraInfo", header=header, **size, **values)
    return {"/camera/camera_info": info}


def pixels(seen: Seen) -> list[tuple[int, dict[str, float]]]:
    """Return the ids of tags and their places in the image [px]."""
    columns = CX - FX * seen.bearing
    return [(i, {"x": u, "y": CY}) for i, u in zip(seen.id.tolist(), columns, strict=True)]


def square(at: dict[str, float]) -> list[dict[str, float]]:
    """Return corners round a pixel, as AprilTag 3 counts them."""
    offsets = (-1.5, 2.5), (2.5, 2.5), (2.5, -1.5), (-1.5, -1.5)
    return [{"x": at["x"] + x, "y": at["y"] + y} for x, y in offsets]


tag_messages(
    "aruco_opencv_msgs/ArucoDetection",
    "log.mcap",
    "/aruco_detections",
    markers=lambda h, i, p: {"marker_id": i, "pose": p},
)
tag_messages(
    "ros2_aruco_interfaces/ArucoMarkers",
    "log.db3",
    "/aruco_markers",
    marker_ids=lambda h, i, p: i,
    poses=lambda h, i, p: p,
)
tag_messages(
    "aruco_msgs/MarkerArray",
    "log.bag",
    "/aruco_marker_publisher/markers",
    markers=lambda h, i, p: {"id": i, "pose": {"pose": p, "covariance": np.zeros(36)}},
)
tag_messages(
    "ar_track_alvar_msgs/AlvarMarkers",
    "log.bag",
    "/ar_pose_marker",
    markers=lambda h, i, p: {"header": h, "id": i, "pose": {"pose": p}},
)
tag_messages(
    "apriltags_ros/AprilTagDetectionArray",
    "log.bag",
    "/tag_detections",
    detections=lambda h, i, p: {"id": i, "size": 0.16, "pose": {"header": h, "pose": p}},
)
tag_messages(
    "apriltag_ros/AprilTagDetectionArray",
    "log.bag",
    "/tag_detections",
    detections=lambda h, i, p: {
        "id": np.array([i], np.int32),
        "size": np.array([0.16]),
        "pose": {"header": h, "pose": {"pose": p, "covariance": np.zeros(36)}},
    },
)
tag_messages(
    "isaac_ros_apriltag_interfaces/AprilTagDetectionArray",
    "log.db3",
    "/tag_detections",
    detections=lambda h, i, p: {"id": i, "pose": {"header": h, "pose": {"pose": p}}},
)
tag_messages(
    "vision_msgs/Detection3DArray",
    "log.mcap",
    "/objects",
    detections=lambda h, i, p: {"header": h, "id": str(i), "bbox": {"center": p}},
)
tag_messages(
    "fiducial_msgs/FiducialTransformArray",
    "log.bag",
    "/fiducial_transforms",
    transforms=lambda h, i, p: {
        "fiducial_id": i,
        "transform": {"translation": p["position"], "rotation": p["orientation"]},
    },
)
tag_messages(
    "apriltag_msgs/AprilTagDetectionArray",
    "log.db3",
    "/detections",
    HOME + "bearings: {topic: /detections, pixel_sigma: 1.0}\n",
    pixels,
    camera=True,
    detections=lambda h, i, p: {
        "family": "36h11",
        "id": i,
        "centre": p,
        "corners": square(p),
        "homography": np.zeros(9),
    },
)
tag_messages(
    "vision_msgs/Detection2DArray",
    "log.mcap",
    "/detections",
    of=pixels,
    camera=True,
    detections=lambda h, i, p: {
        "header": h,
        "id": str(i),
        "bbox": {"center": {"position": p}, "size_x": 4.0, "size_y": 4.0},
    },
)


def pose_topics(log: LogFile, stamp: int, seen: Seen) -> Messages:
    """Return a PoseStamped on a topic of its own for each tag."""
    make, header = log.make, log.header(stamp, OPTICAL)
    return {
        f"/tag_{i}/pose": make("geometry_msgs/msg/PoseStamped", header=header, pose=p)
        for i, p in optical(seen)
    }


POSE_TOPICS = HOME + 'bearings: {topic: "/tag_*/pose"}\n'


@kind("PoseStamped, a topic for each tag, .mcap", "run log.mcap --topics topics.yaml")
def _(s: Sample) -> Files:
    return {"log.mcap": log_of(s, s.seen.ahead, pose_topics), "topics.yaml": POSE_TOPICS}


@kind("tags as frames in /tf, .mcap", "run log.mcap --topics topics.yaml")
def _(s: Sample) -> Files:
    def transform(header: Any, child: str, place: Any, turn: Any) -> dict[str, Any]:
        motion = {"translation": place, "rotation": turn}
        return {"header": header, "child_frame_id": child, "transform": motion}

    def tags(log: LogFile, stamp: int, seen: Seen) -> Messages:
        header = log.header(stamp, OPTICAL)
        found = [transform(header, f"tag36h11:{i}", *p.values()) for i, p in optical(seen)]
        return {"/tf": log.make("tf2_msgs/msg/TFMessage", transforms=found)}

    def first(log: LogFile, stamp: int) -> Messages:
        looks_ahead = {"x": -0.5, "y": 0.5, "z": -0.5, "w": 0.5}
        camera = transform(log.header(stamp, "base_link"), OPTICAL, {"x": s.camera}, looks_ahead)
        return {"/tf_static": log.make("tf2_msgs/msg/TFMessage", transforms=[camera])}

    return {"log.mcap": log_of(s, s.seen.ahead, tags, first=first), "topics.yaml": HOME}


def tag_list(
    log: LogFile, stamp: int, seen: Seen, topic: str = "/tags", frame: str = OPTICAL
) -> Messages:
    """Return a message of a type of one's own."""
    tags = [log.make("my_msgs/msg/Tag", tag_id=i, pose=pose) for i, pose in optical(seen)]
    header = log.header(stamp, frame)
    return {topic: log.make("my_msgs/msg/TagList", header=header, tags=tags)}


TAG_LIST = {
    "my_msgs/msg/Tag": "int32 tag_id\nfloat32 margin\ngeometry_msgs/Pose pose\n",
    "my_msgs/msg/TagList": "std_msgs/Header header\nmy_msgs/Tag[] tags\n",
}


@kind("positions in a type of one's own", "run log.mcap --topics topics.yaml")
def _(s: Sample) -> Files:
    return {"log.mcap": log_of(s, s.seen.ahead, tag_list, TAG_LIST), "topics.yaml": HOME}


@kind("positions in a type of one's own, optical by values", "run log.bag --topics topics.yaml")
def _(s: Sample) -> Files:
    tags = partial(tag_list, frame="camera")
    topics = f"bearings: {{topic: /tags, id: tags.tag_id, position: tags.pose.position}}\n{HOME}"
    return {"log.bag": log_of(s, s.seen.ahead, tags, TAG_LIST), "topics.yaml": topics}


SCAN = {
    "my_msgs/msg/Scan": "std_msgs/Header header\nstring[] names\nfloat64[] ranges\n"
    "float64[] bearings_deg\n"
}


@kind("lists of names, ranges and bearings in degrees", "run log.mcap --topics topics.yaml")
def _(s: Sample) -> Files:
    def tags(log: LogFile, stamp: int, seen: Seen) -> Messages:
        lists = {"names": [str(i) for i in seen.id], "ranges": seen.range}
        degrees = np.degrees(seen.bearing)
        header = log.header(stamp, "camera")
        return {"/scan": log.make(*SCAN, header=header, bearings_deg=degrees, **lists)}

    return {"log.mcap": log_of(s, s.seen, tags, SCAN), "topics.yaml": HOME}


@kind("odometry in a type of one's own", "run log.mcap --topics topics.yaml")
def _(s: Sample) -> Files:
    def odometry(log: LogFile, stamp: int, k: int) -> Messages:
        twist = {"linear_velocity": float(s.v[k]), "yaw_rate": float(s.omega[k])}
        return {"/base": log.make(BASE, header=log.header(stamp, "base_link"), **twist)}

    types = {BASE: "std_msgs/Header header\nfloat64 linear_velocity\nfloat64 yaw_rate\n"}
    files = log_of(s, s.seen.ahead, tag_list, TAG_LIST | types, odometry)
    return {"log.mcap": files, "topics.yaml": HOME}


BASE = "my_msgs/msg/BaseState"


@kind("two cameras with an overlap", "run log.mcap --topics topics.yaml")
def _(s: Sample) -> Files:
    def tags(log: LogFile, stamp: int, seen: Seen) -> Messages:
        behind = abs(seen.bearing) > np.radians(60.0)
        turned = Seen(seen.t, seen.id, seen.bearing + np.pi, seen.range)[behind]
        ahead = tag_list(log, stamp, seen.ahead, "/front", "front_optical")
        return {**ahead, **tag_list(log, stamp, turned, "/rear", "rear_optical")}

    topics = (
        "bearings: [{topic: /front, sigma: 0.01, sensor: {x: 0.2}}, {topic: /rear, sigma: 0.015, "
        f"sensor: {{x: 0.2, yaw: 3.14159265}}}}]\n{HOME}"
    )
    return {"log.mcap": log_of(s, s.seen, tags, TAG_LIST), "topics.yaml": topics}
