"""Odometry out of messages: twists, poses that are differentiated, or turns of wheels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from homeward.drives.dead_reckoning import twists_from_poses
from homeward.drives.drive import Odometry
from homeward.drives.folder import REPEATED_ODOMETRY
from homeward.drives.ros.measurements.rows import Remarks, clean_rows
from homeward.drives.ros.messages.names import ODOMETRY, POSE
from homeward.drives.ros.settings import OdometryTopic
from homeward.drives.text.table import quoted
from homeward.errors import InputError

NAV_ODOMETRY = "nav_msgs/msg/Odometry"
JOINT_STATE = "sensor_msgs/msg/JointState"
TWISTS = (
    ODOMETRY,
    NAV_ODOMETRY,
    "geometry_msgs/msg/TwistWithCovarianceStamped",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/Twist",
)
"""Types that tell a twist, the best first."""
POSES = (
    POSE,
    NAV_ODOMETRY,
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PoseStamped",
)
"""Types that tell a pose."""
SIDEWAYS = "odometry messages with a sideways speed, which is left out"
SIDEWAYS_SHARE = 0.1
"""Of the forward speed; less is noise."""

Row = tuple[float, float, float]


def twist_of(message: Any) -> Row:
    """Return forward speed [m/s], turn rate [rad/s] and sideways speed [m/s]."""
    if hasattr(message, "v"):  # homeward_msgs/Odometry
        return message.v, message.omega, 0.0
    twist = message
    while hasattr(twist, "twist"):
        twist = twist.twist
    return twist.linear.x, twist.angular.z, twist.linear.y


def pose_of(message: Any) -> Row:
    """Return x [m], y [m] and heading [rad] in whatever frame the message has."""
    if hasattr(message, "heading"):  # homeward_msgs/Pose
        return message.x, message.y, message.heading
    pose = message.pose
    while hasattr(pose, "pose"):
        pose = pose.pose
    return pose.position.x, pose.position.y, yaw(pose.orientation)


def yaw(q: Any) -> float:
    """Return the heading [rad] of a quaternion; NaN of one that is all zero."""
    norm = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    if not norm > 0:
        return math.nan
    return math.atan2(2 * (q.w * q.z + q.x * q.y), norm - 2 * (q.y * q.y + q.z * q.z))


class Wheels:
    """Which joints of a JointState are the wheels, and what they say of the robot's way."""

    def __init__(self, told: OdometryTopic) -> None:
        if told.wheel_radius is None or told.track_width is None:
            raise InputError(
                f"{told.topic}: wheels need wheel_radius and track_width in the topics file"
            )
        self._told = told
        self._radius, self._track = told.wheel_radius, told.track_width
        self._by_position: bool | None = None

    def row(self, message: Any) -> Row | None:
        """Return way (or speed) of the left and right wheels [m or m/s]; None without them."""
        names = list(message.name)
        left = self._joints(names, self._told.left, "left")
        right = self._joints(names, self._told.right, "right")
        if not left or not right:
            return None
        if self._by_position is None:
            self._by_position = len(message.position) == len(names)
        values = message.position if self._by_position else message.velocity
        if len(values) != len(names):
            return None
        return (
            self._radius * float(np.mean([values[i] for i in left])),
            self._radius * float(np.mean([values[i] for i in right])),
            0.0,
        )

    def _joints(self, names: list[str], wanted: tuple[str, ...], side: str) -> list[int]:
        if wanted:
            return [names.index(name) for name in wanted] if set(wanted) <= set(names) else []
        return [i for i, name in enumerate(names) if side in name.lower()]

    def twists(self, t: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return v [m/s] and omega [rad/s], shape (n,), of rows of shape (n, 3) at `t` [s]."""
        left, right = rows[:, 0], rows[:, 1]
        if self._by_position:
            left, right = _rate(t, left), _rate(t, right)
        return (left + right) / 2, (right - left) / self._track


class OdometryRows:
    """The odometry of a topic, as it comes in."""

    def __init__(self, told: OdometryTopic, kind: str) -> None:
        self._told, self._kind = told, kind
        self._wheels = Wheels(told) if kind == JOINT_STATE else None
        self._rows: list[tuple[float, ...]] = []
        if kind not in {"twist": TWISTS, "pose": POSES, None: (kind,)}[told.use]:
            raise InputError(f"{told.topic}: a {quoted(kind)} tells no {told.use}")

    def add(self, t: float, message: Any) -> None:
        """Take the message of time `t` [s]."""
        if self._wheels is not None:
            row = self._wheels.row(message)
            if row is not None:
                self._rows.append((t, *row))
            return
        nothing = (math.nan,) * 3
        twist = twist_of(message) if self._kind in TWISTS else nothing
        pose = pose_of(message) if self._kind in POSES else nothing
        self._rows.append((t, *map(float, (*twist, *pose))))

    def odometry(self, remarks: Remarks) -> Odometry:
        """Return what all messages together tell; counts in `remarks` what was left out.

        Raises
        ------
        InputError
            When there is none with finite numbers.
        """
        if not self._rows:
            raise InputError(f"{self._told.topic}: no message tells odometry")
        rows = np.array(self._rows, float)
        if self._wheels is not None:
            rows = self._clean(rows, remarks)
            return Odometry(rows[:, 0], *self._wheels.twists(rows[:, 0], rows[:, 1:]))
        if self._by_twist(rows[:, 1:]):
            with np.errstate(invalid="ignore"):
                sideways = np.abs(rows[:, 3]) > SIDEWAYS_SHARE * np.abs(rows[:, 1]) + 1e-3
            remarks.count(SIDEWAYS, int(sideways.sum()))
            return Odometry(*self._clean(rows[:, :3], remarks).T.copy())
        rows = self._clean(rows[:, [0, 4, 5, 6]], remarks)
        return Odometry(rows[:, 0], *twists_from_poses(rows[:, 0], rows[:, 1:]))

    def _clean(self, rows: np.ndarray, remarks: Remarks) -> np.ndarray:
        return clean_rows(rows, self._told.topic, "odometry", REPEATED_ODOMETRY, remarks)

    def _by_twist(self, rows: np.ndarray) -> bool:
        """Say whether twists are used rather than poses; both stand in rows of shape (n, 6)."""
        if self._told.use is not None or self._kind != NAV_ODOMETRY:
            return self._told.use == "twist" or self._kind in TWISTS
        moves = bool(np.ptp(rows[:, 3:], axis=0).any())
        return bool(rows[:, :2].any()) or not moves


def _rate(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.append(np.diff(values) / np.diff(t), 0.0)
