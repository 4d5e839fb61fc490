"""Bearings of real tags against the solution of their authors' pose graph.

    python -m benchmarks.tagslam

The recordings of tagslam_tags (in HOMEWARD_DATA, else ../shared/data) contain corners of AprilTags
in calibrated fisheye and time-of-flight cameras, and their authors' 3D poses of rig and tags. Both
are converted to bearings in the camera's frame, and compared. The authors' solution was made from
the same corners: it is no independent ground truth, but consistent with all tags, poses and
cameras. Wrongly detected corners are included.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.mrclam import data
from homeward.drives.cameras.calibration import read_calibration
from homeward.drives.cameras.camera import tag_bearings
from homeward.drives.cameras.lens import Lens
from homeward.drives.ros.decoding import Decoder
from homeward.drives.ros.log import Log
from homeward.geometry.angles import wrap
from homeward.io.settings import read_tree

PIXEL_SIGMA = 0.5  # as in the reader of bags [px]
OPTICAL = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
"""From the optical frame to x ahead, y left, z up."""


@dataclass(frozen=True)
class Compared:
    """One camera of one recording; arrays over its sightings."""

    name: str
    error: np.ndarray  # bearing minus the authors' [rad]
    sigma: np.ndarray  # [rad]
    distance: np.ndarray  # [m]


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
    rig, tags = {}, {}
    for topic, stamp, message in decoded(folder / "reference.bag"):
        if topic == "/tf":
            for frame in message.transforms:
                if frame.child_frame_id.startswith("tag_"):
                    tags[frame.child_frame_id[4:]] = vector(frame.transform.translation)
        else:
            pose = message.pose.pose
            turn = Rotation.from_quat([*vector(pose.orientation), pose.orientation.w])
            rig[stamp] = vector(pose.position), turn.as_matrix()
    return rig, tags


def compared(folder: Path) -> list[Compared]:
    rig, tags = solution(folder)
    cameras, mounts = (read_tree(folder / f) for f in ("cameras.yaml", "camera_poses.yaml"))
    found = []
    for name, camera in cameras.items():
        mount = mounts.get(name)
        if mount is None:
            continue
        turn = np.array([*mount["pose"]["rotation"].values()][:3], float)
        assert not turn.any(), "a camera that is rotated on the rig"
        lens = read_calibration(folder, f"cameras.yaml#{name}")
        rows = sightings(folder, camera["tagtopic"], lens, rig, tags)
        found.append(Compared(f"{folder.name} {name} {lens.model}", *rows.T))
    return found


def sightings(folder: Path, topic: str, lens: Lens, rig, tags) -> np.ndarray:
    level = lens.model_copy(update={"tilt_sigma": 1e-9})
    rows = []
    for name, stamp, message in decoded(folder / "tag_detections.bag"):
        if name != topic:
            continue
        # Poses have the stamp of one of the synchronised cameras.
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
    print("errors in deg, chi-square: median over the expected one")
    print(f"{'camera':28} {'seen':>5} {'median':>7} {'RMS':>7} {'95 %':>7} {'mean':>7} {'chi2':>6}")
    for folder in sorted((data() / "tagslam_tags").glob("test_*")):
        for row in compared(folder):
            off = np.degrees(row.error)
            median, most = np.quantile(np.abs(off), [0.5, 0.95])
            chi2 = np.median((row.error / row.sigma) ** 2) / 0.4549
            figures = (median, np.sqrt(np.mean(off**2)), most, off.mean())
            texts = " ".join(f"{value:7.3f}" for value in figures)
            print(f"{row.name:28} {off.size:5d} {texts} {chi2:6.2f}")


if __name__ == "__main__":
    main()
