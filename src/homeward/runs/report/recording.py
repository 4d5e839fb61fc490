"""Streams of ROS 2 messages in one MCAP file; messages of one shape are encoded at once.

Messages of one shape have the same strings, and sequences of the same lengths, so that each number
has the same position in all of them. rosbags encodes one, and NumPy writes columns of numbers into
copies of it: rosbags takes ten times as long for messages one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from homeward.drives.ros.stamps import NANO
from homeward.drives.ros.writing import LogFile, typestore, writing

MAP = "map"
"""The home frame, in which all points are."""
DOTS = 24
"""Number of points of a line, and of an ellipse."""
BLOCK = 4096
"""Number of messages that are encoded at once: about 2 MB, about 80 s of a drive."""
_NUMBERS = "std_msgs/msg/Float64MultiArray"
_UINT32, _FLOAT32 = 6, 7
_POINT = np.dtype([(axis, "<f4") for axis in "xyz"] + [("rgb", "<u4"), ("color", "<u4")])
"""A point: `rgb` is 0x00RRGGBB, as Foxglove and RViz read it; `color` is 0xRRGGBBAA, for Rerun."""
_FIELDS = [
    {"name": name, "offset": 4 * i, "datatype": _FLOAT32 if name in "xyz" else _UINT32, "count": 1}
    for i, name in enumerate(_POINT.names or ())
]

Fields = dict[str, Any]
"""Fields of n messages by name, nested as in `LogFile.make`.

An array is a column: its rows, (n, ...), are the values of the messages, of the field's type. A row
has 4 bytes at least.
"""


@dataclass(frozen=True)
class Stream:
    """The n messages of a topic."""

    topic: str
    kind: str
    """Type, as in ``nav_msgs/msg/Odometry``."""
    stamps: np.ndarray
    """(n,) [ns]."""
    fields: Callable[[np.ndarray], Fields]
    """Returns the fields of chosen messages of one shape by their indices, (k,)."""
    shapes: np.ndarray | None = None
    """(n,) Number of the shape of each message, from 0; None where all have the same."""


def write_streams(file: Path, streams: Sequence[Stream]) -> None:
    """Write messages in order of their stamps, those of equal stamps in order of the streams.

    `InputError` where the file exists or cannot be written.
    """
    for stream in streams:  # rosbags compiles each type, here once in a process, not for each log
        typestore(False).get_msgdef(stream.kind)
    none = np.zeros(0, int)
    stamps = np.concatenate([none, *(s.stamps for s in streams)])
    index = np.concatenate([none, *(np.arange(s.stamps.size) for s in streams)])
    source = np.repeat(np.arange(len(streams)), [s.stamps.size for s in streams])
    shapes = [np.zeros_like(s.stamps) if s.shapes is None else s.shapes for s in streams]
    firsts = np.cumsum([0, *(shape.max(initial=0) + 1 for shape in shapes)])
    group = np.concatenate([none, *shapes]) + firsts[source]
    order = np.argsort(stamps, kind="stable")
    with writing(file) as log:

        def encoded(rows: np.ndarray) -> list[bytes]:
            stream = streams[source[rows[0]]]
            return _encoded(log, stream.kind, rows.size, stream.fields(index[rows]))

        for rows in np.split(order, range(BLOCK, order.size, BLOCK)):
            messages = dict[int, bytes]()
            for one in np.unique(group[rows]):
                alike = rows[group[rows] == one]
                if alike.size > 1:
                    messages |= zip(alike.tolist(), encoded(alike), strict=True)
            for row, number, stamp in np.column_stack([rows, source[rows], stamps[rows]]).tolist():
                stream = streams[number]
                data = messages[row] if row in messages else encoded(np.array([row]))[0]
                log.write_encoded(stream.topic, stream.kind, stamp, data)


def _encoded(log: LogFile, kind: str, count: int, fields: Fields) -> list[bytes]:
    """Return messages of one shape."""
    columns, marks = list[np.ndarray](), list[bytes]()

    def marked(column: np.ndarray) -> Any:
        if count == 1 or not column.size:
            return column[0]
        # Other bytes for each column; 0xFD and 0xFE are neither in strings nor in small numbers.
        mark = np.array([0xFE, len(marks) % 256, 0xFD, len(marks) // 256], np.uint8)
        values = np.resize(mark, column.nbytes // count)
        columns.append(column)
        marks.append(values.tobytes())
        return values.view(column.dtype).reshape(column.shape[1:])[()]

    form = bytes(log.encoded(log.make(kind, **_replaced(fields, marked))))
    if count == 1:
        return [form]
    copies = np.tile(np.frombuffer(form, np.uint8), (count, 1))
    for mark, column in zip(marks, columns, strict=True):
        place, values = form.index(mark), np.ascontiguousarray(column).view(np.uint8)
        copies[:, place : place + len(mark)] = values.reshape(count, -1)
    data, size = copies.tobytes(), len(form)
    return [data[i : i + size] for i in range(0, len(data), size)]


def _replaced(value: Any, replace: Callable[[np.ndarray], Any]) -> Any:
    """Return fields in which columns are replaced."""
    if isinstance(value, dict):
        return {name: _replaced(each, replace) for name, each in value.items()}
    if isinstance(value, list):
        return [_replaced(each, replace) for each in value]
    return replace(value) if isinstance(value, np.ndarray) else value


def shapes_of(keys: Sequence[Hashable]) -> np.ndarray:
    """Return the numbers of shapes, (n,), of messages whose shapes have these keys."""
    numbers: dict[Hashable, int] = {}
    return np.array([numbers.setdefault(key, len(numbers)) for key in keys], int)


def time(stamps: np.ndarray) -> Fields:
    """Return the fields of a builtin_interfaces/Time from stamps [ns], (n,)."""
    return {
        "sec": (stamps // NANO).astype(np.int32),
        "nanosec": (stamps % NANO).astype(np.uint32),
    }


def header(stamps: np.ndarray, frame: str = MAP) -> Fields:
    """Return the fields of a std_msgs/Header from stamps [ns], (n,)."""
    return {"stamp": time(stamps), "frame_id": frame}


def pose(poses: np.ndarray) -> Fields:
    """Return the fields of a geometry_msgs/Pose from poses, (n, 3): x, y, heading."""
    half = poses[:, 2] / 2
    return {
        "position": {"x": poses[:, 0], "y": poses[:, 1]},
        "orientation": {"z": np.sin(half), "w": np.cos(half)},
    }


def transform(stamps: np.ndarray, parent: str, child: str, poses: np.ndarray) -> Fields:
    """Return the fields of a geometry_msgs/TransformStamped from poses, (n, 3), in the parent."""
    there = pose(poses)
    return {
        "header": header(stamps, parent),
        "child_frame_id": child,
        "transform": {"translation": there["position"], "rotation": there["orientation"]},
    }


def cloud_stream(
    topic: str,
    stamps: np.ndarray,
    points: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    shapes: np.ndarray | None = None,
) -> Stream:
    """Return a stream of n point clouds in the home frame.

    `points` returns those of chosen clouds: places (k, m, 2) [m], and colours 0xRRGGBB, (k, m) or
    fewer dimensions where they are alike.
    """

    def fields(at: np.ndarray) -> Fields:
        places, colours = points(at)
        array = np.zeros(places.shape[:2], _POINT)
        # 1/1024 m is fine enough to draw, and compresses well.
        array["x"], array["y"] = np.moveaxis(np.round(places * 1024) / 1024, -1, 0)
        array["rgb"] = colours
        array["color"] = array["rgb"] << 8 | 0xFF
        return {
            "header": header(stamps[at]),
            "height": 1,
            "width": places.shape[1],
            "fields": _FIELDS,
            "point_step": _POINT.itemsize,
            "row_step": places.shape[1] * _POINT.itemsize,
            "data": array.view(np.uint8),
            "is_dense": True,
        }

    return Stream(f"/homeward/{topic}", "sensor_msgs/msg/PointCloud2", stamps, fields, shapes)


def number_stream(topic: str, label: str, stamps: np.ndarray, values: np.ndarray) -> Stream:
    """Return a stream of arrays for plots: a row of `values`, (n, m), for each of n stamps [ns]."""
    layout = {"dim": [{"label": label, "size": values.shape[1], "stride": values.shape[1]}]}

    def fields(at: np.ndarray) -> Fields:
        return {"layout": layout, "data": values[at]}

    return Stream(f"/homeward/{topic}", _NUMBERS, stamps, fields)


def along(begins: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return `DOTS` points along each line from ends (..., k, 2): (..., k * `DOTS`, 2)."""
    share = np.linspace(0.0, 1.0, DOTS)[:, None]
    points: np.ndarray = begins[..., None, :] + share * (ends - begins)[..., None, :]
    return points.reshape(*begins.shape[:-2], -1, 2)


def rgb(colours: Sequence[str]) -> np.ndarray:
    """Return colours such as ``#0072b2`` as numbers 0xRRGGBB."""
    return np.array([int(colour[1:], 16) for colour in colours], np.uint32)
