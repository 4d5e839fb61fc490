"""Odometry from messages: twists, differentiated poses, or wheel angles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from homeward.drives.drive import Odometry
from homeward.drives.folder import REPEATED_ODOMETRY
from homeward.drives.plausibility import MIN_JUMP, odometry_from_poses, without_implausible
from homeward.drives.ros.measurements.contradiction import (
    MIN_MOTION,
    MIN_WINDOWS,
    WINDOWS_S,
    contradiction,
)
from homeward.drives.ros.measurements.rows import Remarks, clean_rows
from homeward.drives.ros.settings import ODOMETRY, POSE, OdometryTopic
from homeward.errors import InputError
from homeward.io.table import quoted

BITS = 8, 15, 16, 24, 31, 32
"""Sizes of wheel counters; a wrap-around is a step of 2^bits, for signed and unsigned ones."""
WRAPPED = "wrap-arounds of wheel counters, corrected"


class Wheels:
    """Wheels of a robot in sensor_msgs/JointState."""

    def __init__(self, given: OdometryTopic) -> None:
        if given.wheel_radius is None or given.track_width is None:
            raise InputError(
                f"{given.topic}: joint states need wheel_radius and track_width under odometry in "
                "the topics file"
            )
        self._given = given
        self._radius, self._track = given.wheel_radius, given.track_width
        self._by_position: bool | None = None
        self._wheels: tuple[list[str], list[str]] | None = None

    def row(self, message: Any) -> list[float] | None:
        """Return the angle (or rate) of each wheel, left ones first; None if one is missing."""
        names = list(message.name)
        if self._wheels is None:
            left = self._joints(names, self._given.left, "left")
            right = self._joints(names, self._given.right, "right")
            if not left or not right:
                return None
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

    def odometry(self, t: np.ndarray, wheels: np.ndarray, remarks: dict[str, int]) -> Odometry:
        """Return the odometry of wheels, shape (n, k) [rad or rad/s], at `t`, shape (n,) [s].

        Wrap-arounds of counters are corrected; other implausible motion is unknown. `remarks`
        counts both.
        """
        assert self._wheels is not None
        if self._by_position:
            tolerance = MIN_JUMP / self._radius
            parts = [_unwrapped(column, tolerance, remarks) for column in wheels.T]
            steps = np.diff(t)[:, None]
            last = np.zeros((1, wheels.shape[1]))
            wheels = np.concatenate([np.diff(np.stack(parts, axis=1), axis=0) / steps, last])
        count = len(self._wheels[0])
        left = self._radius * wheels[:, :count].mean(axis=1)
        right = self._radius * wheels[:, count:].mean(axis=1)
        odometry = Odometry(t, (left + right) / 2, (right - left) / self._track)
        return without_implausible(odometry, remarks)


def _unwrapped(angle: np.ndarray, tolerance: float, remarks: dict[str, int]) -> np.ndarray:
    """Return a wheel's angle [rad] without the wrap-arounds of its counter.

    A step is a wrap-around where, without the span of a counter, it differs by at most `tolerance`
    [rad] from the step before. Spans are a full turn, 2^bits times the smallest unit of the angle,
    or 2^bits where the angle is counted in ticks.
    """
    if angle.size < 3:
        return angle
    step = np.diff(angle)
    unit = _unit(step)
    spans = [math.tau, *(2.0**bits * size for size in {1.0, unit} if size for bits in BITS)]
    usual = np.median(np.abs(step))
    wraps = 0
    for i in np.flatnonzero(np.abs(step) > tolerance + 4.0 * usual).tolist():
        before = step[i - 1] if i else 0.0
        span = min(spans, key=lambda s: abs(abs(step[i] - before) - s))
        if abs(abs(step[i] - before) - span) <= tolerance:
            step[i] -= math.copysign(span, step[i])
            wraps += 1
    if wraps:
        remarks[WRAPPED] = remarks.get(WRAPPED, 0) + wraps
    return np.append(angle[0], angle[0] + np.cumsum(step))


def _unit(step: np.ndarray) -> float:
    """Return the angle of one tick, which divides all steps; 0 without one."""
    size = np.unique(np.abs(step[step != 0.0]))
    gaps = np.diff(np.append(0.0, size))
    # Equal steps differ by rounding errors.
    gaps = gaps[gaps > 1e-6 * np.median(size)] if size.size else gaps
    if not gaps.size:
        return 0.0
    unit = float(gaps.min())
    small = size[size < 1e5 * unit]
    if not small.size:
        return 0.0
    number = np.round(small / unit)
    unit = float(small @ number / (number @ number))
    return unit if np.abs(small / unit - number).max() < 0.1 else 0.0


NAV_ODOMETRY = "nav_msgs/msg/Odometry"
JOINT_STATE = "sensor_msgs/msg/JointState"
TWISTS = (
    ODOMETRY,
    NAV_ODOMETRY,
    "geometry_msgs/msg/TwistWithCovarianceStamped",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/Twist",
)
"""Types with a twist, in order of preference."""
POSES = (
    POSE,
    NAV_ODOMETRY,
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PoseStamped",
)
"""Types with a pose."""
SIDEWAYS = "odometry messages with a sideways speed, which is ignored"
SIDEWAYS_SHARE = 0.1
"""Minimum sideways speed, as a share of the forward speed; less is noise."""
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
        self._wheels = Wheels(given) if kind == JOINT_STATE else None
        self._rows: list[tuple[float, ...]] = []
        if kind not in {"twist": TWISTS, "pose": POSES, None: (kind,)}[given.use]:
            raise InputError(
                f"{given.topic}: {quoted(kind)} has no {given.use}; change use in the topics file"
            )

    def add(self, t: float, message: Any) -> None:
        """Add the message of time `t` [s]."""
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
        """Return the odometry of all messages; `remarks` counts anomalies.

        `InputError` where no message has finite numbers, or orientations of the poses are zero.
        """
        if not self._rows:
            raise InputError(f"{self._given.topic}: no message contains odometry")
        rows = np.array(self._rows, float)
        if self._wheels is not None:
            rows = self._clean(rows, remarks)
            return self._wheels.odometry(rows[:, 0], rows[:, 1:], remarks)
        if self._by_twist(rows, remarks):
            with np.errstate(invalid="ignore"):
                sideways = np.abs(rows[:, 3]) > SIDEWAYS_SHARE * np.abs(rows[:, 1]) + 1e-3
            remarks.count(SIDEWAYS, int(sideways.sum()))
            return without_implausible(Odometry(*self._cleaned_twists(rows, remarks)), remarks)
        self._require_orientations(rows)
        rows = self._clean(rows[:, [0, 4, 5, 6]], remarks)
        return odometry_from_poses(rows[:, 0], rows[:, 1:], remarks)

    def _cleaned_twists(self, rows: np.ndarray, remarks: Remarks) -> np.ndarray:
        """Return t, v and omega, shape (3, n); homeward's own messages may have unknown motion."""
        unknown = np.isnan(rows[:, 1:3]).all(axis=1) & (self._kind == ODOMETRY)
        if not unknown.any():
            return self._clean(rows[:, :3], remarks).T.copy()
        # Zeros replace unknown twists, so that `_clean` keeps the rows.
        marked = np.column_stack([rows[:, 0], np.where(unknown, 0.0, rows[:, 1:3].T).T, unknown])
        t, v, omega, lost = self._clean(marked, remarks).T
        return np.stack([t, *np.where(lost > 0, np.nan, [v, omega])])

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
