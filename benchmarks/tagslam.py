"""Bearings of real tags against the solution of the authors' own graph.

    python -m benchmarks.tagslam [DATA]

The recordings of tagslam_tags hold corners of AprilTags in calibrated fisheye and time-of-flight
cameras, and their authors' poses of rig and tags, in space. Both are turned into bearings in the
camera's own frame, and compared. The authors' solution was made from these corners: it is no
independent truth, but one to which every tag, pose and camera had to agree. Corners that detectors
got wrong are left in.
"""

from __future__ import annotations

import math
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from homeward.drives.cameras.calibration import read_calibration
from homeward.drives.cameras.camera import tag_bearings
from homeward.drives.cameras.lens import Lens
from homeward.drives.ros.log import Log
from homeward.drives.ros.messages.decoding import Decoder
from homeward.geometry.angles import wrap
from homeward.io.settings import read_tree

PIXEL_SIGMA = 0.5
"""As bags are read [px]."""
OPTICAL = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
"""From optical axes to x ahead, y left, z up."""


@dataclass(frozen=True)
class Compared:
    """One camera of one recording; arrays over its sightings."""

    name: str
    error: np.ndarray
    """Bearing minus the authors' [rad]."""
    sigma: np.ndarray
    """[rad]"""
    distance: np.ndarray
    """[m]"""


def rotation(q) -> np.ndarray:
    """Rotation matrix of a quaternion message."""
    x, y, z, w = np.array([q.x, q.y, q.z, q.w]) / math.hypot(q.x, q.y, q.z, q.w)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def vector(p) -> np.ndarray:
    return np.array([p.x, p.y, p.z])


def decoded(path: Path):
    """All messages of a bag: (topic, stamp [ns], message)."""
    decoder = Decoder()
    for raw in Log(path).messages():
        message = decoder.decode(raw.channel, raw.data)
        head = message.transforms[0].header if hasattr(message, "transforms") else message.header
        yield raw.channel.topic, head.stamp.sec * 10**9 + head.stamp.nanosec, message


def solution(folder: Path):
    """The authors' poses of the rig by stamp, and the last places of the tags."""
    rig, tags = {}, {}
    for topic, stamp, message in decoded(folder / "reference.bag"):
        if topic == "/tf":
            for told in message.transforms:
                if told.child_frame_id.startswith("tag_"):
                    tags[told.child_frame_id[4:]] = vector(told.transform.translation)
        else:
            pose = message.pose.pose
            rig[stamp] = vector(pose.position), rotation(pose.orientation)
    return rig, tags


def compared(folder: Path) -> list[Compared]:
    """Every camera of a recording whose place on the rig the authors told."""
    rig, tags = solution(folder)
    cameras, mounts = (read_tree(folder / f) for f in ("cameras.yaml", "camera_poses.yaml"))
    found = []
    for name, told in cameras.items():
        mount = mounts.get(name)
        if mount is None:
            continue
        turn = np.array([*mount["pose"]["rotation"].values()][:3], float)
        assert not turn.any(), "a camera that is turned on the rig"
        lens = read_calibration(folder, f"cameras.yaml#{name}")
        rows = sightings(folder, told["tagtopic"], lens, rig, tags)
        found.append(Compared(f"{folder.name} {name} {lens.model}", *rows.T))
    return found


def sightings(folder: Path, topic: str, lens: Lens, rig, tags) -> np.ndarray:
    """Error, sigma [rad] and distance [m], a row each."""
    level = lens.model_copy(update={"tilt_sigma": 1e-9})
    rows = []
    for name, stamp, message in decoded(folder / "tag_detections.bag"):
        if name != topic:
            continue
        # Poses are stamped by any of the cameras that were taken together.
        nearest = min(rig, key=lambda at: abs(at - stamp))
        if abs(nearest - stamp) > 20e6:
            continue
        place, turn = rig[nearest]
        for tag in message.apriltags:
            if tag.hamming or str(tag.id) not in tags:
                continue
            corners = np.array([[[p.x, p.y] for p in tag.corners]])
            bearing, sigma = tag_bearings(corners, PIXEL_SIGMA, level, (0, 0))
            x, y, z = OPTICAL @ turn.T @ (tags[str(tag.id)] - place)
            distance = math.hypot(x, y, z)
            off = wrap(bearing[0] - math.atan2(y, x))
            rows.append((off, sigma[0], distance))
    return np.array(rows).reshape(-1, 3)


def main() -> None:
    data = sys.argv[1] if len(sys.argv) > 1 else os.environ.get("HOMEWARD_DATA", "../shared/data")
    print(f"{'camera':28} {'seen':>5} {'median':>8} {'RMS':>8} {'95 %':>8} {'mean':>8} {'chi2':>6}")
    for folder in sorted((Path(data) / "tagslam_tags").glob("test_*")):
        for row in compared(folder):
            off = np.degrees(row.error)
            figures = (
                np.median(np.abs(off)),
                np.sqrt(np.mean(off**2)),
                np.quantile(np.abs(off), 0.95),
            )
            chi2 = np.median((row.error / row.sigma) ** 2) / 0.4549
            texts = " ".join(f"{value:7.3f}d" for value in (*figures, off.mean()))
            print(f"{row.name:28} {off.size:5d} {texts} {chi2:6.2f}")


if __name__ == "__main__":
    main()
