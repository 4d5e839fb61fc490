"""WPILib data logs (.wpilog): their records, and the values that are odometry, poses or bearings.

Source: "WPILib Data Log File Format Specification, Version 1.0" (wpilibsuite/allwpilib,
wpiutil/doc/datalog.adoc): the magic, a version, an extra header, and records of variable-length
fields. Control records, of entry 0, start and finish the other entries.

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
from collections.abc import Callable, Collection, Iterator
from types import SimpleNamespace
from typing import IO, Any, NamedTuple

from homeward.errors import InputError

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


def _chassis_speeds(vx: float, vy: float, omega: float) -> Any:
    return SimpleNamespace(linear=SimpleNamespace(x=vx, y=vy), angular=SimpleNamespace(z=omega))


def _pose(x: float, y: float, heading: float) -> Any:
    return SimpleNamespace(x=x, y=y, heading=heading)


def _robot_on_field(x: float, y: float, degrees: float) -> Any:
    return _pose(x, y, math.radians(degrees))


def _module_states(data: bytes) -> Any:
    speeds, angles = zip(*struct.iter_unpack("<2d", data), strict=True)
    return SimpleNamespace(speeds=speeds, angles=angles)


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


def _raw_fiducials(data: bytes) -> Iterator[Any]:
    """Yield each tag."""
    for number, right, up, _, far, *_ in struct.iter_unpack("<7d", data):
        yield _tag(number, *_seen(right, up, far))


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
    CHASSIS_SPEEDS: lambda data: _chassis_speeds(*struct.unpack("<3d", data)),
    MODULE_STATES: _module_states,
    POSE2D: lambda data: _pose(*struct.unpack("<3d", data)),
    ROBOT_ON_FIELD: lambda data: _robot_on_field(*struct.unpack("<3d", data)),
    PHOTON_RESULT: lambda data: SimpleNamespace(tags=list(_photon_tags(data))),
    RAW_FIDUCIALS: lambda data: SimpleNamespace(tags=list(_raw_fiducials(data))),
}


MAX_PAYLOAD = 256 * 2**20
"""Maximum size of a record [byte]."""
REPEAT_US = 500_000
"""Interval at which the last value of odometry is repeated [us]: a twist is valid for 1 s."""
MAX_REPEATS = 100_000
"""Maximum number of repeated values; for one entry it is reached after 14 h."""
_START, _FINISH = 0, 1


class Entry(NamedTuple):
    """A named sequence of values."""

    name: str
    type: str
    """As in `type_of`."""


class Record(NamedTuple):
    """A value of an entry."""

    entry: Entry
    t: int
    """Time since the start of the robot's program [us]."""
    data: bytes


class _Damaged(Exception):
    """The file ends within a record, or a record is invalid."""


class DataLog:
    """The records of an open data log of a size [byte], read once."""

    def __init__(self, stream: IO[bytes], size: int) -> None:
        self._stream, self._size = stream, size
        self._repeats_left = MAX_REPEATS
        self.at = 0
        """End of the last readable record [byte]."""

    def records(self, names: Collection[str] | None = None) -> Iterator[Record]:
        """Yield the records up to the end of the file, or up to the first damage.

        With `names`, only of these entries; then the last values of odometry are repeated while
        they do not change. `InputError` for another version, or a record beyond `MAX_PAYLOAD`.
        """
        entries: dict[int, Entry] = {}
        last: dict[Entry, Record] = {}
        repeat_from = 0
        try:
            self._header()
            while self.at < self._size:
                number, t, data, end = self._next()
                if last and t > repeat_from:
                    yield from self._repeats(last, t)
                    repeat_from = t + REPEAT_US // 10
                if number == 0:
                    _control(data, entries)
                elif number in entries and (names is None or entries[number].name in names):
                    entry = entries[number]
                    if entry.type == PHOTON_RESULT:
                        t = exposure_time(t, data)
                    record = Record(entry, t, data)
                    if names is not None and entry.type in ON_CHANGE:
                        last[entry] = record
                    yield record
                self.at = end
        except _Damaged:
            return

    def _repeats(self, last: dict[Entry, Record], now: int) -> Iterator[Record]:
        """Yield the values that did not change before `now` [us] again, and update `last`."""
        for entry, record in last.items():
            for t in range(record.t + REPEAT_US, now, REPEAT_US)[: self._repeats_left]:
                self._repeats_left -= 1
                last[entry] = record._replace(t=t)
                yield last[entry]

    def _header(self) -> None:
        _, version, extra = struct.unpack("<6sHI", self._read(12, 0))
        if version >> 8 != 1:
            what = f"a WPILib data log of version {version >> 8}.{version & 255}; 1.0 is supported"
            raise InputError(what)
        self._read(extra, 12)
        self.at = 12 + extra

    def _next(self) -> tuple[int, int, bytes, int]:
        """Return entry number, time [us] and payload of the next record, and its end [byte]."""
        widths = self._read(1, self.at)[0]
        if widths > 0x7F:
            raise _Damaged
        to_length = (widths & 3) + 1
        to_time = to_length + (widths >> 2 & 3) + 1
        to_data = to_time + (widths >> 4) + 1
        at = self.at + 1 + to_data
        head = self._read(to_data, self.at + 1)
        length = int.from_bytes(head[to_length:to_time], "little")
        number = int.from_bytes(head[:to_length], "little")
        t = int.from_bytes(head[to_time:], "little")
        return number, t, self._read(length, at), at + length

    def _read(self, count: int, at: int) -> bytes:
        """Return the next bytes, which are at a position [byte]."""
        if count > self._size - at:
            raise _Damaged
        if count > MAX_PAYLOAD:
            raise InputError(f"a record of {count:,} bytes; at most {MAX_PAYLOAD:,} are allowed")
        return self._stream.read(count)


def _control(data: bytes, entries: dict[int, Entry]) -> None:
    """Add the entry that a control record starts, or remove the one that it finishes."""
    try:
        kind, number = struct.unpack_from("<BI", data)
        if kind == _FINISH:
            entries.pop(number, None)
        elif kind == _START:
            name, at = _text(data, 5)
            entries[number] = Entry(name, type_of(name, _text(data, at)[0]))
    except struct.error:
        raise _Damaged from None


def _text(data: bytes, at: int) -> tuple[str, int]:
    """Return a text with its length before it, and the position after it [byte]."""
    (length,) = struct.unpack_from("<I", data, at)
    end = at + 4 + length
    if end > len(data):
        raise _Damaged
    return data[at + 4 : end].decode("utf-8", "replace"), end
