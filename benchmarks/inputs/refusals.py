"""Data that homeward refuses, with one line that names the problem and what to do."""

import gzip
import io
import json
import pickle
import sqlite3
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.inputs.kinds import Files, Sample, Seen, kind, table
from benchmarks.inputs.logs import HOME, Messages, log_of
from homeward.drives.ros.writing import LogFile

ALL = "import odometry.csv bearings.csv home.csv"
OTHER = "import odometry.csv {} home.csv"
LFS = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a214614ab\nsize 12345\n"


def refused_file(name: str, file: str, content: str | bytes, words: str, command: str = "") -> None:
    """Register a file in place of the detections."""

    def files(s: Sample) -> Files:
        return {file: content}

    kind(name, command or OTHER.format(file), refused=words)(files)


def packed(files: dict[str, str]) -> bytes:
    """Return a zip archive."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return stream.getvalue()


def saved(*values: np.ndarray, **more: np.ndarray) -> bytes:
    """Return a file of numpy."""
    stream = io.BytesIO()
    if more:
        np.savez(stream, **more)
    else:
        np.save(stream, *values)
    return stream.getvalue()


def picture() -> bytes:
    stream = io.BytesIO()
    Image.new("L", (64, 48)).save(stream, "png")
    return stream.getvalue()


BOOK = packed({"[Content_Types].xml": "<Types/>", "xl/worksheets/sheet1.xml": "<worksheet/>"})
MAT = b"MATLAB 5.0 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x01IM" + bytes(64)
ROWS = [{"t": 0.1 * k, "id": 3, "bearing": 0.1} for k in range(50)]
refused_file("empty file", "bearings.csv", "", "bearings.csv: empty file")
refused_file("header without rows", "bearings.csv", "t,landmark,bearing\n", "bearings.csv")
refused_file("spreadsheet (.xlsx)", "tags.xlsx", BOOK, "CSV")
refused_file("MATLAB file (.mat)", "tags.mat", MAT, "CSV")
refused_file("numpy array (.npy)", "tags.npy", saved(np.eye(9)), "CSV")
refused_file("numpy archive (.npz)", "tags.npz", saved(a=np.eye(3)), "CSV")
refused_file("pickle (.pkl)", "tags.pkl", pickle.dumps(ROWS * 99), "CSV")
refused_file("JSON", "tags.json", json.dumps(ROWS, indent=1), "CSV")
refused_file("JSON lines", "tags.jsonl", "\n".join(map(json.dumps, ROWS)), "CSV")
refused_file("YAML", "tags.yaml", "tags:\n- {id: 3, bearing: 0.1}\n" * 9, "tags.yaml")
refused_file("parquet", "tags.parquet", b"PAR1" + bytes(range(256)) * 4 + b"PAR1", "CSV")
refused_file("HDF5", "tags.h5", b"\x89HDF\r\n\x1a\n" + bytes(512), "CSV")
refused_file("gzip of a table", "tags.csv.gz", gzip.compress(b"t,landmark,bearing\n"), "unpack|CSV")
refused_file("picture", "tag.png", picture(), "homeward see")
refused_file("pointer of Git LFS", "bearings.csv", LFS, "Git LFS")
refused_file(
    "web page", "tags.csv", "<!DOCTYPE html>\n<html><body>404</body></html>\n" * 4, "web page|HTML"
)
refused_file("ros2 topic echo", "odom.txt", "header:\n  stamp:\n    sec: 1\n" * 30, "echo --csv")
refused_file("zeros", "tags.csv", bytes(4096), "tags.csv")
refused_file("prose", "tags.csv", "We saw tag 3, then tag 4.\n\nIt rained.\n" * 9, "tags.csv")
refused_file(
    "bag without its end", "log.bag", b"#ROSBAG V2.0\n" + bytes(99), "log.bag", "run log.bag"
)
refused_file("text called .bag", "log.bag", "t,v\n0,1\n", "log.bag", "run log.bag")
refused_file(
    "missing file",
    "other.csv",
    "",
    "none.csv.*No such file",
    OTHER.format("none.csv"),
)


@kind("odometry alone", "import odometry.csv", refused="no bearings found")
def _(s: Sample) -> Files:
    return {}


@kind("LCM event log", "run lcmlog-2024-04-15.00", refused="LCM event log.*CSV")
def _(s: Sample) -> Files:
    return {"lcmlog-2024-04-15.00": b"\xed\xa1\xda\x01" + bytes(19) + b"\x08\0\0\0\x04MBOT_VELdata"}


@kind("no home bearings", "import odometry.csv bearings.csv", refused="--home during")
def _(s: Sample) -> Files:
    return {}


@kind("clocks that differ", ALL, refused="clock|begin")
def _(s: Sample) -> Files:
    seen = {"t": 1.7e9 + s.seen.t, "landmark": s.seen.id, "bearing": s.seen.bearing}
    return {"bearings.csv": table(seen)}


@kind("bearings of NaN", ALL, refused="bearings.csv")
def _(s: Sample) -> Files:
    seen = {"t": s.seen.t, "landmark": s.seen.id, "bearing": np.full(s.seen.t.size, np.nan)}
    return {"bearings.csv": table(seen)}


@kind("speeds in mm/s without a unit", ALL, refused=r"too fast for m/s.*\[mm/s\]")
def _(s: Sample) -> Files:
    return {"odometry.csv": table({"t": s.t, "v": 1e3 * s.v, "omega": s.omega})}


@kind("positions in the map frame", ALL, refused="fixed frame 'map'")
def _(s: Sample) -> Files:
    n = s.seen.t.size
    tags = {"t": s.seen.t, "id": s.seen.id, "frame_id": ["map"] * n}
    return {
        "bearings.csv": table(tags | {"x": s.seen.forward, "y": s.seen.left, "z": 0 * s.seen.t})
    }


@kind("ROS 1 bag without odometry", "run log.bag --topics topics.yaml", refused="odometry")
def _(s: Sample) -> Files:
    def tags(log: LogFile, stamp: int, seen: Seen) -> Messages:
        places = [
            {"position": {"x": x, "y": y}} for x, y in zip(seen.forward, seen.left, strict=True)
        ]
        header = log.header(stamp, "base_link")
        return {"/poses": log.make("geometry_msgs/msg/PoseArray", header=header, poses=places)}

    log = log_of(s, s.seen, tags, odometry=lambda log, stamp, k: {})
    return {"log.bag": log, "topics.yaml": HOME}


@kind("LaserScan with reflectors", "run log.mcap --topics topics.yaml", refused="LaserScan")
def _(s: Sample) -> Files:
    def scan(log: LogFile, stamp: int, seen: Seen) -> Messages:
        values = {"angle_min": -2.0, "angle_max": 2.0, "angle_increment": 0.01, "range_max": 9.0}
        values |= {"ranges": np.full(401, 3.0, np.float32), "intensities": np.ones(401, np.float32)}
        header = log.header(stamp, "laser")
        return {"/scan": log.make("sensor_msgs/msg/LaserScan", header=header, **values)}

    return {"log.mcap": log_of(s, s.seen, scan), "topics.yaml": "bearings: {topic: /scan}\n"}


@kind("odometry alone in a log", "run log.mcap", refused="bearings|landmarks")
def _(s: Sample) -> Files:
    return {"log.mcap": log_of(s, s.seen, lambda log, stamp, seen: {})}


@kind("CSV folder instead of a drive", "run tables", refused="homeward import")
def _(s: Sample) -> Files:
    return {"tables/encoders.csv": "t,v\n0,1\n", "tables/seen.csv": "t,id,bearing\n0,1,1\n"}


@kind("database that is no log", "run log.db3", refused="log.db3")
def _(s: Sample) -> Files:
    def write(path: Path) -> None:
        with sqlite3.connect(path) as base:
            base.execute("CREATE TABLE t(x INT)")

    return {"log.db3": write}
