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

from homeward.drives.dead_reckoning import dead_reckoning
from homeward.drives.drive import Drive
from homeward.drives.ros.log_file import LogFile, writing
from homeward.drives.ros.messages.stamps import split
from homeward.estimator import LandmarkEstimate, Status
from homeward.frames import Pose, compose, inverse
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
        track, odometry = self._track, self._drive.odometry
        last = np.searchsorted(odometry.t, track.t, side="right") - 1
        for row in np.flatnonzero(track.has_pose).tolist():
            covariance = np.zeros((6, 6))
            covariance[np.ix_(PLANAR, PLANAR)] = track.covariance[row]
            v, omega = (
                (odometry.v[last[row]], odometry.omega[last[row]]) if last[row] >= 0 else (0, 0)
            )
            pose = self._pose(track.x[row], track.y[row], track.heading[row])
            stamp, make = self._stamps[row], self._log.make
            yield (
                stamp,
                POSE_TOPIC,
                make(
                    "nav_msgs/msg/Odometry",
                    header=self._log.header(stamp, MAP),
                    child_frame_id=BASE,
                    pose=make(
                        "geometry_msgs/msg/PoseWithCovariance",
                        pose=pose,
                        covariance=covariance.ravel(),
                    ),
                    twist=make(
                        "geometry_msgs/msg/TwistWithCovariance",
                        twist=make(
                            "geometry_msgs/msg/Twist",
                            linear=self._vector(float(v), 0.0, 0.0),
                            angular=self._vector(0.0, 0.0, float(omega)),
                        ),
                        covariance=np.zeros(36),
                    ),
                ),
            )

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
            make, stamp = self._log.make, self._stamps[row]
            pairs = [
                make("diagnostic_msgs/msg/KeyValue", key=k, value=v) for k, v in values.items()
            ]
            status_message = make(
                "diagnostic_msgs/msg/DiagnosticStatus",
                level=LEVELS[status],
                name=f"homeward: {track.estimator}",
                message=f"{status.value}: {reason}" if reason else status.value,
                hardware_id="",
                values=pairs,
            )
            header = self._log.header(stamp, "")
            array = "diagnostic_msgs/msg/DiagnosticArray"
            yield stamp, "/diagnostics", make(array, header=header, status=[status_message])

    def _true_poses(self) -> Iterator[tuple[int, str, Any]]:
        truth, epoch = self._drive.truth, self._drive.settings.epoch or 0
        if truth is None:
            return
        columns = (truth.t.tolist(), truth.x.tolist(), truth.y.tolist(), truth.heading.tolist())
        for t, *pose in zip(*columns, strict=True):
            stamp, _ = split(t, epoch)
            header = self._log.header(stamp, MAP)
            kind = "geometry_msgs/msg/PoseStamped"
            yield stamp, TRUTH_TOPIC, self._log.make(kind, header=header, pose=self._pose(*pose))

    def _markers(self, stamp: int) -> Any:
        placed = [k for k in self._track.landmarks if math.isfinite(k.x) and math.isfinite(k.y)]
        markers = [
            marker
            for number, landmark in enumerate(placed)
            for marker in (
                self._marker(stamp, number, landmark, _SPHERE),
                self._marker(stamp, number, landmark, _TEXT),
            )
        ]
        return self._log.make("visualization_msgs/msg/MarkerArray", markers=markers)

    def _marker(self, stamp: int, number: int, landmark: LandmarkEstimate, kind: int) -> Any:
        make = self._log.make
        is_text = kind == _TEXT
        rgb = to_rgb(COLOURS[landmark.moved])
        colour = dict(zip("rgb", rgb, strict=True), a=1.0)
        pose = self._pose(landmark.x, landmark.y, 0.0)
        pose.position.z = 0.3 if is_text else 0.0
        image = {"format": "", "data": np.empty(0, np.uint8)}
        return make(
            "visualization_msgs/msg/Marker",
            header=self._log.header(stamp, MAP),
            ns="names" if is_text else "landmarks",
            id=number,
            type=kind,
            action=_ADD,
            pose=pose,
            scale=self._vector(0.2, 0.2, 0.2),
            color=make("std_msgs/msg/ColorRGBA", **colour),
            lifetime=make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
            frame_locked=False,
            points=[],
            colors=[],
            texture_resource="",
            texture=make(
                "sensor_msgs/msg/CompressedImage", header=self._log.header(stamp, ""), **image
            ),
            uv_coordinates=[],
            text=landmark.landmark if is_text else "",
            mesh_resource="",
            mesh_file=make(
                "visualization_msgs/msg/MeshFile", filename="", data=np.empty(0, np.uint8)
            ),
            mesh_use_embedded_materials=False,
        )

    def _transform(self, stamp: int, parent: str, child: str, pose: list[float]) -> Any:
        x, y, heading = pose
        transform = self._log.make(
            "geometry_msgs/msg/Transform",
            translation=self._vector(x, y, 0.0),
            rotation=self._turn(heading),
        )
        return self._log.make(
            "geometry_msgs/msg/TransformStamped",
            header=self._log.header(stamp, parent),
            child_frame_id=child,
            transform=transform,
        )

    def _pose(self, x: float, y: float, heading: float) -> Any:
        point = self._log.make("geometry_msgs/msg/Point", x=float(x), y=float(y), z=0.0)
        kind = "geometry_msgs/msg/Pose"
        return self._log.make(kind, position=point, orientation=self._turn(heading))

    def _vector(self, x: float, y: float, z: float) -> Any:
        return self._log.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def _turn(self, heading: float) -> Any:
        half = float(heading) / 2
        kind = "geometry_msgs/msg/Quaternion"
        return self._log.make(kind, x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))
