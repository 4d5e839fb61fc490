"""Bearings from messages: given directly, or from points in an image or in space."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from homeward.drives.cameras.lens import Lens
from homeward.drives.ros.measurements.structure import Layout, id_text, values
from homeward.drives.ros.messages.wpilib import PHOTON_RESULT, RAW_FIDUCIALS
from homeward.drives.ros.settings import BEARINGS, PICTURES, BearingsTopic, wildcard_part
from homeward.errors import InputError

DETECTIONS = "vision_msgs/msg/Detection2DArray"
DETECTIONS_3D = "vision_msgs/msg/Detection3DArray"
TAGS = "apriltag_msgs/msg/AprilTagDetectionArray"
TAG_ARRAY = "apriltag_msgs/msg/ApriltagArrayStamped"
FIDUCIALS = "fiducial_msgs/msg/FiducialArray"
POSE_ARRAY = "geometry_msgs/msg/PoseArray"
POINT = "geometry_msgs/msg/PointStamped"
POSES_OF_TAGS = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")
"""Types of topics with the pose of one landmark."""
OF_ONE_LANDMARK = (POINT, *POSES_OF_TAGS)
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Types whose transforms may be sightings; a reader receives one transform."""
ALVAR = "ar_track_alvar_msgs/msg/AlvarMarkers"
OLD_TAG_POSES = "apriltags_ros/msg/AprilTagDetectionArray"
LAYOUTS = {
    "aruco_msgs/msg/MarkerArray": Layout("markers[].id", "markers[].pose.pose.position"),
    "fiducial_msgs/msg/FiducialTransformArray": Layout(
        "transforms[].fiducial_id", "transforms[].transform.translation"
    ),
    "apriltag_ros/msg/AprilTagDetectionArray": Layout(
        "detections[].id", "detections[].pose.pose.pose.position"
    ),
    "isaac_ros_apriltag_interfaces/msg/AprilTagDetectionArray": Layout(
        "detections[].id", "detections[].pose.pose.pose.position"
    ),
    "ros2_aruco_interfaces/msg/ArucoMarkers": Layout("marker_ids[]", "poses[].position"),
    "aruco_opencv_msgs/msg/ArucoDetection": Layout(
        "markers[].marker_id", "markers[].pose.position"
    ),
    ALVAR: Layout("markers[].id", "markers[].pose.pose.position"),
    OLD_TAG_POSES: Layout("detections[].id", "detections[].pose.pose.position"),
}
"""Types of lists of positions, in order of preference."""
OPTICAL = [
    kind for kind in LAYOUTS if kind.startswith(("apriltag", "isaac", "fiducial", "ros2_aruco"))
]
"""Types with optical axes in any frame."""
IN_PARTS = (*TRANSFORMS, ALVAR, OLD_TAG_POSES)
"""Types whose parts have headers; the message's header may be empty."""
NOT_DECODED = 255
"""Id of a tag that ar_track_alvar found but did not decode."""
CORNERS = (TAGS, TAG_ARRAY, FIDUCIALS, *PICTURES)
"""Types with the corners of tags."""
IN_IMAGE = (*CORNERS, DETECTIONS)
"""Types with points in pixels, which need a camera model."""
HALF_PIXEL = 0.5
"""Centre of the first pixel in AprilTag 3, and so in apriltag_msgs/AprilTagDetection (issue 121 of
AprilRobotics/apriltag); it is 0 in camera models [px]."""

FIXED_FRAMES = ("map", "odom", "world", "earth")
"""Frames that do not move with the robot (REP 105)."""


class Sighting(NamedTuple):
    """One landmark in one message."""

    landmark: str
    a: float
    """Bearing [rad], or column [px], or distance ahead [m]."""
    b: float = 0.0
    """Row [px], or distance to the left [m]."""
    up: float = 0.0
    """Height above the camera [m], of a point in space."""
    sigma: float = math.nan
    """Standard deviation of the bearing [rad], or of a corner [px]."""
    corners: tuple[tuple[float, float], ...] = ((math.nan, math.nan),) * 4
    """Columns and rows of a tag's corners [px], in order."""
    errors: int = 0
    """Number of wrong bits of a tag."""


Reader: TypeAlias = Callable[[Any, BearingsTopic], Iterator[Sighting]]
TagDetector: TypeAlias = Callable[[Any, Lens | None], Iterator[Sighting]]
"""Returns the tags in a message of `PICTURES`; the camera may be unknown yet."""


def _bearings(message: Any, given: BearingsTopic) -> Iterator[Sighting]:
    ids, values, sigmas = message.landmarks, message.bearings, message.sigmas
    if len(ids) != len(values) or len(sigmas) not in (0, len(ids)):
        raise InputError(
            f"{given.topic}: a message has {len(ids)} landmarks, {len(values)} bearings and "
            f"{len(sigmas)} sigmas"
        )
    if not len(sigmas):
        sigmas = np.full(len(ids), math.nan)
    for landmark, value, sigma in zip(ids, values.tolist(), sigmas.tolist(), strict=True):
        yield Sighting(landmark, value, sigma=sigma)


def _score(result: Any) -> float:
    return float(getattr(result, "hypothesis", result).score)


def _identified(found: Any) -> tuple[str, Any]:
    """Return a detection's id of a tracker, or else its likeliest class; and that hypothesis."""
    best = max(found.results, key=_score, default=None)
    name = getattr(found, "id", "") or getattr(found, "tracking_id", "")
    if not name:
        hypothesis = getattr(best, "hypothesis", best)
        name = getattr(hypothesis, "class_id", getattr(hypothesis, "id", ""))
    return str(name), best


def _detection(found: Any) -> Sighting:
    """Return a detection in an image."""
    centre = found.bbox.center
    point = getattr(centre, "position", centre)
    return Sighting(_identified(found)[0], point.x, point.y)


def _detection_3d(found: Any) -> tuple[str, Any]:
    """Return the id of a detection and its position, or the centre of its box without one."""
    name, best = _identified(found)
    position = found.bbox.center.position if best is None else best.pose.pose.position
    is_missing = position.x == position.y == position.z == 0
    return name, found.bbox.center.position if is_missing else position


def _corners(points: Any, origin: float = 0.0) -> tuple[tuple[float, float], ...]:
    """Return corners from four points, or from eight numbers."""
    if isinstance(points, np.ndarray):
        return tuple((x - origin, y - origin) for x, y in points.reshape(-1, 2).tolist())
    return tuple((p.x - origin, p.y - origin) for p in points)


def _points(
    points: Callable[[Any, BearingsTopic], Iterable[tuple[Any, Any]]], axes: str | None = None
) -> Reader:
    """Return a reader of named points in space; the frame specifies the axes unless given."""

    def read(message: Any, given: BearingsTopic) -> Iterator[Sighting]:
        convention = _axes(message, given) if axes is None else given.axes or axes
        for name, point in points(message, given):
            yield Sighting(str(name), *_ahead_left_up(point, convention))

    return read


def _structured(layout: Layout, axes: str | None = None) -> Reader:
    """Return a reader of landmarks by the paths of their fields; axes as for `_points`."""

    def pairs(message: Any, given: BearingsTopic) -> list[tuple[str, Any]]:
        ids, places = values(message, layout.id), values(message, layout.place)
        if len(ids) != len(places):
            raise InputError(
                f"{given.topic}: a message has {len(ids)} values of {layout.id} and {len(places)} "
                f"of {layout.place}"
            )
        return [(id_text(name), place) for name, place in zip(ids, places, strict=True)]

    def bearings(message: Any, given: BearingsTopic) -> Iterator[Sighting]:
        for name, bearing in pairs(message, given):
            yield Sighting(name, layout.scale * float(bearing))

    return bearings if layout.bearing else _points(pairs, axes)


READERS: dict[str, Reader] = {
    BEARINGS: _bearings,
    TAGS: lambda message, _: (
        Sighting(str(tag.id), 0.0, corners=_corners(tag.corners, HALF_PIXEL), errors=tag.hamming)
        for tag in message.detections
    ),
    TAG_ARRAY: lambda message, _: (
        Sighting(str(tag.id), 0.0, corners=_corners(tag.corners), errors=tag.hamming)
        for tag in message.apriltags
    ),
    FIDUCIALS: lambda message, _: (
        Sighting(
            str(tag.fiducial_id),
            0.0,
            corners=tuple((getattr(tag, f"x{k}"), getattr(tag, f"y{k}")) for k in range(4)),
        )
        for tag in message.fiducials
    ),
    **{
        kind: _structured(layout, "optical" if kind in OPTICAL else None)
        for kind, layout in LAYOUTS.items()
    },
    DETECTIONS_3D: _points(lambda message, _: map(_detection_3d, message.detections)),
    **dict.fromkeys(
        (PHOTON_RESULT, RAW_FIDUCIALS), _points(lambda message, _: message.tags, "body")
    ),
    DETECTIONS: lambda message, _: map(_detection, message.detections),
    POSE_ARRAY: _points(
        lambda message, _: ((place, pose.position) for place, pose in enumerate(message.poses))
    ),
    POINT: _points(
        lambda message, given: [
            (given.landmark or given.topic.rstrip("/").rpartition("/")[2], message.point)
        ]
    ),
}
"""By type, in order of preference."""
NAMED_READERS: dict[str, Reader] = {
    **dict.fromkeys(
        POSES_OF_TAGS, _points(lambda message, given: [(given.landmark, _position(message))])
    ),
    **dict.fromkeys(
        TRANSFORMS,
        _points(
            lambda message, given: [(landmark_of(message, given), message.transform.translation)]
        ),
    ),
}
"""Readers of types that are bearings only where the topics file names them."""
ALL_READERS = READERS | NAMED_READERS
IN_SPACE = tuple(kind for kind in ALL_READERS if kind not in (BEARINGS, *IN_IMAGE))
"""Types with points in space [m]."""


def reader_of(kind: str, given: BearingsTopic) -> Reader:
    """Return the reader of a topic: of the given fields, or else of its type."""
    axes = "optical" if kind in OPTICAL else None
    return ALL_READERS[kind] if given.layout is None else _structured(given.layout, axes)


def has_bearings(kind: str, given: BearingsTopic) -> bool:
    """Whether the messages of a topic contain bearings."""
    return bool(given.bearing) or (kind == BEARINGS and not given.position)


def has_positions(kind: str, given: BearingsTopic) -> bool:
    """Whether the messages of a topic contain points in space."""
    return bool(given.position) or (kind in IN_SPACE and not given.bearing)


def parts_of(kind: str, message: Any, layout: Layout | None = None) -> Iterable[Any]:
    """Return the parts of a message that have a header each, or else the message.

    The items of a list count where the message itself has no frame or no stamp.
    """
    if kind in TRANSFORMS:
        return tuple(message.transforms)
    name = getattr(layout or LAYOUTS.get(kind), "list_name", "")
    outer = getattr(message, "header", None)
    is_complete = outer is not None and bool(outer.frame_id) and _is_set(outer.stamp)
    if not name or (kind not in IN_PARTS and is_complete):
        return (message,)
    parts = []
    for item in getattr(message, name):
        inner = getattr(getattr(item, "pose", None), "header", None)
        headers = [h for h in (getattr(item, "header", None), inner, outer) if h is not None]
        if not headers or headers == [outer]:
            return (message,)
        header = SimpleNamespace(
            frame_id=next((h.frame_id for h in headers if h.frame_id), ""),
            stamp=next((h.stamp for h in headers if _is_set(h.stamp)), headers[0].stamp),
        )
        parts.append(SimpleNamespace(header=header, **{name: [item]}))
    return parts


def _is_set(stamp: Any) -> bool:
    return bool(stamp.sec or stamp.nanosec)


def landmark_of(transform: Any, given: BearingsTopic) -> str | None:
    """Return the landmark id of a transform; None where its frame is not a landmark."""
    name = wildcard_part((given.frames or "").strip("/"), transform.child_frame_id.strip("/"))
    return name and (given.landmark or name)


def _position(message: Any) -> Any:
    """Return the position of a stamped pose with or without covariance."""
    return getattr(message.pose, "pose", message.pose).position


def frame_of(message: Any) -> str:
    """Return the frame_id of a message; empty without one."""
    header = getattr(message, "header", None)
    return str(getattr(header, "frame_id", "")).strip("/")


def _axes(message: Any, given: BearingsTopic) -> str:
    """Return the convention of the axes of a message's frame (REP 103)."""
    frame = frame_of(message)
    if frame in FIXED_FRAMES:
        raise InputError(
            f"{given.topic}: its points are in the fixed frame {frame}, so they are no bearings; "
            "use a topic with points in the frame of the camera"
        )
    return axes_of(frame, given)


def axes_of(frame: str, given: BearingsTopic) -> str:
    """Return the given axes of a camera's frame, or else those that its name implies (REP 103)."""
    return given.axes or ("optical" if frame.endswith(("optical_frame", "optical")) else "body")


def _ahead_left_up(point: Any, axes: str) -> tuple[float, float, float]:
    """Return the position of a point in the body axes of its frame [m]."""
    return (point.x, point.y, point.z) if axes == "body" else (point.z, -point.x, -point.y)
