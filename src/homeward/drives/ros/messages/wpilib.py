"""Values in WPILib data logs that are odometry, poses or bearings, and their decoding.

Layouts, all little-endian and without padding, from public sources:

- struct:ChassisSpeeds (struct:ChassisVelocities from 2027): vx, vy [m/s], omega [rad/s];
  struct:Pose2d: x, y [m], heading [rad] (allwpilib, wpimath, the schemas of the structs).
- struct:SwerveModuleState[] (struct:SwerveModuleVelocity[] from 2027): speed [m/s] and angle from
  ahead [rad] of each module (as above).
- double[] of a Field2d robot: x, y [m], heading [deg] (allwpilib, FieldObject2d); CTRE's swerve
  telemetry publishes robotPose in the same form.
- photonstruct:PhotonPipelineResult of PhotonVision from 2025: photon-serde/messages.yaml in
  PhotonVision/photonvision. A target's position is x ahead, y left, z up from the camera [m], and
  zero in 2D pipelines. Its yaw, positive to the right [deg], is not used.
- double[] rawfiducials of a Limelight: id, txnc [deg, positive right], tync [deg, positive up],
  area, distance to the camera [m], distance to the robot [m], ambiguity of each tag
  (docs.limelightvision.io, NetworkTables API; RawFiducial in LimelightHelpers).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

CHASSIS_SPEEDS = "struct:ChassisSpeeds"
MODULE_STATES = "struct:SwerveModuleState[]"
POSE2D = "struct:Pose2d"
ROBOT_ON_FIELD = "double[] (x, y, degrees)"
PHOTON_RESULT = "photonstruct:PhotonPipelineResult"
RAW_FIDUCIALS = "double[] (Limelight rawfiducials)"
ON_CHANGE = (CHASSIS_SPEEDS, MODULE_STATES, POSE2D, ROBOT_ON_FIELD)
"""Types of odometry; NetworkTables and AdvantageKit log a value only when it changes."""
PLAIN = ("boolean", "int64", "float", "double", "string", "json", "raw", "msgpack")
"""Types of single values; arrays of them end in []."""
MAX_LATENCY_US = 1_000_000
"""Maximum time from the exposure of an image to its result [us]."""
_TARGET = struct.Struct("<4d 2i f 7d 7d d")
_TARGET_ID, _TARGET_POSITION = 4, slice(7, 10)
_PNP_BYTES, _CORNER_BYTES, _ID_BYTES = 17 * 8, 16, 2


def type_of(name: str, kind: str) -> str:
    """Return the type of an entry, as one of the types of this module where it is read."""
    of_2027 = {
        "struct:ChassisVelocities": CHASSIS_SPEEDS,
        "struct:SwerveModuleVelocity[]": MODULE_STATES,
    }
    if kind in of_2027:
        return of_2027[kind]
    if kind.startswith(f"{PHOTON_RESULT}:"):
        return PHOTON_RESULT
    last = name.rpartition("/")[2]
    if kind == "double[]" and last == "rawfiducials":
        return RAW_FIDUCIALS
    return ROBOT_ON_FIELD if kind == "double[]" and last in ("Robot", "robotPose") else kind


def is_plain(kind: str) -> bool:
    """Whether a type is a value, an array of values or a schema, so that it needs no remark."""
    return kind.removesuffix("[]") in PLAIN or kind.endswith("schema") or kind in _DECODERS


def exposure_time(t: int, data: bytes) -> int:
    """Return the time of exposure of a `PHOTON_RESULT` that was logged at `t`, both [us].

    Both stamps in a result are of one clock, in microseconds, or in nanoseconds from 2027.
    """
    if len(data) < 24:
        return t
    exposed, published = struct.unpack_from("<2q", data, 8)
    latency = published - exposed
    if latency >= MAX_LATENCY_US:
        latency //= 1000
    return t - latency if 0 <= latency < MAX_LATENCY_US else t


def decode(kind: str, data: bytes) -> Any:
    """Return a value with the fields of the ROS message of the same content.

    `struct.error`, `IndexError` or `ValueError` where it does not match its type.
    """
    if kind not in _DECODERS:
        raise ValueError("a type that is not read")
    return _DECODERS[kind](data)


def _chassis_speeds(data: bytes) -> Any:
    vx, vy, omega = struct.unpack("<3d", data)
    return SimpleNamespace(linear=SimpleNamespace(x=vx, y=vy), angular=SimpleNamespace(z=omega))


def _module_states(data: bytes) -> Any:
    speeds, angles = zip(*struct.iter_unpack("<2d", data), strict=True)
    return SimpleNamespace(speeds=speeds, angles=angles)


def _pose(data: bytes) -> Any:
    x, y, heading = struct.unpack("<3d", data)
    return SimpleNamespace(x=x, y=y, heading=heading)


def _robot_on_field(data: bytes) -> Any:
    pose = _pose(data)
    pose.heading = math.radians(pose.heading)
    return pose


def _photon_result(data: bytes) -> Any:
    return SimpleNamespace(tags=list(_photon_tags(data)))


def _photon_tags(data: bytes) -> Iterator[Any]:
    """Yield each target."""
    count, at = data[32], 33
    for _ in range(count):
        target = _TARGET.unpack_from(data, at)
        at += _TARGET.size
        for _ in ("corners of the rectangle", "detected corners"):
            at += 1 + _CORNER_BYTES * data[at]
        yield _tag(target[_TARGET_ID], *target[_TARGET_POSITION])
    has_pose, at = data[at], at + 1
    if has_pose:
        at += _PNP_BYTES
        at += 1 + _ID_BYTES * data[at]
    if at != len(data):
        raise ValueError(f"{len(data)} bytes instead of {at}: another version of PhotonVision")


def _raw_fiducials(data: bytes) -> Any:
    rows = struct.iter_unpack("<7d", data)
    tags = [_tag(number, *_seen(right, up, far)) for number, right, up, _, far, *_ in rows]
    return SimpleNamespace(tags=tags)


def _tag(number: float, x: float, y: float, z: float) -> Any:
    """Return a tag; its id is empty for an object without one."""
    name = f"{number:.0f}" if 0 <= number < math.inf else ""
    return SimpleNamespace(id=name, position=SimpleNamespace(x=x, y=y, z=z))


def _seen(right_deg: float, up_deg: float, distance: float) -> tuple[float, float, float]:
    """Return the position of a tag at two angles from the optical axis and a distance [m]."""
    yaw = math.radians(-right_deg)
    x, y, z = math.cos(yaw), math.sin(yaw), math.tan(math.radians(up_deg)) * math.cos(yaw)
    scale = distance / math.hypot(1.0, z)
    return scale * x, scale * y, scale * z


_DECODERS: dict[str, Callable[[bytes], Any]] = {
    CHASSIS_SPEEDS: _chassis_speeds,
    MODULE_STATES: _module_states,
    POSE2D: _pose,
    ROBOT_ON_FIELD: _robot_on_field,
    PHOTON_RESULT: _photon_result,
    RAW_FIDUCIALS: _raw_fiducials,
}
