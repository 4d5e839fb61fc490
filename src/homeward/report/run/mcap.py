"""run.mcap: a run as ROS tools show it, RViz, Foxglove and evo among them.

Frames are those of REP 105: ``map`` is the home frame, ``odom`` is where odometry alone leads from
the start of the drive, ``base_link`` is the robot's centre. ``odom`` to ``base_link`` is there
from the first row on, ``map`` to ``odom`` wherever there is a pose.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb

from homeward.drives.drive import Drive
from homeward.drives.ros.log_file import LogFile, writing
from homeward.drives.ros.messages.stamps import split
from homeward.estimator import LandmarkEstimate, Status
from homeward.frames import Pose, compose, inverse
from homeward.odometry.dead_reckoning import dead_reckoning
from homeward.report.palette import BLUE, MOVED, MUTED
from homeward.track import Track

MAP, ODOM, BASE = "map", "odom", "base_link"
POSE_TOPIC, TRUTH_TOPIC, LANDMARKS_TOPIC = (
    "/homeward/pose",
    "/homeward/truth",
    "/homeward/landmarks",
)
STATUS_S = 1.0
"""The status is told when it changes, and this often at least [s]."""
PLANAR = (0, 1, 5)
"""Places of x, y and the turn about z in ROS's covariances of six."""
_OK, _WARN, _STALE = 0, 1, 3
LEVELS = {
    Status.WAITING: _STALE,
    Status.MAPPING: _WARN,
    Status.UNVERIFIED: _WARN,
    Status.COASTING: _WARN,
    Status.LOCALISED: _OK,
}
COLOURS = {True: MOVED, False: BLUE, None: MUTED}
"""Of a landmark that moved, that stayed, and of which nothing is known."""
_SPHERE, _TEXT, _ADD = 2, 9, 0


def write_recording(file: Path, drive: Drive, track: Track) -> None:
    """Write a run as an MCAP file of standard messages of ROS 2.

    Topics: /homeward/pose (nav_msgs/Odometry, with covariance), /tf, /homeward/landmarks
    (visualization_msgs/MarkerArray, as known at the end of the run, from its start on),
    /diagnostics (the status), and /homeward/truth (geometry_msgs/PoseStamped) where there is one.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    with writing(file) as log:
        rows = [*_Messages(log, drive, track).all()]
        for stamp, topic, message in sorted(rows, key=lambda row: row[0]):
            log.write(topic, stamp, message)


class _Messages:
    """The messages of a run, each with its stamp [ns] and topic."""

    def __init__(self, log: LogFile, drive: Drive, track: Track) -> None:
        self._log, self._drive, self._track = log, drive, track
        self._stamps = [split(t, drive.settings.epoch or 0)[0] for t in track.t.tolist()]

    def all(self) -> Iterator[tuple[int, str, Any]]:
        yield from self._transforms()
        yield from self._poses()
        yield from self._statuses()
        yield from self._true_poses()
        if self._stamps:
            yield self._stamps[0], LANDMARKS_TOPIC, self._markers(self._stamps[0])

    def _transforms(self) -> Iterator[tuple[int, str, Any]]:
        track = self._track
        rolled = dead_reckoning(self._drive.odometry, track.t)
        offset = compose(Pose(track.x, track.y, track.heading), inverse(rolled))
        columns = zip(
            np.column_stack(rolled).tolist(), np.column_stack(offset).tolist(), strict=True
        )
        for stamp, (base, odom) in zip(self._stamps, columns, strict=True):
            steps = [(ODOM, BASE, base)]
            if math.isfinite(odom[0]):
                steps.append((MAP, ODOM, odom))
            transforms = [self._transform(stamp, *step) for step in steps]
            yield stamp, "/tf", self._log.make("tf2_msgs/msg/TFMessage", transforms=transforms)

    def _poses(self) -> Iterator[tuple[int, str, Any]]:
        track, odometry = self._track, self._drive.odometry.bridged
        last = np.searchsorted(odometry.t, track.t, side="right") - 1
        for row in np.flatnonzero(track.has_pose).tolist():
            covariance = np.zeros((6, 6))
            covariance[np.ix_(PLANAR, PLANAR)] = track.covariance[row]
            v, omega = (
                (odometry.v[last[row]], odometry.omega[last[row]]) if last[row] >= 0 else (0, 0)
            )
            pose = _pose(track.x[row], track.y[row], track.heading[row])
            twist = {"linear": {"x": float(v)}, "angular": {"z": float(omega)}}
            stamp = self._stamps[row]
            message = self._log.make(
                "nav_msgs/msg/Odometry",
                header=self._log.header(stamp, MAP),
                child_frame_id=BASE,
                pose={"pose": pose, "covariance": covariance.ravel()},
                twist={"twist": twist},
            )
            yield stamp, POSE_TOPIC, message

    def _statuses(self) -> Iterator[tuple[int, str, Any]]:
        track, told, since = self._track, None, -math.inf
        for row, t in enumerate(track.t.tolist()):
            now = (track.status[row], track.reason[row])
            if now == told and t - since < STATUS_S:
                continue
            told, since = now, t
            status, reason = now
            values = {"status": status.value}
            if track.has_pose[row]:
                sigma = track.sigmas[row]
                names = ("sigma_x [m]", "sigma_y [m]", "sigma_heading [rad]")
                values |= {n: f"{s:.4g}" for n, s in zip(names, sigma.tolist(), strict=True)}
            told_of = {
                "level": LEVELS[status],
                "name": f"homeward: {track.estimator}",
                "message": f"{status.value}: {reason}" if reason else status.value,
                "values": [{"key": k, "value": v} for k, v in values.items()],
            }
            header = self._log.header(self._stamps[row], "")
            array = "diagnostic_msgs/msg/DiagnosticArray"
            message = self._log.make(array, header=header, status=[told_of])
            yield self._stamps[row], "/diagnostics", message

    def _true_poses(self) -> Iterator[tuple[int, str, Any]]:
        truth, epoch = self._drive.truth, self._drive.settings.epoch or 0
        if truth is None:
            return
        columns = (truth.t.tolist(), truth.x.tolist(), truth.y.tolist(), truth.heading.tolist())
        for t, *pose in zip(*columns, strict=True):
            stamp, _ = split(t, epoch)
            header = self._log.header(stamp, MAP)
            kind = "geometry_msgs/msg/PoseStamped"
            yield stamp, TRUTH_TOPIC, self._log.make(kind, header=header, pose=_pose(*pose))

    def _markers(self, stamp: int) -> Any:
        placed = [k for k in self._track.landmarks if math.isfinite(k.x) and math.isfinite(k.y)]
        markers = [
            self._marker(stamp, number, landmark, kind)
            for number, landmark in enumerate(placed)
            for kind in (_SPHERE, _TEXT)
        ]
        return self._log.make("visualization_msgs/msg/MarkerArray", markers=markers)

    def _marker(
        self, stamp: int, number: int, landmark: LandmarkEstimate, kind: int
    ) -> dict[str, Any]:
        is_text = kind == _TEXT
        pose = _pose(landmark.x, landmark.y, 0.0)
        pose["position"]["z"] = 0.3 if is_text else 0.0
        return {
            "header": self._log.header(stamp, MAP),
            "ns": "names" if is_text else "landmarks",
            "id": number,
            "type": kind,
            "action": _ADD,
            "pose": pose,
            "scale": dict.fromkeys("xyz", 0.2),
            "color": dict(zip("rgb", to_rgb(COLOURS[landmark.moved]), strict=True), a=1.0),
            "texture": {"header": self._log.header(stamp, "")},
            "text": landmark.landmark if is_text else "",
        }

    def _transform(self, stamp: int, parent: str, child: str, pose: list[float]) -> dict[str, Any]:
        there = _pose(*pose)
        return {
            "header": self._log.header(stamp, parent),
            "child_frame_id": child,
            "transform": {"translation": there["position"], "rotation": there["orientation"]},
        }


def _pose(x: float, y: float, heading: float) -> dict[str, dict[str, float]]:
    """Return the fields of a geometry_msgs/Pose."""
    half = float(heading) / 2
    turn = {"z": math.sin(half), "w": math.cos(half)}
    return {"position": {"x": float(x), "y": float(y)}, "orientation": turn}
