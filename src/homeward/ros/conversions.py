"""Conversion between ROS 2 messages and those of a live session, and the node's publishers.

Message classes are imported when used, because a robot has only the packages that it needs.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from homeward.drives.cameras.lens import Lens
from homeward.drives.cameras.tag_pose import TagPose
from homeward.drives.measure import roll_and_pitch
from homeward.drives.ros.measurements.extrinsics import BODY_IN_OPTICAL
from homeward.drives.ros.measurements.sightings import SightingRows, TagDetector
from homeward.drives.ros.presets import MOTIONS, NAV_ODOMETRY, row_of
from homeward.drives.ros.settings import BearingsTopic
from homeward.drives.ros.stamps import NANO, Remarks, seconds
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, between, compose
from homeward.geometry.se2 import rotation
from homeward.io.settings import validated
from homeward.io.table import quoted
from homeward.live import messages as msg
from homeward.live.messages import (
    Answer,
    Command,
    Diagnostics,
    EstimateOut,
    LandmarksOut,
    Output,
    line_of,
)
from homeward.runs.report.palette import LEVELS, UNTESTED, colour

JSON = "std_msgs/msg/String"
"""Message type of bearings as JSON."""
TFS = "tf2_msgs/msg/TFMessage"
PLANAR = (0, 1, 5)
"""Indices of x, y and the rotation about z in ROS's 6 x 6 covariances."""
MAX_RANGE_M = 1e4
"""Free distance for scanners with infinite range, such as simulated ones [m]."""
_SPHERE, _LINES, _TEXT = 2, 5, 9
RAY_M = 5.0
"""Length at which a sighting without a range is drawn [m]."""


@cache
def message_class(kind: str) -> Any:
    """Return the class of a type such as ``nav_msgs/msg/Odometry``; ImportError if missing."""
    package, part, name = kind.split("/")
    return getattr(import_module(f"{package}.{part}"), name)


class StampConverter:
    """Converter of ROS stamps to seconds since the first whole second, exact as a double."""

    def __init__(self) -> None:
        self.epoch: int | None = None

    def seconds(self, stamp: Any) -> float:
        """Return the time [s] of a builtin_interfaces/Time."""
        return seconds(stamp.sec * NANO + stamp.nanosec, self._since(stamp.sec))

    def of_unix(self, t: float) -> float:
        """Return the time [s] of Unix time [s]."""
        return t - self._since(t)

    def _since(self, t: float) -> int:
        if self.epoch is None:
            self.epoch = math.floor(t)
        return self.epoch


def odometry_in(message: Any, t: float) -> msg.OdometryIn:
    """Return the twist of a nav_msgs/Odometry at `t` [s], and its pose if that is finite.

    `InputError` where a number is not finite, as in the following functions.
    """
    v, omega, vy, *pose = _motion_of(message)
    known = pose if all(map(math.isfinite, pose)) else None
    return validated(msg.OdometryIn, {"t": t, "v": v, "omega": omega, "vy": vy, "pose": known})


def bearings_in(
    parts: Sequence[Any],
    t: float,
    kind: str,
    topic: BearingsTopic,
    camera: Lens | None,
    place: Pose,
    eye: TagDetector | None = None,
    on_tags: Callable[[dict[str, TagPose], Any], None] | None = None,
    name: str = "",
) -> msg.BearingsIn:
    """Return the bearings of the parts of a message (`parts_of`), read like those of logs.

    `place` is the pose of their camera in the frame of the first one [m, m, rad], and `name` that
    of another camera than the first.

    In images (`PICTURES`) the `eye` detects tags. `on_tags` gets the poses of tags and the header
    of the message. `InputError` where there are none, or a camera model is missing.
    """
    rows = SightingRows(topic, kind, Remarks(), lambda: camera, eye)
    rows.in_reference = place
    for part in parts:
        rows.add(t, part)
    if on_tags is not None:
        on_tags(rows.tag_poses(), parts[0].header)
    columns = rows.columns()
    ids = [str(i) for i in columns["landmark"]]

    def valid(column: str, low: float, high: float) -> dict[str, float]:
        values = zip(ids, columns[column].tolist(), strict=True)
        return {i: value for i, value in values if low < value <= high}

    known = {
        "t": t,
        "camera": name,
        "bearings": dict(zip(ids, columns["bearing"].tolist(), strict=True)),
        "sigmas": valid("sigma", 0.0, math.inf),
        "ranges": valid("range", 0.0, msg.MAX_LENGTH),
        "elevations": valid("elevation", -math.inf, math.pi),
    }
    return validated(msg.BearingsIn, known)


def tilt_in(message: Any, t: float) -> msg.TiltIn:
    """Return the tilt of the robot from the orientation of a sensor_msgs/Imu at `t` [s]."""
    roll, pitch = roll_and_pitch(message.orientation)
    return validated(msg.TiltIn, {"t": t, "roll": roll, "pitch": pitch})


def start_in(message: Any, map_frame: str, home: Pose) -> msg.SetStart:
    """Return the start from a geometry_msgs/PoseWithCovarianceStamped in the map frame.

    `home` is the pose of home in that frame. A message without a frame counts as in it; another
    frame is an `InputError`.
    """
    if (frame := message.header.frame_id.lstrip("/")) not in ("", map_frame.lstrip("/")):
        raise InputError(
            f"initial pose ignored: its frame is {quoted(frame)}, not {quoted(map_frame)}"
        )
    x, y, heading = map(float, between(home, Pose(*_pose_of(message))))
    c = message.pose.covariance
    sigmas = {}
    if (var := max(c[0], c[7])) > 0:
        sigmas["sigma"] = math.sqrt(var)
    if c[35] > 0:
        sigmas["sigma_heading"] = math.sqrt(c[35])
    return validated(msg.SetStart, {"x": x, "y": y, "heading": heading, **sigmas})


def obstacle_in(message: Any, half_angle: float) -> msg.Obstacle:
    """Return the free distance of a LaserScan within `half_angle` [rad] to either side of ahead.

    REP 117: minus infinity is an object too near to be measured, infinity is nothing in range.
    """
    ranges = np.asarray(message.ranges, float)
    angles = message.angle_min + message.angle_increment * np.arange(ranges.size)
    measured = (ranges >= max(message.range_min, 1e-3)) | (ranges == -math.inf)
    ahead = ranges[measured & (np.abs(wrap(angles)) <= half_angle)]
    free = [*np.maximum(ahead, 0.0).tolist(), message.range_max, MAX_RANGE_M]
    return validated(msg.Obstacle, {"distance": min(free)})


def fill_pose(target: Any, pose: Pose) -> None:
    """Fill a geometry_msgs/Pose."""
    target.position.x, target.position.y = float(pose.x), float(pose.y)
    target.orientation.z = math.sin(pose.heading / 2)
    target.orientation.w = math.cos(pose.heading / 2)


def fill_covariance(target: Any, answer: EstimateOut, home: Pose) -> None:
    """Fill the covariance of a geometry_msgs/PoseWithCovariance; `home` is home in the map."""
    xx, xy, xh, yy, yh, hh = answer.covariance or (0.0,) * 6
    rotate = rotation(float(home.heading))
    turned = rotate @ np.array([(xx, xy, xh), (xy, yy, yh), (xh, yh, hh)]) @ rotate.T
    for row, values in zip(PLANAR, turned.tolist(), strict=True):
        for column, value in zip(PLANAR, values, strict=True):
            target.covariance[6 * row + column] = value


def transform(stamp: Any, parent: str, child: str, pose: Pose) -> Any:
    """Return a geometry_msgs/TransformStamped of the child frame in its parent's."""
    message = message_class("geometry_msgs/msg/TransformStamped")()
    message.header.stamp, message.header.frame_id, message.child_frame_id = stamp, parent, child
    inner = message.transform
    inner.translation.x, inner.translation.y = float(pose.x), float(pose.y)
    inner.rotation.z, inner.rotation.w = math.sin(pose.heading / 2), math.cos(pose.heading / 2)
    return message


def diagnostics_out(state: msg.Diagnostics, stamp: Any) -> Any:
    """Return a diagnostic_msgs/DiagnosticArray: status and reason as text, counts as values."""
    array = message_class("diagnostic_msgs/msg/DiagnosticArray")()
    status = message_class("diagnostic_msgs/msg/DiagnosticStatus")()
    pair = message_class("diagnostic_msgs/msg/KeyValue")
    is_ok = state.status is Status.LOCALISED and state.is_accurate and not state.faults
    is_stale = state.status is Status.WAITING
    status.level = status.OK if is_ok else status.STALE if is_stale else status.WARN
    status.name = "homeward"
    status.message = "; ".join([f"{state.status.value}: {state.reason}", *state.faults])
    values = {"homing": state.homing, "can_home": state.cannot_home or "yes"}
    values |= {"accurate": "yes" if state.is_accurate else "no"}
    values |= {"advice": state.advice} if state.advice else {}
    values |= {f"note {k + 1}": note for k, note in enumerate(state.notes)}
    values |= {"waiting": str(state.waiting), "work_ms": f"{state.work_ms:.1f}"}
    status.values = [pair(key=k, value=str(v)) for k, v in (values | state.counts).items()]
    array.header.stamp, array.status = stamp, [status]
    return array


def markers_out(known: msg.LandmarksOut, stamp: Any, frame: str, home: Pose) -> Any:
    """Return a visualization_msgs/MarkerArray, coloured by the probability of having moved.

    `home` is the pose of home in the frame of the markers.
    """
    array = message_class("visualization_msgs/msg/MarkerArray")()
    make = message_class("visualization_msgs/msg/Marker")
    for number, landmark in enumerate(known.landmarks):
        if landmark.x is None or landmark.y is None:
            continue
        chance = landmark.moved_probability
        shade = colour(UNTESTED if chance is None else round(LEVELS * chance))
        for kind, space in ((_SPHERE, "landmarks"), (_TEXT, "names")):
            marker = make(ns=space, id=number, type=kind)
            marker.header.stamp, marker.header.frame_id = stamp, frame
            fill_pose(marker.pose, compose(home, Pose(landmark.x, landmark.y, 0.0)))
            marker.scale.x = marker.scale.y = marker.scale.z = 0.2
            for channel, at in (("r", 1), ("g", 3), ("b", 5)):
                setattr(marker.color, channel, int(shade[at : at + 2], 16) / 255)
            marker.color.a = 1.0
            if kind == _TEXT:
                marker.text, marker.pose.position.z = landmark.landmark, 0.3
            array.markers.append(marker)
    return array


def rays_out(seen: msg.BearingsIn, camera: Pose, stamp: Any, frame: str) -> Any:
    """Return a visualization_msgs/Marker: a line from the camera along each bearing.

    `camera` is the pose of the camera in the frame of the marker; lines last 1 s.
    """
    marker = message_class("visualization_msgs/msg/Marker")(ns="sightings", type=_LINES)
    point = message_class("geometry_msgs/msg/Point")
    marker.header.stamp, marker.header.frame_id = stamp, frame
    fill_pose(marker.pose, camera)
    marker.scale.x, marker.lifetime.sec = 0.02, 1
    marker.color.g = marker.color.a = 1.0
    for landmark, bearing in seen.bearings.items():
        length = seen.ranges.get(landmark, RAY_M)
        end = point(x=length * math.cos(bearing), y=length * math.sin(bearing))
        marker.points += [point(), end]
    return marker


def tag_out(tag: TagPose, header: Any) -> Any:
    """Return a geometry_msgs/PoseWithCovarianceStamped in the optical frame of the camera."""
    message = message_class(POSE)()
    message.header = header
    turn = BODY_IN_OPTICAL @ tag.rotation
    place, quaternion = BODY_IN_OPTICAL @ tag.position, Rotation.from_matrix(turn).as_quat()
    for axis, value in zip("xyz", place.tolist(), strict=True):
        setattr(message.pose.pose.position, axis, value)
    for axis, value in zip("xyzw", quaternion.tolist(), strict=True):
        setattr(message.pose.pose.orientation, axis, value)
    both = np.kron(np.eye(2), BODY_IN_OPTICAL)
    message.pose.covariance = (both @ tag.covariance @ both.T).ravel().tolist()
    return message


POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
_motion_of, _pose_of = row_of(MOTIONS[NAV_ODOMETRY]), row_of(MOTIONS[POSE])


class Publishers:
    """Publishers of a lifecycle node, whose parameters name topics and frames."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._out: dict[str, Any] = {}
        self.home = Pose(0.0, 0.0, 0.0)
        """Home in the map frame."""
        self._seen: msg.BearingsIn | None = None

    def make(self) -> None:
        """Create the publishers; `ImportError` where the package of a message is missing.

        `InputError` where the pose of home in the map is not three finite numbers.
        """
        given = list(self._parameter("home_in_map"))
        if len(given) != 3 or not all(map(math.isfinite, given)):
            raise InputError(f"home_in_map: must be [x, y, heading] in m and rad, not {given}")
        self.home = Pose(*given)
        from rclpy.qos import DurabilityPolicy, QoSProfile

        make = self._node.create_lifecycle_publisher
        # Subscriptions to AMCL's pose, as Nav2's commander has one, require this durability.
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        stamped = "Stamped" if self._parameter("cmd_vel_stamped") else ""
        topics = {
            "said": (JSON, "~/said"),
            "pose": (POSE, "~/pose"),
            "smoothed": (POSE, "~/smoothed_pose"),
            "diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", "/diagnostics"),
            "landmarks": ("visualization_msgs/msg/MarkerArray", "~/landmarks"),
            "sightings": ("visualization_msgs/msg/Marker", "~/sightings"),
            "cmd_vel": (f"geometry_msgs/msg/Twist{stamped}", self._parameter("cmd_vel_topic")),
            "transform": ("geometry_msgs/msg/TransformStamped", "~/map_to_odom"),
            "dock": ("geometry_msgs/msg/PoseStamped", "detected_dock_pose"),
        }
        self._out = {
            key: make(message_class(kind), topic, latched if key == "pose" else 10)
            for key, (kind, topic) in topics.items()
        }
        try:
            self._out["tf"] = make(message_class(TFS), "/tf", 10)
        except ImportError:
            words = "tf2_msgs is not installed: map to odom is published on ~/map_to_odom only"
            self._node.get_logger().warning(words)

    def destroy(self) -> None:
        """Destroy the publishers."""
        for publisher in self._out.values():
            self._node.destroy_publisher(publisher)
        self._out = {}

    def keep(self, message: msg.Input | msg.PlaceChanged | msg.Output) -> None:
        """Keep the bearings that a session processes, for the answer to them."""
        if isinstance(message, msg.BearingsIn):
            self._seen = message

    def output(self, out: Output, epoch_ns: int, camera: Pose) -> None:
        """Publish output of a session; poses and landmarks also as their ROS messages.

        Stamps of `out` are those of ROS minus an epoch [ns]; `camera` is its pose on the robot.
        """
        self._line(out)
        if isinstance(out, EstimateOut) and out.pose is not None:
            message = message_class(POSE)()
            self._fill_header(message.header, "map_frame", out.t, epoch_ns)
            robot, header = compose(self.home, Pose(*out.pose)), message.header
            fill_pose(message.pose.pose, robot)
            fill_covariance(message.pose, out, self.home)
            self._out["pose" if isinstance(out, Answer) else "smoothed"].publish(message)
            if isinstance(out, Answer) and self._seen is not None:
                at = compose(robot, camera)
                rays = rays_out(self._seen, at, header.stamp, header.frame_id)
                self._out["sightings"].publish(rays)
        if isinstance(out, LandmarksOut):
            frame = self._parameter("map_frame")
            markers = markers_out(out, self._now(), frame, self.home)
            self._out["landmarks"].publish(markers)

    def tags(self, found: Mapping[str, TagPose], header: Any) -> None:
        """Publish the pose of each tag in the optical frame of its camera, on a topic of its own.

        Stamp and frame are those of a message's `header`.
        """
        for name, tag in found.items():
            topic = "~/tag_" + re.sub(r"\W", "_", name, flags=re.ASCII)
            if topic not in self._out:  # created by an active node: no lifecycle publisher
                self._out[topic] = self._node.create_publisher(message_class(POSE), topic, 10)
            self._out[topic].publish(tag_out(tag, header))

    def dock(self, dock: Pose | None, t: float, epoch_ns: int) -> None:
        """Publish the dock's pose in the robot's frame at `t` [s], if it is known."""
        if dock is not None:
            message = message_class("geometry_msgs/msg/PoseStamped")()
            self._fill_header(message.header, "base_frame", t, epoch_ns)
            fill_pose(message.pose, dock)
            self._out["dock"].publish(message)

    def _fill_header(self, header: Any, frame: str, t: float, epoch_ns: int) -> None:
        header.frame_id = self._parameter(frame)
        header.stamp.sec, header.stamp.nanosec = divmod(round(t * NANO) + epoch_ns, NANO)

    def command(self, command: Command) -> None:
        """Publish a command, with or without a stamp."""
        stamped = self._parameter("cmd_vel_stamped")
        message = message_class(f"geometry_msgs/msg/Twist{'Stamped' * stamped}")()
        if stamped:
            message.header.stamp = self._now()
        twist = message.twist if stamped else message
        twist.linear.x, twist.linear.y = float(command.v), float(command.vy)
        twist.angular.z = float(command.omega)
        self._out["cmd_vel"].publish(message)
        self._line(command)

    def transform(self, map_to_odom: Pose) -> None:
        """Publish the odometry frame in the map frame, from its pose in the home frame."""
        frames = self._parameter("map_frame"), self._parameter("odom_frame")
        stamp = self._now()
        later = round(self._parameter("transform_tolerance") * NANO)
        stamp.sec, stamp.nanosec = divmod(stamp.sec * NANO + stamp.nanosec + later, NANO)
        message = transform(stamp, *frames, compose(self.home, map_to_odom))
        self._out["transform"].publish(message)
        if "tf" in self._out:
            self._out["tf"].publish(message_class(TFS)(transforms=[message]))

    def diagnostics(self, state: Diagnostics) -> None:
        """Publish the state of the session."""
        self._out["diagnostics"].publish(diagnostics_out(state, self._now()))
        self._line(state)

    def _line(self, out: Output) -> None:
        """Publish output of a session as one line of JSON."""
        self._out["said"].publish(message_class(JSON)(data=line_of(out).rstrip()))

    def _parameter(self, name: str) -> Any:
        return self._node.get_parameter(name).value

    def _now(self) -> Any:
        return self._node.get_clock().now().to_msg()
