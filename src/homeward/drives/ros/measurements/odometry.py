"""Odometry from messages: twists, differentiated poses, wheel angles, or steering."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from homeward.drives.drive import Odometry
from homeward.drives.folder import REPEATED_ODOMETRY
from homeward.drives.plausibility import odometry_from_poses, without_implausible
from homeward.drives.ros.measurements.bearings import TRANSFORMS, frame_of
from homeward.drives.ros.measurements.contradiction import (
    MIN_MOTION,
    MIN_WINDOWS,
    WINDOWS_S,
    contradiction,
)
from homeward.drives.ros.measurements.rows import Remarks, clean_rows
from homeward.drives.ros.measurements.structure import values
from homeward.drives.ros.messages.wpilib import (
    CHASSIS_SPEEDS,
    MODULE_STATES,
    POSE2D,
    ROBOT_ON_FIELD,
)
from homeward.drives.ros.settings import ODOMETRY, POSE, OdometryTopic
from homeward.drives.wheels import (
    ackermann,
    differential,
    mecanum,
    omni,
    speeds_from_positions,
    swerve,
)
from homeward.drives.yaw_rate import with_yaw_rate
from homeward.errors import InputError
from homeward.io.table import quoted


class JointRows:
    """The wheels of a robot in sensor_msgs/JointState."""

    def __init__(self, given: OdometryTopic) -> None:
        self._given = given
        self._by_position: bool | None = None
        self._wheels: tuple[list[str], list[str]] | None = None
        self._is_mecanum = given.roller_angle is not None and not given.omni

    def row(self, message: Any) -> list[float] | None:
        """Return the position (or rate) of each wheel, left ones first; None if one is missing.

        Those of a mecanum drive are front left, rear left, front right, rear right.
        """
        names = list(message.name)
        if self._wheels is None:
            left = self._joints(names, self._given.left, "left")
            right = self._joints(names, self._given.right, "right")
            if self._given.omni:
                left, right = list(self._given.omni), []
            elif not left or not right or (self._is_mecanum and len(left + right) != 4):
                return None
            elif self._is_mecanum:
                left, right = (sorted(side, key=_is_rear) for side in (left, right))
            self._wheels = left, right
            self._by_position = len(message.position) == len(names)
        values = message.position if self._by_position else message.velocity
        wheels = self._wheels[0] + self._wheels[1]
        if len(values) != len(names) or not set(wheels) <= set(names):
            return None
        return [float(values[names.index(name)]) for name in wheels]

    @staticmethod
    def _joints(names: list[str], wanted: tuple[str, ...], side: str) -> list[str]:
        if wanted:
            return list(wanted) if set(wanted) <= set(names) else []
        return [name for name in names if side in name.lower()]

    def odometry(self, t: np.ndarray, rows: np.ndarray, remarks: dict[str, int]) -> Odometry:
        """Return the odometry of `row` of all messages, (n, k), at `t` (n,) [s]."""
        assert self._wheels is not None
        given = self._given
        unit = "rad" if given.ticks_per_turn is None else "ticks"
        if self._by_position:
            speeds = speeds_from_positions(t, rows, given, unit, remarks)
        else:
            speeds = given.metres(unit) * rows
        if given.omni:
            return omni(t, speeds, given, remarks)
        if self._is_mecanum:
            return mecanum(t, speeds[:, [0, 2, 1, 3]], given, remarks)
        count = len(self._wheels[0])
        left, right = speeds[:, :count].mean(axis=1), speeds[:, count:].mean(axis=1)
        return differential(t, left, right, given, remarks)


def _is_rear(joint: str) -> bool:
    """Whether a joint is of a rear wheel, from its name."""
    return any(word in joint.lower() for word in ("rear", "back"))


NAV_ODOMETRY = "nav_msgs/msg/Odometry"
JOINT_STATE = "sensor_msgs/msg/JointState"
ACKERMANN = ("ackermann_msgs/msg/AckermannDriveStamped", "ackermann_msgs/msg/AckermannDrive")
"""Types with a speed and a steering angle."""
IMU = "sensor_msgs/msg/Imu"
WHEELS = (JOINT_STATE, *ACKERMANN, MODULE_STATES)
"""Types that require the geometry of the wheels."""
TWISTS = (
    ODOMETRY,
    NAV_ODOMETRY,
    "geometry_msgs/msg/TwistWithCovarianceStamped",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/Twist",
    CHASSIS_SPEEDS,
)
"""Types with a twist, in order of preference."""
POSES = (
    POSE,
    NAV_ODOMETRY,
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PoseStamped",
    POSE2D,
    ROBOT_ON_FIELD,
)
"""Types with a pose."""
CONTRADICTION = (
    "odometry messages whose twists and poses contradict each other: {}; the {} are used ({})"
)

Row = tuple[float, float, float]


def twist_of(message: Any) -> Row:
    """Return forward speed [m/s], yaw rate [rad/s] and sideways speed [m/s]."""
    if hasattr(message, "v"):  # homeward_msgs/Odometry
        return message.v, message.omega, 0.0
    twist = message
    while hasattr(twist, "twist"):
        twist = twist.twist
    return twist.linear.x, twist.angular.z, twist.linear.y


def pose_of(message: Any) -> Row:
    """Return x [m], y [m] and heading [rad] in the frame of the message."""
    if hasattr(message, "heading"):  # homeward_msgs/Pose
        return message.x, message.y, message.heading
    pose = message.pose
    while hasattr(pose, "pose"):
        pose = pose.pose
    return pose.position.x, pose.position.y, yaw(pose.orientation)


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


class OdometryRows:
    """The odometry of a topic, collected while a log is read."""

    def __init__(self, given: OdometryTopic, kind: str) -> None:
        self._given, self._kind = given, kind
        self._joints = JointRows(given) if kind == JOINT_STATE else None
        self._rows: list[tuple[float, ...]] = []
        self._yaw_rates: list[tuple[float, ...]] = []
        missing = given.missing(
            *(("m", True) if kind in ACKERMANN else ("rad", False, bool(given.omni)))
        )
        if kind == JOINT_STATE and given.roller_angle is not None and not given.omni:
            missing += given.missing("m", steers=True)
        if kind == MODULE_STATES:
            missing = ["modules"] if len(given.modules) < 2 else []
        if kind in WHEELS and missing:
            raise InputError(
                f"{given.topic}: {quoted(kind)} needs {' and '.join(missing)} under odometry in "
                "the topics file"
            )
        if kind not in {"twist": TWISTS, "pose": POSES, None: (kind,)}[given.use]:
            raise InputError(
                f"{given.topic}: {quoted(kind)} has no {given.use}; change use in the topics file"
            )

    def add(self, t: float, message: Any) -> None:
        """Add the message of time `t` [s]."""
        if self._joints is not None:
            row = self._joints.row(message)
            if row is not None:
                self._rows.append((t, *row))
            return
        if self._kind in ACKERMANN:
            drive = getattr(message, "drive", message)
            self._rows.append((t, float(drive.speed), float(drive.steering_angle)))
            return
        if self._kind == MODULE_STATES:
            if len(message.speeds) != len(self._given.modules):
                raise InputError(
                    f"{self._given.topic}: states of {len(message.speeds)} modules, but modules has"
                    f" {len(self._given.modules)} positions"
                )
            self._rows.append((t, *message.speeds, *message.angles))
            return
        nothing = (math.nan,) * 3
        if self._kind in TRANSFORMS:
            parent, child = self._given.frames
            names = {child, "base_footprint"} if child == "base_link" else {child}
            if frame_of(message) != parent or message.child_frame_id.strip("/") not in names:
                return
            place, rotation = message.transform.translation, message.transform.rotation
            self._rows.append((t, *nothing, float(place.x), float(place.y), yaw(rotation)))
            return
        if self._given.v and self._given.omega:
            paths = self._given.v, self._given.omega, self._given.vy
            twist = tuple(values(message, path)[0] if path else 0.0 for path in paths)
        else:
            twist = twist_of(message) if self._kind in TWISTS else nothing
        pose = pose_of(message) if self._kind in POSES else nothing
        self._rows.append((t, *map(float, (*twist, *pose))))

    def add_imu(self, t: float, message: Any) -> None:
        """Add the message of the topic `yaw_rate` of time `t` [s]."""
        self._yaw_rates.append((t, float(message.angular_velocity.z)))

    def odometry(self, remarks: Remarks) -> Odometry:
        """Return the odometry of all messages; `remarks` counts anomalies.

        `InputError` where no message has finite numbers, orientations of the poses are zero, or
        the topic `yaw_rate` contradicts the odometry.
        """
        odometry, source = self._without_imu(remarks), self._given.yaw_rate
        if source is None:
            return odometry
        repeats = "yaw rates with the time of another, left out"
        t, rate = clean_rows(self._yaw_rates, source, "yaw rates", repeats, remarks).T
        return with_yaw_rate(odometry, t, rate, source, remarks)

    def _without_imu(self, remarks: Remarks) -> Odometry:
        if not self._rows:
            what = "message contains odometry"
            if self._kind in TRANSFORMS:
                what = "transform from {} to {}; name the frames, as in frames: [odom, base_link]"
            raise InputError(f"{self._given.topic}: no {what.format(*self._given.frames)}")
        rows = np.array(self._rows, float)
        if self._kind in WHEELS:
            rows = self._clean(rows, remarks)
            if self._joints is not None:
                return self._joints.odometry(rows[:, 0], rows[:, 1:], remarks)
            if self._kind == MODULE_STATES:
                speeds, angles = np.split(rows[:, 1:], 2, axis=1)
                return swerve(rows[:, 0], speeds, angles, self._given, remarks)
            t, v, steering = rows.T.copy()
            return ackermann(t, v, steering, self._given, remarks)
        if self._by_twist(rows, remarks):
            return without_implausible(Odometry(*self._cleaned_twists(rows, remarks)), remarks)
        self._require_orientations(rows)
        rows = self._clean(rows[:, [0, 4, 5, 6]], remarks)
        return odometry_from_poses(rows[:, 0], rows[:, 1:], remarks)

    def _cleaned_twists(self, rows: np.ndarray, remarks: Remarks) -> np.ndarray:
        """Return t, v, omega, vy, shape (4, n); homeward's own messages may have unknown motion."""
        unknown = np.isnan(rows[:, 1:3]).all(axis=1) & (self._kind == ODOMETRY)
        if not unknown.any():
            return self._clean(rows[:, :4], remarks).T.copy()
        # Zeros replace unknown twists, so that `_clean` keeps the rows.
        marked = np.column_stack([rows[:, 0], np.where(unknown, 0.0, rows[:, 1:4].T).T, unknown])
        t, *twist, lost = self._clean(marked, remarks).T
        return np.stack([t, *np.where(lost > 0, np.nan, twist)])

    def _clean(self, rows: np.ndarray, remarks: Remarks) -> np.ndarray:
        return clean_rows(rows, self._given.topic, "odometry", REPEATED_ODOMETRY, remarks)

    def _require_orientations(self, rows: np.ndarray) -> None:
        """Refuse poses if most have no orientation; otherwise `_clean` drops these."""
        lacking = np.isnan(rows[:, 6]) & np.isfinite(rows[:, 4:6]).all(axis=1)
        if 2 * lacking.sum() <= len(rows):
            return
        first = int(np.argmax(lacking))
        advice = "use: twist" if self._kind in TWISTS else "another topic"
        raise InputError(
            f"{self._given.topic}: the orientation (quaternion) is zero in {int(lacking.sum()):,} "
            f"of {len(rows):,} messages, first in message {first + 1} at {rows[first, 0]:.3f} s; "
            f"poses without a heading give no motion: set {advice} under odometry in a topics file"
        )

    def _by_twist(self, rows: np.ndarray, remarks: Remarks) -> bool:
        """Return whether twists are used, not poses, of rows (n, 7); remark a contradiction."""
        use = self._given.use
        if self._given.v:
            return True
        if self._kind != NAV_ODOMETRY:
            return self._kind in TWISTS
        ordered = rows[np.isfinite(rows).all(axis=1)]
        ordered = ordered[np.unique(ordered[:, 0], return_index=True)[1]]
        found = contradiction(ordered)
        is_short = len(ordered) > 0 and np.ptp(ordered[:, 0]) < MIN_WINDOWS * max(WINDOWS_S)
        if use is None and found is None and is_short and not ordered[:, 1:4].any():
            return _extent(ordered[:, 4:]) <= MIN_MOTION  # a driver without twists
        if found is None:
            return use != "pose"
        poses = found.poses if use is None else use == "pose"
        used, other = ("poses", "twist") if poses else ("twists", "pose")
        choice = f"set use: {other} in the topics file for the other"
        if use is not None:
            choice = "as specified in the topics file"
            if poses != found.poses:
                choice += f", but the {'poses' if found.poses else 'twists'} seem correct"
        remarks.count(CONTRADICTION.format(found.words, used, choice), len(ordered))
        return not poses


def _extent(poses: np.ndarray) -> float:
    """Return the largest extent of x, y [m] and heading [rad] of poses, shape (n, 3)."""
    if not len(poses):
        return 0.0
    return float(np.ptp(np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])]), axis=0).max())
