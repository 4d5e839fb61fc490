"""WPILib data logs, written byte by byte from the specification, field layouts, and LCM."""

import json
import math
import struct
from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.inputs.kinds import EPOCH, Files, Sample, Seen, kind, table
from benchmarks.inputs.logs import HOME
from benchmarks.inputs.odometry import LIST, modules

Tags = Mapping[int, tuple[float, float, float]]
"""Positions ahead, left and up of a camera [m], by id."""
MICRO = 1_000_000
PHOTON = "photonstruct:PhotonPipelineResult:4b2ff16a964b5e2bf04be0c1454d91c4"
LATENCY_US = 30_000
MEASURED = "/RealOutputs/Drive/Measured"


def header(version: int = 0x0100, extra: bytes = b"") -> bytes:
    return struct.pack("<6sHI", b"WPILOG", version, len(extra)) + extra


def record(number: int, t: int, payload: bytes, widths: tuple[int, int, int] = (1, 2, 4)) -> bytes:
    """Return a record of an entry at `t` [us]; `widths` are those of its fields [byte]."""
    sizes = widths[0] - 1 | widths[1] - 1 << 2 | widths[2] - 1 << 4
    values = zip((number, len(payload), t), widths, strict=True)
    fields = b"".join(value.to_bytes(width, "little") for value, width in values)
    return bytes([sizes]) + fields + payload


def text(words: str) -> bytes:
    return struct.pack("<I", len(words.encode())) + words.encode()


def start(number: int, name: str, kind: str, t: int = 0) -> bytes:
    return record(0, t, struct.pack("<BI", 0, number) + text(name) + text(kind) + text(""))


def finish(number: int, t: int = 0) -> bytes:
    return record(0, t, struct.pack("<BI", 1, number))


def doubles(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}d", *values)


def photon(tags: Tags, exposed: int = 0, multitag: bool = False, unit: int = 1) -> bytes:
    """Return a PhotonPipelineResult in the layout of 2025; `unit` is 1000 for nanoseconds."""
    parts = [struct.pack("<4qB", 7, exposed, exposed + LATENCY_US * unit, 0, len(tags))]
    for number, place in tags.items():
        yaw = -math.degrees(math.atan2(place[1], place[0])) if any(place) else 0.0
        parts.append(struct.pack("<4d2if", yaw, 0.0, 1.0, 0.0, number, -1, -1.0))
        parts.append(doubles(*place, 1, 0, 0, 0) + doubles(*place, 1, 0, 0, 0) + doubles(0.1))
        parts.append(bytes([4]) + doubles(*range(8)))
        parts.append(bytes([4]) + doubles(*range(8)))
    both = doubles(*range(17)) + b"\2" + struct.pack("<2h", 1, 2)
    return b"".join(parts) + (b"\1" + both if multitag else b"\0")


def limelight(tags: Tags) -> bytes:
    """Return the values of rawfiducials."""
    rows: list[float] = []
    for number, (x, y, z) in tags.items():
        angles = -math.degrees(math.atan2(y, x)), math.degrees(math.atan2(z, x))
        rows += [number, *angles, 1.0, math.hypot(x, y, z), 3.0, 0.1]
    return doubles(*rows)


TAGS: Tags = {1: (2.0, 1.0, 0.3), 2: (3.0, 0.0, 0.3), 3: (1.0, -1.0, 0.3)}
SPEEDS = start(1, "/Drive/Speeds", "struct:ChassisSpeeds")
CAMERA = start(2, "NT:/photonvision/cam/rawBytes", PHOTON)


def small_log(camera: bytes = CAMERA, made: Callable[[Tags], bytes] = photon) -> bytes:
    """Return a log of 4 s at 10 Hz: the robot is at rest for 2 s, and then drives.

    `camera` is the start of the entry of a camera, `made` returns its value.
    """
    rows = [header(), SPEEDS, camera]
    for k in range(40):
        t = k * MICRO // 10
        rows.append(record(1, t, doubles(*((0.0, 0.0, 0.0) if k < 20 else (0.5, 0.0, 0.1)))))
        rows.append(record(2, t + 1, made(TAGS)))
    return b"".join(rows)


def data_log(
    s: Sample,
    seen: Seen,
    camera: str,
    type_: str,
    made: Callable[[Tags, int], bytes],
    odometry: tuple[str, np.ndarray] | None = None,
) -> bytes:
    """Return the sample drive, from 10 s on.

    `made` returns the value of a camera's entry from the tags and the time [us]; `odometry` is its
    type and its values (n, k), by default speeds of the chassis.
    """
    kind_, values = odometry or (
        "struct:ChassisSpeeds",
        np.stack([s.v, 0.0 * s.v, s.omega], axis=1),
    )
    entries = [
        (1, "/DriverStation/Enabled", "boolean"),
        (2, MEASURED, kind_),
        (3, "/.schema/struct:ChassisSpeeds", "structschema"),
        (4, camera, type_),
    ]
    rows = [(0, 1, b"\1"), (0, 3, b"double vx;double vy;double omega")]
    rows += [
        (round(t * MICRO), 2, doubles(*row))
        for t, row in zip(s.t.tolist(), values.tolist(), strict=True)
    ]
    for t in np.unique(seen.t).tolist():
        frame = seen[seen.t == t]
        places = zip(frame.forward.tolist(), frame.left.tolist(), strict=True)
        tags = {i: (x, y, 0.4) for i, (x, y) in zip(frame.id.tolist(), places, strict=True)}
        rows.append((round(t * MICRO), 4, made(tags, round(t * MICRO))))
    records = (record(n, t + 10 * MICRO, data) for t, n, data in sorted(rows))
    begin = [header(extra=b"AdvantageKit"), *(start(*entry) for entry in entries)]
    return b"".join([*begin, *records])


def photon_log(s: Sample, odometry: tuple[str, np.ndarray] | None = None) -> bytes:
    """Return the sample drive with a camera of PhotonVision; `odometry` as for `data_log`."""
    late = s.seen.ahead
    late = Seen(late.t + LATENCY_US / MICRO, late.id, late.bearing, late.range)
    name = "NT:/photonvision/front/rawBytes"
    return data_log(
        s, late, name, PHOTON, lambda tags, t: photon(tags, t, multitag=t % 3 == 0), odometry
    )


def limelight_log(s: Sample) -> bytes:
    """Return the sample drive with a Limelight."""
    name = "NT:/limelight/rawfiducials"
    return data_log(s, s.seen.ahead, name, "double[]", lambda tags, t: limelight(tags))


TOPICS = HOME + "drive: {sensor: {x: 0.2}}\n"


@kind("WPILib data log, PhotonVision", "run match.wpilog --topics topics.yaml")
def _(s: Sample) -> Files:
    return {"match.wpilog": photon_log(s), "topics.yaml": TOPICS}


@kind("WPILib data log, Limelight", "run match.wpilog --topics topics.yaml")
def _(s: Sample) -> Files:
    return {"match.wpilog": limelight_log(s), "topics.yaml": TOPICS}


@kind("WPILib data log, states of swerve modules", "run match.wpilog --topics topics.yaml")
def _(s: Sample) -> Files:
    states = np.stack(modules(s), axis=-1).transpose(1, 0, 2).reshape(s.t.size, 8)
    odometry = f"odometry: {{topic: {MEASURED}, modules: {LIST}}}\n"
    log = photon_log(s, ("struct:SwerveModuleState[]", states))
    return {"match.wpilog": log, "topics.yaml": TOPICS + odometry}


@kind("WPILib data log, poses of the drive", "run match.wpilog --topics topics.yaml")
def _(s: Sample) -> Files:
    log = photon_log(s, ("struct:Pose2d", np.stack(s.path, axis=1)))
    return {"match.wpilog": log, "topics.yaml": TOPICS + f"odometry: {{topic: {MEASURED}}}\n"}


@kind("WPILib data log, cut off", "run match.wpilog --topics topics.yaml")
def _(s: Sample) -> Files:
    return {"match.wpilog": photon_log(s)[:-1000], "topics.yaml": TOPICS}


def field_layout(s: Sample) -> str:
    """Return an AprilTagFieldLayout of the true positions in the home frame."""
    turn = {"quaternion": {"W": 1.0, "X": 0.0, "Y": 0.0, "Z": 0.0}}
    home, x, y = s.home, s.home.forward + s.camera, s.home.left
    tags = [
        {"ID": i, "pose": {"translation": {"x": x, "y": y, "z": 1.3}, "rotation": turn}}
        for i, x, y in zip(home.id.tolist(), x.tolist(), y.tolist(), strict=True)
    ]
    return json.dumps({"tags": tags, "field": {"length": 17.5, "width": 8.05}}, indent=2)


@kind("field layout of WPILib", "run drive")
def _(s: Sample) -> Files:
    drive = {f"drive/{name}": content for name, content in s.plain.items()}
    return drive | {"drive/landmarks.yaml": field_layout(s)}


@kind("LCM channels: utime, tags in mm", "import vel.csv tags.csv home.csv")
def _(s: Sample) -> Files:
    a = s.seen.ahead

    def utime(t: np.ndarray) -> np.ndarray:
        return np.rint(1e6 * (EPOCH + t)).astype(np.int64)

    vel = {"utime": utime(s.t), "type": ["MBOT_VEL"] * s.t.size, "vel vx": s.v, "vel vy": 0 * s.v}
    tags = {"APRILTAG.utime": utime(a.t), "APRILTAG.id": a.id, "APRILTAG.x": -1e3 * a.left}
    tags |= {"APRILTAG.y": -300.0 - 10 * a.id, "APRILTAG.z": 1e3 * a.forward}
    return {"vel.csv": table(vel | {"vel wz": s.omega}), "tags.csv": table(tags)}
