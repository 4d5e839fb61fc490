"""Known message types: the paths of the fields that have the roles of a table's columns."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import Any, TypeAlias

import numpy as np

from homeward.drives.ros.kinds import BEARINGS, ODOMETRY, POSE
from homeward.drives.ros.settings import PICTURES, Layout
from homeward.drives.ros.wpilog import (
    CHASSIS_SPEEDS,
    MODULE_STATES,
    PHOTON_RESULT,
    POSE2D,
    RAW_FIDUCIALS,
    ROBOT_ON_FIELD,
)

Paths: TypeAlias = Mapping[str, str]
"""Paths by role."""


def values(message: Any, path: str) -> list[Any]:
    """Return the values of a path in a message; those of a list in order."""
    found = [message]
    for part in filter(None, path.split(".")):
        name = part.removesuffix("[]")
        found = [getattr(item, name) for item in found]
        if name != part:
            found = [item for items in found for item in items]
    return found


def id_text(value: Any) -> str:
    """Return an id as text: ``1+2`` for a list, such as the ids of a bundle."""
    return "+".join(map(str, value)) if isinstance(value, (list, tuple, np.ndarray)) else str(value)


NAV_ODOMETRY = "nav_msgs/msg/Odometry"
JOINT_STATE = "sensor_msgs/msg/JointState"
IMU = "sensor_msgs/msg/Imu"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Types whose transforms may be sightings or poses; a reader receives one transform."""
ACKERMANN = ("ackermann_msgs/msg/AckermannDriveStamped", "ackermann_msgs/msg/AckermannDrive")
"""Types with a speed and a steering angle."""
WHEELS = (JOINT_STATE, *ACKERMANN, MODULE_STATES)
"""Types that require the geometry of the wheels."""


def _in(path: str, roles: Paths) -> dict[str, str]:
    return {role: f"{path}.{field}" for role, field in roles.items()}


_TWIST = {"v": "linear.x", "omega": "angular.z", "vy": "linear.y"}
_POSE = {"x": "position.x", "y": "position.y", "heading": "orientation"}
_PLANAR = {"x": "x", "y": "y", "heading": "heading"}
_TRANSFORM = {"x": "translation.x", "y": "translation.y", "heading": "rotation"}
MOTIONS: dict[str, Paths] = {
    ODOMETRY: {"v": "v", "omega": "omega"},
    POSE: _PLANAR,
    NAV_ODOMETRY: _in("twist.twist", _TWIST) | _in("pose.pose", _POSE),
    "geometry_msgs/msg/TwistWithCovarianceStamped": _in("twist.twist", _TWIST),
    "geometry_msgs/msg/TwistStamped": _in("twist", _TWIST),
    "geometry_msgs/msg/Twist": _TWIST,
    CHASSIS_SPEEDS: _TWIST,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _in("pose.pose", _POSE),
    "geometry_msgs/msg/PoseStamped": _in("pose", _POSE),
    **dict.fromkeys((POSE2D, ROBOT_ON_FIELD), _PLANAR),
    ACKERMANN[0]: {"v": "drive.speed", "steering": "drive.steering_angle"},
    ACKERMANN[1]: {"v": "speed", "steering": "steering_angle"},
    **dict.fromkeys(TRANSFORMS, _in("transform", _TRANSFORM)),
    IMU: {"omega": "angular_velocity.z"},
}
"""Roles of motion by type, in order of preference; the path of a heading may be a quaternion's."""
TWISTS = tuple(kind for kind, roles in MOTIONS.items() if {"v", "omega"} <= roles.keys())
POSES = tuple(k for k, roles in MOTIONS.items() if "heading" in roles and k not in TRANSFORMS)


def row_of(roles: Paths) -> Callable[[Any], tuple[float, ...]]:
    """Return a function that returns the values of roles in a message."""
    getters = [_getter(path) for path in roles.values()]
    return lambda message: tuple(_number(get(message)) for get in getters)


def _getter(path: str) -> Callable[[Any], Any]:
    return (lambda message: values(message, path)[0]) if "[]" in path else attrgetter(path)


def _number(value: Any) -> float:
    return yaw(value) if hasattr(value, "w") else float(value)


def orientation_of(message: Any) -> Any:
    """Return the quaternion of an Imu, or of a message with a pose."""
    while hasattr(message, "pose"):
        message = message.pose
    return message.orientation


def yaw(q: Any) -> float:
    """Return the heading [rad] of a quaternion; NaN for a zero one."""
    norm = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    if not norm > 0:
        return math.nan
    return math.atan2(2 * (q.w * q.z + q.x * q.y), norm - 2 * (q.y * q.y + q.z * q.z))


TAGS = "apriltag_msgs/msg/AprilTagDetectionArray"
DETECTIONS = "vision_msgs/msg/Detection2DArray"
POSE_ARRAY = "geometry_msgs/msg/PoseArray"
POINT = "geometry_msgs/msg/PointStamped"
POSES_OF_TAGS = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")
"""Types of topics with the pose of one landmark."""
OF_ONE_LANDMARK = (POINT, *POSES_OF_TAGS)
ALVAR = "ar_track_alvar_msgs/msg/AlvarMarkers"
OLD_TAG_POSES = "apriltags_ros/msg/AprilTagDetectionArray"
HALF_PIXEL = 0.5
"""Centre of the first pixel in AprilTag 3, and so in apriltag_msgs/AprilTagDetection (issue 121 of
AprilRobotics/apriltag); it is 0 in camera models [px]."""
_POSE_OF_TAG = Layout("detections[].id", "detections[].pose.pose.pose.position", axes="optical")
SIGHTINGS: dict[str, Layout] = {
    BEARINGS: Layout("landmarks[]", bearing="bearings[]", sigma="sigmas[]"),
    TAGS: Layout(
        "detections[].id",
        corners="detections[].corners",
        errors="detections[].hamming",
        origin=HALF_PIXEL,
    ),
    "apriltag_msgs/msg/ApriltagArrayStamped": Layout(
        "apriltags[].id", corners="apriltags[].corners", errors="apriltags[].hamming"
    ),
    "fiducial_msgs/msg/FiducialArray": Layout("fiducials[].fiducial_id", corners="fiducials[]"),
    "aruco_msgs/msg/MarkerArray": Layout("markers[].id", "markers[].pose.pose.position"),
    "fiducial_msgs/msg/FiducialTransformArray": Layout(
        "transforms[].fiducial_id", "transforms[].transform.translation", axes="optical"
    ),
    "apriltag_ros/msg/AprilTagDetectionArray": _POSE_OF_TAG,
    "isaac_ros_apriltag_interfaces/msg/AprilTagDetectionArray": _POSE_OF_TAG,
    "ros2_aruco_interfaces/msg/ArucoMarkers": Layout(
        "marker_ids[]", "poses[].position", axes="optical"
    ),
    "aruco_opencv_msgs/msg/ArucoDetection": Layout(
        "markers[].marker_id", "markers[].pose.position"
    ),
    ALVAR: Layout("markers[].id", "markers[].pose.pose.position"),
    OLD_TAG_POSES: Layout("detections[].id", "detections[].pose.pose.position", axes="optical"),
    "vision_msgs/msg/Detection3DArray": Layout("detections[]", "detections[]"),
    **dict.fromkeys(
        (PHOTON_RESULT, RAW_FIDUCIALS), Layout("tags[].id", "tags[].position", axes="body")
    ),
    DETECTIONS: Layout("detections[]", pixel="detections[]"),
    POSE_ARRAY: Layout(position="poses[].position"),
    POINT: Layout(position="point"),
}
"""Landmarks by type, in order of preference."""
NAMED: dict[str, Layout] = {
    POSES_OF_TAGS[0]: Layout(position="pose.position"),
    POSES_OF_TAGS[1]: Layout(position="pose.pose.position"),
    **dict.fromkeys(TRANSFORMS, Layout(position="transform.translation")),
}
"""Types that are sightings only where the topics file names them."""
ALL_SIGHTINGS = SIGHTINGS | NAMED
IN_PARTS = (*TRANSFORMS, ALVAR, OLD_TAG_POSES)
"""Types whose parts have headers; the message's header may be empty."""
CORNERS = (*(kind for kind, layout in SIGHTINGS.items() if layout.corners), *PICTURES)
"""Types with the corners of tags."""
IN_IMAGE = (*CORNERS, DETECTIONS)
"""Types with points in pixels, which need a camera model."""
