"""Reference of run.mcap: each message is made as an object, and written by rosbags.

`homeward.runs.report.mcap` encodes columns of messages; both must give the same messages.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from homeward.drives.drive import Drive
from homeward.drives.images import KINDS, Images
from homeward.drives.ros.stamps import split
from homeward.drives.ros.writing import LogFile, writing
from homeward.estimator import Status
from homeward.geometry.frames import Pose, compose, inverse
from homeward.odometry.history import dead_reckoning
from homeward.runs.report.palette import BLUE, HOUSE, MOVED, MUTED, STATUS_COLOURS, colour, levels
from homeward.runs.report.plots.moments import NEW, REJECTED, USED, bearings_at
from homeward.runs.scoring import errors
from homeward.track import Track

MAP, ODOM, BASE, CAMERA = "map", "odom", "base_link", "camera"
STATUS_S = 1.0
"""The status is written at each change, and at this interval [s]."""
IMAGE_S = 0.5
"""Minimum interval of images [s]; with all images the file would be as large as the drive."""
STALE_S = 0.5
"""Rays disappear after this time without new sightings [s]."""
UNPLACED_M = 2.0
"""Length of a ray whose landmark has no position [m]."""
DOTS = 24
"""Number of points of a ray, and of an ellipse."""
HOUSE_M = 0.15
"""Half the width of home's symbol [m]."""
PLANAR = (0, 1, 5)
"""Indices of x, y and the rotation about z in ROS's 6 x 6 covariances."""
LEVELS = dict.fromkeys((Status.MAPPING, Status.UNVERIFIED, Status.COASTING), 1)
LEVELS |= {Status.LOCALISED: 0, Status.WAITING: 3}
"""Levels of diagnostic_msgs: 0 is OK, 1 is WARN, 3 is STALE."""
FATES = {USED: BLUE, REJECTED: MOVED, NEW: MUTED}
_TEXT, _INFO, _WARN, _UINT32, _FLOAT32 = 9, 20, 30, 6, 7
_POINT = np.dtype([(axis, "<f4") for axis in "xyz"] + [("rgb", "<u4"), ("color", "<u4")])
"""A point: `rgb` is 0x00RRGGBB, as Foxglove and RViz read it; `color` is 0xRRGGBBAA, for Rerun."""
PALE = "#e1e6eb"
"""Pale colour, since the viewers have dark backgrounds."""

Row = tuple[int, str, Any]
"""A stamp [ns], a topic and a message."""


def write_by_message(file: Path, drive: Drive, track: Track, images: Images | None = None) -> None:
    """Write a run as `homeward.runs.report.mcap.write_recording` does."""
    with writing(file) as log:
        for stamp, topic, message in _Messages(log, drive, track).all(images):
            log.write(topic, stamp, message)


class _Messages:
    """The messages of a run in order of time, created one by one."""

    def __init__(self, log: LogFile, drive: Drive, track: Track) -> None:
        self._log, self._drive, self._track = log, drive, track
        self._stamps = [self._stamp(t) for t in track.t.tolist()]
        self._fields = [
            log.make(
                "sensor_msgs/msg/PointField",
                name=name,
                offset=4 * i,
                datatype=_FLOAT32 if name in "xyz" else _UINT32,
                count=1,
            )
            for i, name in enumerate(_POINT.names or ())
        ]
        self._poses = np.column_stack([track.x, track.y, track.heading])
        self._has_pose, self._sigmas = track.has_pose, track.sigmas

    def _stamp(self, t: float) -> int:
        return split(t, self._drive.settings.epoch or 0)[0]

    def all(self, images: Images | None) -> Iterator[Row]:
        streams = [self._transforms(), self._robots(), self._statuses(), self._true_poses()]
        if self._stamps:
            streams += [self._fixed(), self._rays(), self._landmarks(), self._errors()]
        if images is not None:
            streams.append(self._images(images))
        return heapq.merge(*streams, key=lambda row: row[0])

    def _fixed(self) -> Iterator[Row]:
        """Yield the messages at the start: camera extrinsics, home, and the two paths."""
        track, start = self._track, self._stamps[0]
        posed = self._has_pose
        settings = self._drive.settings
        poses = {f"{CAMERA}_{name}": mount.pose for name, mount in settings.cameras.items()}
        poses = {CAMERA: settings.sensor.pose, **poses}
        fixed = [self._transform(start, BASE, frame, pose) for frame, pose in poses.items()]
        yield start, "/tf_static", self._log.make("tf2_msgs/msg/TFMessage", transforms=fixed)
        corners = HOUSE_M * np.array(HOUSE)
        yield self._cloud(start, "home", _along(corners[:-1], corners[1:]), PALE)
        status = [STATUS_COLOURS[s] for s, ok in zip(track.status, posed, strict=True) if ok]
        yield self._cloud(start, "path", self._poses[posed, :2], *status)
        if self._drive.truth is not None:
            truth = np.column_stack([self._drive.truth.x, self._drive.truth.y])
            yield self._cloud(start, "true_path", truth, MUTED)

    def _transforms(self) -> Iterator[Row]:
        rolled = dead_reckoning(self._drive.odometry, self._track.t)
        offset = compose(Pose(*self._poses.T), inverse(rolled))
        columns = zip(
            np.column_stack(rolled).tolist(), np.column_stack(offset).tolist(), strict=True
        )
        for stamp, (base, odom) in zip(self._stamps, columns, strict=True):
            steps = [(ODOM, BASE, base)]
            if math.isfinite(odom[0]):
                steps.append((MAP, ODOM, odom))
            transforms = [self._transform(stamp, *step) for step in steps]
            yield stamp, "/tf", self._log.make("tf2_msgs/msg/TFMessage", transforms=transforms)

    def _robots(self) -> Iterator[Row]:
        """Yield poses with covariance, and the robot as a heading in its 2-sigma ellipse."""
        track, odometry = self._track, self._drive.odometry.bridged
        last = np.searchsorted(odometry.t, track.t, side="right") - 1
        circle = np.linspace(0.0, math.tau, DOTS, endpoint=False)
        circle = 2.0 * np.column_stack([np.cos(circle), np.sin(circle)])
        for row, stamp in enumerate(self._stamps):
            if not self._has_pose[row]:
                yield self._cloud(stamp, "robot", np.empty((0, 2)))
                continue
            covariance = np.zeros((6, 6))
            covariance[np.ix_(PLANAR, PLANAR)] = track.covariance[row]
            v, omega = (
                (odometry.v[last[row]], odometry.omega[last[row]]) if last[row] >= 0 else (0, 0)
            )
            message = self._log.make(
                "nav_msgs/msg/Odometry",
                header=self._log.header(stamp, MAP),
                child_frame_id=BASE,
                pose={"pose": _pose(*self._poses[row]), "covariance": covariance.ravel()},
                twist={"twist": {"linear": {"x": float(v)}, "angular": {"z": float(omega)}}},
            )
            yield stamp, "/homeward/pose", message
            yield self._numbers(stamp, "sigma", "x [m], y [m], heading [rad]", self._sigmas[row])
            variance, axes = np.linalg.eigh(track.covariance[row, :2, :2])
            ellipse = circle * np.sqrt(np.maximum(variance, 0.0)) @ axes.T
            here, heading = self._poses[row, :2], self._poses[row, 2]
            ahead = here + 0.4 * np.array([np.cos(heading), np.sin(heading)])
            points = np.vstack([here + ellipse, _along(here[None], ahead[None])])
            yield self._cloud(stamp, "robot", points, *[BLUE] * DOTS, *[PALE] * DOTS)

    def _rays(self) -> Iterator[Row]:
        """Yield the sightings as rays from the camera to the mapped landmarks."""
        track, history = self._track, self._track.history
        rows = np.flatnonzero(self._has_pose & np.isin(track.t, self._drive.sightings.t))
        column = {landmark: i for i, landmark in enumerate(history.landmark)}
        known, mount_of = history.at(track.t[rows]), self._drive.settings.mount_of
        frames = zip(rows.tolist(), known, bearings_at(self._drive, track, rows), strict=True)
        following = [*track.t[rows[1:]].tolist(), math.inf]
        for (row, k, seen), next_s in zip(frames, following, strict=False):
            pose = Pose(*self._poses[row])
            begins, ends = np.empty((len(seen), 2)), np.empty((len(seen), 2))
            for i, (name, bearing, _, by) in enumerate(seen):
                camera = begins[i] = np.array(compose(pose, mount_of(by).pose)[:2])
                way = pose.heading + bearing
                reach = UNPLACED_M
                if k >= 0 and name in column and math.isfinite(history.x[k, column[name]]):
                    place = (history.x[k, column[name]], history.y[k, column[name]])
                    reach = math.dist(place, camera)
                ends[i] = camera + reach * np.array([math.cos(way), math.sin(way)])
            colours = [FATES[fate] for _, _, fate, _ in seen for _ in range(DOTS)]
            yield self._cloud(self._stamps[row], "rays", _along(begins, ends), *colours)
            if next_s - (t := float(track.t[row])) > STALE_S:
                yield self._cloud(self._stamp(t + STALE_S), "rays", np.empty((0, 2)))

    def _landmarks(self) -> Iterator[Row]:
        """Yield landmarks in the colour of their probability of having moved, and their names."""
        history, named = self._track.history, None
        label = ", ".join(history.landmark)
        for row, t in enumerate(history.t.tolist()):
            stamp, chances = self._stamp(t), history.moved_probability[row]
            places = np.column_stack([history.x[row], history.y[row]])
            placed = np.isfinite(places).all(axis=1)
            colours = [colour(level) for level in levels(chances[placed]).tolist()]
            yield self._cloud(stamp, "landmarks", places[placed], *colours)
            yield self._numbers(stamp, "moved_probability", label, chances)
            # Names are written again when a position changes by 0.1 m or a probability by 10 %.
            if named != (shown := np.round([*places.T, chances], 1).tobytes()):
                named = shown
                markers = [
                    self._name(stamp, i, places[i], chances[i])
                    for i in np.flatnonzero(placed).tolist()
                ]
                array = self._log.make("visualization_msgs/msg/MarkerArray", markers=markers)
                yield stamp, "/homeward/landmark_names", array

    def _name(self, stamp: int, i: int, place: np.ndarray, chance: float) -> dict[str, Any]:
        """Return the marker of a landmark's name and its probability of having moved."""
        pose = _pose(place[0], place[1], 0.0)
        pose["position"]["z"] = 0.3
        moved = f"\nmoved: {chance:.0%}" if chance >= 0.05 else ""
        return {
            "header": self._log.header(stamp, MAP),
            "ns": "names",
            "id": i,
            "type": _TEXT,
            "pose": pose,
            "scale": dict.fromkeys("xyz", 0.2),
            "color": dict.fromkeys("rgba", 1.0),
            "texture": {"header": self._log.header(stamp, "")},
            "text": self._track.history.landmark[i] + moved,
        }

    def _statuses(self) -> Iterator[Row]:
        track, last, since = self._track, None, -math.inf
        name = f"homeward: {track.estimator}"
        for row, t in enumerate(track.t.tolist()):
            now = (track.status[row], track.reason[row])
            if now == last and t - since < STATUS_S:
                continue
            stamp, (status, reason) = self._stamps[row], now
            words = f"{status.value}: {reason}" if reason else status.value
            header = self._log.header(stamp, "")
            if now != last:
                severity = _WARN if LEVELS[status] else _INFO
                fields = {"stamp": header.stamp, "level": severity, "name": name, "msg": words}
                yield stamp, "/homeward/status", self._log.make("rcl_interfaces/msg/Log", **fields)
            last, since = now, t
            values = {"status": status.value}
            if self._has_pose[row]:
                sigma = self._sigmas[row]
                names = ("sigma_x [m]", "sigma_y [m]", "sigma_heading [rad]")
                values |= {n: f"{s:.4g}" for n, s in zip(names, sigma.tolist(), strict=True)}
            pairs = [{"key": k, "value": v} for k, v in values.items()]
            found = {"level": LEVELS[status], "name": name, "message": words, "values": pairs}
            array = "diagnostic_msgs/msg/DiagnosticArray"
            yield stamp, "/diagnostics", self._log.make(array, header=header, status=[found])

    def _true_poses(self) -> Iterator[Row]:
        truth = self._drive.truth
        if truth is None:
            return
        for t, *pose in zip(*map(np.ndarray.tolist, vars(truth).values()), strict=True):
            header = self._log.header(stamp := self._stamp(t), MAP)
            kind = "geometry_msgs/msg/PoseStamped"
            message = self._log.make(kind, header=header, pose=_pose(*pose))
            yield stamp, "/homeward/truth", message

    def _errors(self) -> Iterator[Row]:
        if self._drive.truth is None:
            return
        e = errors(self._track, self._drive.truth)
        for t, *values in zip(e.t.tolist(), e.x, e.y, e.heading, strict=True):
            yield self._numbers(self._stamp(t), "error", "x [m], y [m], heading [rad]", values)

    def _images(self, images: Images) -> Iterator[Row]:
        last = -math.inf
        for t, file in zip(images.t.tolist(), images.files, strict=True):
            if t - last < IMAGE_S:
                continue
            stamp, last = self._stamp(t), t
            message = self._log.make(
                "sensor_msgs/msg/CompressedImage",
                header=self._log.header(stamp, CAMERA),
                format=KINDS[file.suffix.lower()].removeprefix("image/"),
                data=np.frombuffer(file.read_bytes(), np.uint8),
            )
            yield stamp, "/camera/image/compressed", message

    def _cloud(self, stamp: int, topic: str, points: np.ndarray, *colours: str) -> Row:
        """Return points (n, 2) [m] in the home frame; the last colour is for all further points."""
        array = np.zeros(len(points), _POINT)
        # 1/1024 m is fine enough to draw, and compresses well.
        array["x"], array["y"] = np.round(points.T * 1024) / 1024
        if colours:
            rgb = np.array([int(c[1:], 16) for c in colours], np.uint32)
            array["rgb"] = np.pad(rgb, (0, len(points) - len(rgb)), "edge")
            array["color"] = array["rgb"] << 8 | 0xFF
        message = self._log.make(
            "sensor_msgs/msg/PointCloud2",
            header=self._log.header(stamp, MAP),
            height=1,
            width=len(array),
            fields=self._fields,
            point_step=_POINT.itemsize,
            row_step=array.nbytes,
            data=array.view(np.uint8),
            is_dense=True,
        )
        return stamp, f"/homeward/{topic}", message

    def _numbers(self, stamp: int, topic: str, label: str, values: Any) -> Row:
        """Return an array of numbers, for plots."""
        data = np.asarray(values, float)
        layout = {"dim": [{"label": label, "size": data.size, "stride": data.size}]}
        message = self._log.make("std_msgs/msg/Float64MultiArray", layout=layout, data=data)
        return stamp, f"/homeward/{topic}", message

    def _transform(self, stamp: int, parent: str, child: str, pose: Any) -> dict[str, Any]:
        there = _pose(*pose)
        return {
            "header": self._log.header(stamp, parent),
            "child_frame_id": child,
            "transform": {"translation": there["position"], "rotation": there["orientation"]},
        }


def _along(begins: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Return `DOTS` points along each of n lines (n, 2)."""
    share = np.linspace(0.0, 1.0, DOTS)[:, None]
    points: np.ndarray = begins[:, None] + share * (ends - begins)[:, None]
    return points.reshape(-1, 2)


def _pose(x: float, y: float, heading: float) -> dict[str, dict[str, float]]:
    """Return the fields of a geometry_msgs/Pose."""
    half = float(heading) / 2
    turn = {"z": math.sin(half), "w": math.cos(half)}
    return {"position": {"x": float(x), "y": float(y)}, "orientation": turn}
