"""Odometry from messages: twists, differentiated poses, wheel angles, or steering.

Where a nav_msgs/Odometry has twists and poses that contradict each other, the usable ones count.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np

from homeward.drives.drive import Odometry
from homeward.drives.folder import REPEATED_ODOMETRY
from homeward.drives.measure import motion
from homeward.drives.plausibility import steps_between, without_implausible
from homeward.drives.ros.kinds import ODOMETRY
from homeward.drives.ros.measurements.sightings import frame_of
from homeward.drives.ros.presets import (
    JOINT_STATE,
    MOTIONS,
    POSES,
    TRANSFORMS,
    TWISTS,
    WHEELS,
    row_of,
)
from homeward.drives.ros.settings import OdometryTopic
from homeward.drives.ros.stamps import Remarks, clean_rows
from homeward.drives.ros.wpilog import MODULE_STATES
from homeward.drives.wheels import FOUR, OMNI, PAIR, missing_geometry, of_wheels, wheel_speeds
from homeward.errors import InputError
from homeward.io.table import quoted
from homeward.odometry.validity import MAX_SPEED, TWIST_VALIDITY_S

WINDOWS_S = 1.0, 5.0
"""Intervals over which motions are compared [s]; the second for slow robots."""
MIN_MOTION = 0.05
"""Minimum motion in an interval [m, rad]; a smaller one may be noise of the poses."""
MIN_WINDOWS = 5
"""Minimum number of intervals with motion."""
MAX_GAIN_ERROR = 1 / 3
"""Maximum error of the gain between the two motions: the geometric middle between 0.1, the
calibration error of a poor robot, and 1, the error of a wrong frame, unit or sign."""
MAX_STILL = 1 / 3
"""Maximum share of the moving intervals in which one of the two does not move."""
STILL = 1e-4
"""Ratio to the other motion below which a motion counts as none."""
MIN_PERSISTENCE = 1.5
"""Minimum mean square of the motion over two intervals, as a multiple of that over one: it is 4 in
steady motion, 2 in a random walk, and 1 for white noise of the poses at standstill."""
DEVIATIONS = 3.0
"""Number of standard errors by which a wrong gain exceeds `MAX_GAIN_ERROR`."""
MIN_RESIDUAL = 0.05
"""Share of the motion below which residuals are ignored."""
BETTER = 4.0
"""Minimum factor by which another frame must reduce the squared residuals."""


class SourceContradiction(NamedTuple):
    """A contradiction, and the usable one of poses and twists."""

    words: str
    """Description of the contradiction."""
    poses: bool
    """Whether the poses are usable; else the twists."""


def contradiction(rows: np.ndarray) -> SourceContradiction | None:
    """Compare the twists of messages with the motion of their poses; None where they agree.

    `rows` (n, 7) are t [s], forward speed [m/s], yaw rate [rad/s], sideways speed [m/s], x [m], y
    [m] and heading [rad]; t increases.
    """
    rows = rows[np.isfinite(rows).all(axis=1)]
    if len(rows) < 3:
        return None
    short, long = (_motions(rows, window) for window in WINDOWS_S)
    twist, pose, odom = (short if _enough(*short[:2]) else long)[:3]
    path, turn = _relation(twist, pose), _relation(*(short if _enough(*short[3:]) else long)[3:])
    if "pose" in (path, turn):
        return SourceContradiction("the poses do not move while the twists do", False)
    moves = np.maximum(np.abs(twist), np.abs(pose)) > MIN_MOTION
    residual, in_odom = (np.square(np.abs(p - twist)[moves]).sum() for p in (pose, odom))
    min_residual = np.square(MIN_RESIDUAL * np.abs(twist[moves])).sum()
    is_in_odom = _enough(twist, pose) and residual > max(min_residual, BETTER * in_odom)
    if path is None and turn is None and not is_in_odom:
        return None
    speed = np.abs(pose[moves]).sum() / max(np.ptp(rows[:, 0]), 1e-9)
    if is_in_odom:  # the same motion, also where the robot moves sideways
        words = "the twists are in the odom frame, not in the robot's"
        return SourceContradiction(words, bool(speed <= MAX_SPEED))
    is_coherent = np.square(pose.imag).sum() <= np.square(pose.real).sum()
    if "twist" in (path, turn):
        still = " and ".join(n for n, r in (("speed", path), ("yaw rate", turn)) if r == "twist")
        words = f"the {still} of the twists is zero while the poses move"
    else:
        both = ("translation", path), ("rotation", turn)
        gains = " and ".join(f"{gain} in {what}" for what, gain in both if gain is not None)
        words = f"the motion of the poses is {gains}"
    return SourceContradiction(words, bool(is_coherent and speed <= MAX_SPEED))


def _enough(twist: np.ndarray, pose: np.ndarray) -> bool:
    """Return whether enough intervals have a motion."""
    return bool((np.maximum(np.abs(twist), np.abs(pose)) > MIN_MOTION).sum() >= MIN_WINDOWS)


def _motions(rows: np.ndarray, window: float) -> list[np.ndarray]:
    """Return the motion in intervals of twists, of poses in the robot's and in the odom frame.

    Then the rotation of twists and of poses [rad]. Translations are complex, forward + i left [m].
    """
    t, dt = rows[:, 0], np.diff(rows[:, 0])
    forward, turned, left = ((rows[1:, 1:4] + rows[:-1, 1:4]) / 2 * dt[:, None]).T
    steps = steps_between(rows[:, 4:])
    odom = np.diff(rows[:, 4]) + 1j * np.diff(rows[:, 5])
    # Intervals with a jump of the poses do not count.
    rates = (np.append(steps[k] / dt, 0.0) for k in (0, 2, 1))
    known = without_implausible(Odometry(t, *rates), {}).v[:-1]
    use = np.isfinite(known) & (dt <= 2 * TWIST_VALIDITY_S)
    number = ((t[:-1] - t[0]) / max(window, float(np.median(dt)))).astype(int)
    motions = forward + 1j * left, steps[0] + 1j * steps[1], odom, turned, steps[2]
    used = (np.where(use, motion, 0j) for motion in motions)
    return [np.bincount(number, u.real) + 1j * np.bincount(number, u.imag) for u in used]


def _relation(twist: np.ndarray, pose: np.ndarray) -> str | None:
    """Return None where both agree, "twist" or "pose" where that one does not move, or the gain."""
    size = np.abs(twist), np.abs(pose)
    moves = np.maximum(*size) > MIN_MOTION
    if not _enough(twist, pose):
        return None
    twist_still, pose_still = (moves & (a <= STILL * b) for a, b in (size, size[::-1]))
    for name, still in (("pose", pose_still), ("twist", twist_still)):
        if still.sum() > MAX_STILL * moves.sum():
            double = np.square(np.abs(pose[1:] + pose[:-1])).mean()
            is_noise = double <= MIN_PERSISTENCE * np.square(np.abs(pose)).mean()
            return None if name == "twist" and is_noise else name
    both = ~(twist_still | pose_still)  # also at standstill, where noise has little weight
    power = float(np.square(size[0][both]).sum())
    if not power > 0:
        return None
    gain = (np.conj(twist[both]) * pose[both]).sum() / power
    rest = np.square(np.abs(pose[both] - gain * twist[both])).sum()
    error = float(np.sqrt(rest / max(moves.sum() - 1, 1) / power))
    if abs(gain - 1) <= MAX_GAIN_ERROR + DEVIATIONS * error:
        return None
    if abs(gain.imag) > 0.1 * abs(gain):
        angle = np.degrees(np.angle(gain))
        return f"{abs(gain):.3g} x that of the twists, rotated by {angle:.0f} deg,"
    return f"{gain.real:.3g} x that of the twists"


Columns: TypeAlias = "dict[str, np.ndarray]"
"""Columns (n,) by role."""


class JointRows:
    """The wheels of a robot in sensor_msgs/JointState."""

    def __init__(self, given: OdometryTopic) -> None:
        self._given = given
        self._is_mecanum = given.roller_angle is not None and not given.omni
        self._wheels: dict[str, str] = {}
        """Names of wheels by joint, as in `of_wheels`."""
        self._by_position = False

    @property
    def missing(self) -> list[str]:
        """The keys of the geometry that are missing."""
        names = OMNI if self._given.omni else FOUR if self._is_mecanum else PAIR
        return missing_geometry(self._given, names, "rad")

    def row(self, message: Any) -> list[float] | None:
        """Return the position (or rate) of each wheel; None if one is missing."""
        names = list(message.name)
        if not self._wheels:
            self._wheels = self._found(names)
            self._by_position = len(message.position) == len(names)
        values = message.position if self._by_position else message.velocity
        if not self._wheels or len(values) != len(names) or not self._wheels.keys() <= set(names):
            return None
        return [float(values[names.index(joint)]) for joint in self._wheels]

    def _found(self, names: list[str]) -> dict[str, str]:
        """Return the wheels by joint, left ones first; none if a side has no joint."""
        given = self._given
        if given.omni:
            return {joint: f"omni_{k}" for k, joint in enumerate(given.omni, 1)}
        sides = (given.left, "left"), (given.right, "right")
        left, right = (
            [name for name in wanted or names if name in names and (wanted or side in name.lower())]
            for wanted, side in sides
        )
        is_complete = set(given.left) <= set(left) and set(given.right) <= set(right)
        if not (left and right and is_complete) or (self._is_mecanum and len(left + right) != 4):
            return {}
        if not self._is_mecanum:
            return dict.fromkeys(left, "left") | dict.fromkeys(right, "right")
        front_left, rear_left, front_right, rear_right = (
            *sorted(left, key=_is_rear),
            *sorted(right, key=_is_rear),
        )
        return dict(zip((front_left, front_right, rear_left, rear_right), FOUR, strict=True))

    def odometry(self, t: np.ndarray, rows: np.ndarray, remarks: dict[str, int]) -> Odometry:
        """Return the odometry of `row` of all messages, (n, k), at `t` (n,) [s]."""
        given = self._given
        unit = "rad" if given.ticks_per_turn is None else "ticks"
        speeds = wheel_speeds(t, rows, given, unit, remarks, self._by_position)
        return of_wheels(t, speeds, list(self._wheels.values()), given, remarks)


def _is_rear(joint: str) -> bool:
    """Whether a joint is of a rear wheel, from its name."""
    return any(word in joint.lower() for word in ("rear", "back"))


CONTRADICTION = (
    "odometry messages whose twists and poses contradict each other: {}; the {} are used ({})"
)

TWIST, POSE = ("v", "omega", "vy"), ("x", "y", "heading")
"""Roles of the two sources of a nav_msgs/Odometry."""
STATES = "speed", "angle"
"""Ends of the roles of swerve modules."""


class OdometryRows:
    """The odometry of a topic, collected while a log is read."""

    def __init__(self, given: OdometryTopic, kind: str) -> None:
        self._given, self._kind = given, kind
        self._joints = JointRows(given) if kind == JOINT_STATE else None
        self._rows: list[tuple[float, ...]] = []
        missing = given.missing("m", steers=True) if self._joints is None else self._joints.missing
        if kind == MODULE_STATES:
            missing = ["modules"] if len(given.modules) < 2 else []
        if kind in WHEELS and missing:
            problem = f"{quoted(kind)} needs {' and '.join(missing)}"
            advice = "give the geometry of the wheels under odometry in the topics file"
            raise InputError(problem, part=given.topic, advice=advice)
        if kind not in {"twist": TWISTS, "pose": POSES, None: (kind,)}[given.use]:
            advice = "change use in the topics file"
            raise InputError(f"{quoted(kind)} has no {given.use}", part=given.topic, advice=advice)
        paths = {role: path for role in TWIST if (path := getattr(given, role))}
        self._paths = paths if given.v and given.omega else MOTIONS.get(kind, {})
        self._row = row_of(self._paths)
        if kind == MODULE_STATES:
            numbers = range(1, len(given.modules) + 1)
            self._paths = {f"module_{k}_{what}": "" for what in STATES for k in numbers}
            self._row = self._states

    def add(self, t: float, message: Any) -> None:
        """Add the message of time `t` [s]."""
        if self._joints is not None:
            if (row := self._joints.row(message)) is not None:
                self._rows.append((t, *row))
            return
        if self._kind in TRANSFORMS:
            parent, child = self._given.frames
            names = {child, "base_footprint"} if child == "base_link" else {child}
            if frame_of(message) != parent or message.child_frame_id.strip("/") not in names:
                return
        self._rows.append((t, *self._row(message)))

    def _states(self, message: Any) -> tuple[float, ...]:
        if len(message.speeds) != len(self._given.modules):
            raise InputError(
                f"states of {len(message.speeds)} modules, but modules has "
                f"{len(self._given.modules)} positions"
            )
        return *message.speeds, *message.angles

    def odometry(self, remarks: Remarks) -> Odometry:
        """Return the odometry of all messages; `remarks` counts anomalies.

        `InputError` where no message has finite numbers, or orientations of the poses are zero.
        """
        if not self._rows:
            problem, advice = "no message contains odometry", None
            if self._kind in TRANSFORMS:
                problem = "no transform from {} to {}".format(*self._given.frames)
                advice = "name the frames, as in frames: [odom, base_link]"
            raise InputError(problem, part=self._given.topic, advice=advice)
        rows = np.array(self._rows, float)
        if self._joints is not None:
            rows = self._clean(rows, remarks)
            return self._joints.odometry(rows[:, 0], rows[:, 1:], remarks)
        columns = dict(zip(("t", *self._paths), rows.T, strict=True))
        if columns.keys() >= {*TWIST, *POSE}:
            unused = POSE if self._by_twist(columns, remarks) else TWIST
            columns = {role: column for role, column in columns.items() if role not in unused}
        if "heading" in columns:
            self._require_orientations(columns)
        unknown = None
        if self._kind == ODOMETRY:  # homeward's own messages may have unknown motion
            unknown = np.isnan(columns["v"]) & np.isnan(columns["omega"])
        rows = self._clean(np.column_stack(list(columns.values())), remarks, unknown)
        return motion(dict(zip(columns, rows.T.copy(), strict=True)), self._given, remarks)

    def _clean(
        self, rows: np.ndarray, remarks: Remarks, unknown: np.ndarray | None = None
    ) -> np.ndarray:
        what = self._given.topic, "odometry", REPEATED_ODOMETRY
        return clean_rows(rows, *what, remarks, unknown)

    def _require_orientations(self, columns: Columns) -> None:
        """Refuse poses if most have no orientation; otherwise `_clean` drops these."""
        place = columns["x"] + columns["y"]
        lacking = np.isnan(columns["heading"]) & np.isfinite(place)
        if 2 * lacking.sum() <= place.size:
            return
        first = int(np.argmax(lacking))
        advice = "use: twist" if self._kind in TWISTS else "another topic"
        raise InputError(
            f"the orientation (quaternion) is zero in {int(lacking.sum()):,} of "
            f"{place.size:,} messages, first in message {first + 1} at "
            f"{columns['t'][first]:.3f} s; poses without a heading give no motion",
            part=self._given.topic,
            advice=f"set {advice} under odometry in a topics file",
        )

    def _by_twist(self, columns: Columns, remarks: Remarks) -> bool:
        """Return whether twists are used, not poses; remark a contradiction."""
        use = self._given.use
        rows = np.column_stack([columns[role] for role in ("t", *TWIST, *POSE)])
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
