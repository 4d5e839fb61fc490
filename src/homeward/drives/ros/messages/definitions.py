"""The message types that homeward reads and writes beside those that rosbags knows.

`homeward_msgs` holds a drive to the last bit. Its stamps are whole nanoseconds, as everywhere in
ROS; `residue` is what a stamp cannot hold of a time in seconds, and 0, as a message begins, where
there is nothing of the kind.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ODOMETRY = "homeward_msgs/msg/Odometry"
BEARINGS = "homeward_msgs/msg/Bearings"
POSE = "homeward_msgs/msg/Pose"

DEFINITIONS = {
    ODOMETRY: """\
# A twist of the robot's centre, which holds until the next message's stamp, at most 1 s.
std_msgs/Header header
float64 residue     # [s], to be added to header.stamp; 0 where the stamp says it all
float64 v           # forward [m/s]
float64 omega       # turn rate, anti-clockwise [rad/s]
""",
    BEARINGS: """\
# Landmarks that a camera saw at one time; landmarks and bearings have the same length.
std_msgs/Header header
float64 residue     # [s], to be added to header.stamp; 0 where the stamp says it all
string[] landmarks  # their ids
float64[] bearings  # from the camera's axis, anti-clockwise [rad]
float64[] sigmas    # their standard deviations [rad], NaN where not known; or empty
""",
    POSE: """\
# A pose of the robot's centre in the home frame.
std_msgs/Header header
float64 residue     # [s], to be added to header.stamp; 0 where the stamp says it all
float64 x           # [m]
float64 y           # [m]
float64 heading     # [rad]
""",
}
"""The types of `homeward_msgs`, as their .msg files would have them."""

_WELL_KNOWN = {
    "vision_msgs/msg/Detection2DArray": """\
std_msgs/Header header
vision_msgs/Detection2D[] detections
================================================================================
MSG: vision_msgs/Detection2D
std_msgs/Header header
vision_msgs/ObjectHypothesisWithPose[] results
vision_msgs/BoundingBox2D bbox
string id
================================================================================
MSG: vision_msgs/ObjectHypothesisWithPose
vision_msgs/ObjectHypothesis hypothesis
geometry_msgs/PoseWithCovariance pose
================================================================================
MSG: vision_msgs/ObjectHypothesis
string class_id
float64 score
================================================================================
MSG: vision_msgs/BoundingBox2D
vision_msgs/Pose2D center
float64 size_x
float64 size_y
================================================================================
MSG: vision_msgs/Pose2D
vision_msgs/Point2D position
float64 theta
================================================================================
MSG: vision_msgs/Point2D
float64 x
float64 y
""",
    "apriltag_msgs/msg/AprilTagDetectionArray": """\
std_msgs/Header header
apriltag_msgs/AprilTagDetection[] detections
================================================================================
MSG: apriltag_msgs/AprilTagDetection
string family
int32 id
int32 hamming
float32 goodness
float32 decision_margin
apriltag_msgs/Point centre
apriltag_msgs/Point[4] corners
float64[9] homography
================================================================================
MSG: apriltag_msgs/Point
float64 x
float64 y
""",
}
"""For logs that hold no definitions, as those of ROS 2 before Iron in sqlite3."""


@cache
def typestore(ros1: bool) -> Any:
    """Return rosbags' store of every type known here, as ROS 1 Noetic or ROS 2 Humble has them."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name, text in {**DEFINITIONS, **_WELL_KNOWN}.items():
        store.register(get_types_from_msg(text, name))
    return store
