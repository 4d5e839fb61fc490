"""Data that homeward refuses, with one line that names the problem and what to do."""

import gzip
import io
import json
import pickle
import zipfile

import numpy as np
from PIL import Image

from benchmarks.inputs.kinds import Files, Sample, kind, table
from benchmarks.inputs.logs import log_of

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
    "missing file",
    "other.csv",
    "",
    "none.csv.*No such file",
    OTHER.format("none.csv"),
)


@kind("odometry alone", "import odometry.csv", refused="no bearings found")
def _(s: Sample) -> Files:
    return {}


@kind("no home bearings", "import odometry.csv bearings.csv", refused="--home during")
def _(s: Sample) -> Files:
    return {}


@kind("bearings of NaN", ALL, refused="bearings.csv")
def _(s: Sample) -> Files:
    seen = {"t": s.seen.t, "landmark": s.seen.id, "bearing": np.full(s.seen.t.size, np.nan)}
    return {"bearings.csv": table(seen)}


@kind("odometry alone in a log", "run log.mcap", refused="bearings|landmarks")
def _(s: Sample) -> Files:
    return {"log.mcap": log_of(s, s.seen, lambda log, stamp, seen: {})}
