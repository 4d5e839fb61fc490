"""run.mcap: a run for Rerun, Foxglove, RViz and evo, as standard messages of ROS 2.

Frames are those of REP 105: ``map`` is the home frame, ``odom`` is the frame of dead reckoning from
the start of the drive, ``base_link`` is the robot's centre, ``camera`` is the first camera, and
``camera_NAME`` another one. ``odom`` to ``base_link`` is published from the first row on, ``map``
to ``odom`` wherever there is a pose. Rerun draws neither markers nor nav_msgs, but every viewer
draws point clouds: so paths, ellipses, rays, landmarks and home are coloured points.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np

from homeward.drives.drive import Drive, Truth
from homeward.drives.images import KINDS, Images
from homeward.drives.ros.stamps import split
from homeward.estimator import Status
from homeward.geometry.frames import Pose, compose, inverse
from homeward.odometry.history import dead_reckoning
from homeward.runs.report.palette import (
    BLUE,
    HOUSE,
    LEVEL_COLOURS,
    MOVED,
    MUTED,
    STATUS_COLOURS,
    UNTESTED,
    colour,
    levels,
)
from homeward.runs.report.plots.moments import NEW, REJECTED, USED, bearings_at
from homeward.runs.report.recording import (
    DOTS,
    MAP,
    Fields,
    Stream,
    along,
    cloud_stream,
    header,
    number_stream,
    pose,
    rgb,
    shapes_of,
    time,
    transform,
    write_streams,
)
from homeward.runs.scoring import errors
from homeward.track import Track

ODOM, BASE, CAMERA = "odom", "base_link", "camera"
STATUS_S = 1.0
"""The status is written at each change, and at this interval [s]."""
IMAGE_S = 0.5
"""Minimum interval of images [s]; with all images the file would be as large as the drive."""
STALE_S = 0.5
"""Rays disappear after this time without new sightings [s]."""
UNPLACED_M = 2.0
"""Length of a ray whose landmark has no position [m]."""
HOUSE_M = 0.15
"""Half the width of home's symbol [m]."""
PLANAR = np.array([0, 1, 5])
"""Indices of x, y and the rotation about z in ROS's 6 x 6 covariances."""
LEVELS = dict.fromkeys((Status.MAPPING, Status.UNVERIFIED, Status.COASTING), 1)
LEVELS |= {Status.LOCALISED: 0, Status.WAITING: 3}
"""Levels of diagnostic_msgs: 0 is OK, 1 is WARN, 3 is STALE."""
POSE_COLUMNS = "x [m], y [m], heading [rad]"
_TEXT, _INFO, _WARN = 9, 20, 30
PALE = "#e1e6eb"
"""Pale colour, since the viewers have dark backgrounds."""
_ROBOT_RGB = rgb([BLUE] * DOTS + [PALE] * DOTS)
_FATE_RGB = dict(zip((USED, REJECTED, NEW), rgb([BLUE, MOVED, MUTED]), strict=True))
_LEVEL_RGB = rgb([*LEVEL_COLOURS, colour(UNTESTED)])
"""By level; `UNTESTED`, which is -1, is the last."""
_TRANSFORMS = "tf2_msgs/msg/TFMessage"


def write_recording(file: Path, drive: Drive, track: Track, images: Images | None = None) -> None:
    """Write a run as an MCAP file of ROS 2 messages, as listed in docs/look-up/files.md."""
    write_streams(file, _Recording(drive, track).streams(images))


class _Recording:
    """The messages of a run, in streams."""

    def __init__(self, drive: Drive, track: Track) -> None:
        self._drive, self._track = drive, track
        self._stamp = cache(lambda t: split(t, drive.settings.epoch or 0)[0])
        self._stamps = self._at(track.t)
        self._poses = np.column_stack([track.x, track.y, track.heading])
        self._has_pose, self._sigmas = track.has_pose, track.sigmas

    def _at(self, t: np.ndarray) -> np.ndarray:
        """Return the stamps [ns] of times [s], (n,)."""
        return np.array([self._stamp(each) for each in t.tolist()], np.int64)

    def streams(self, images: Images | None) -> list[Stream]:
        """Return the streams; messages with equal stamps are written in this order."""
        streams = [self._transforms(), *self._robots(), *self._statuses()]
        if (truth := self._drive.truth) is not None:
            streams.append(self._true_poses(truth))
        if self._stamps.size:
            streams += [*self._fixed(), self._rays(), *self._landmarks()]
            if truth is not None:
                e = errors(self._track, truth)
                values = np.column_stack([e.x, e.y, e.heading])
                streams.append(number_stream("error", POSE_COLUMNS, self._at(e.t), values))
        return streams if images is None else [*streams, self._images(images)]

    def _fixed(self) -> list[Stream]:
        """Return the messages at the start: camera extrinsics, home, and the two paths."""
        track, start, settings = self._track, self._stamps[:1], self._drive.settings
        poses = {f"{CAMERA}_{name}": mount.pose for name, mount in settings.cameras.items()}
        poses = {CAMERA: settings.sensor.pose, **poses}
        mounts = [transform(start, BASE, name, np.array([mount])) for name, mount in poses.items()]
        corners = HOUSE_M * np.array(HOUSE)
        posed = self._has_pose
        status = [STATUS_COLOURS[s] for s, ok in zip(track.status, posed, strict=True) if ok]
        clouds = {
            "home": (along(corners[:-1], corners[1:]), rgb([PALE])),
            "path": (self._poses[posed, :2], rgb(status)),
        }
        if (truth := self._drive.truth) is not None:
            clouds["true_path"] = np.column_stack([truth.x, truth.y]), rgb([MUTED])

        def drawing(topic: str, points: np.ndarray, colours: np.ndarray) -> Stream:
            return cloud_stream(topic, start, lambda _: (points[None], colours))

        return [
            Stream("/tf_static", _TRANSFORMS, start, lambda _: {"transforms": mounts}),
            *(drawing(topic, *cloud) for topic, cloud in clouds.items()),
        ]

    def _transforms(self) -> Stream:
        rolled = dead_reckoning(self._drive.odometry, self._track.t)
        offset = np.column_stack(compose(Pose(*self._poses.T), inverse(rolled)))
        base, is_placed = np.column_stack(rolled), np.isfinite(offset[:, 0])

        def fields(at: np.ndarray) -> Fields:
            transforms = [transform(self._stamps[at], ODOM, BASE, base[at])]
            if is_placed[at[0]]:
                transforms.append(transform(self._stamps[at], MAP, ODOM, offset[at]))
            return {"transforms": transforms}

        return Stream("/tf", _TRANSFORMS, self._stamps, fields, is_placed.astype(int))

    def _robots(self) -> list[Stream]:
        """Return poses with covariance, and the robot as a heading in its 2-sigma ellipse."""
        posed = np.flatnonzero(self._has_pose)
        stamps = self._stamps[posed]
        return [
            Stream(
                "/homeward/pose", "nav_msgs/msg/Odometry", stamps, lambda i: self._pose(posed[i])
            ),
            number_stream("sigma", POSE_COLUMNS, stamps, self._sigmas[posed]),
            cloud_stream("robot", self._stamps, self._robot, self._has_pose.astype(int)),
        ]

    def _pose(self, at: np.ndarray) -> Fields:
        track, odometry = self._track, self._drive.odometry.bridged
        covariance = np.zeros((at.size, 6, 6))
        covariance[:, PLANAR[:, None], PLANAR] = track.covariance[at]
        last = np.searchsorted(odometry.t, track.t[at], side="right") - 1
        v, omega, vy = (
            np.where(last < 0, 0.0, twist[last])
            for twist in (odometry.v, odometry.omega, odometry.vy)
        )
        return {
            "header": header(self._stamps[at]),
            "child_frame_id": BASE,
            "pose": {"pose": pose(self._poses[at]), "covariance": covariance.reshape(-1, 36)},
            "twist": {"twist": {"linear": {"x": v, "y": vy}, "angular": {"z": omega}}},
        }

    def _robot(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if not self._has_pose[at[0]]:
            return np.empty((at.size, 0, 2)), _ROBOT_RGB[:0]
        angles = np.linspace(0.0, math.tau, DOTS, endpoint=False)
        circle = 2.0 * np.column_stack([np.cos(angles), np.sin(angles)])
        variance, axes = np.linalg.eigh(self._track.covariance[at, :2, :2])
        ellipse = circle * np.sqrt(np.maximum(variance, 0.0))[:, None] @ axes.swapaxes(1, 2)
        here, heading = self._poses[at, None, :2], self._poses[at, 2]
        ahead = here + 0.4 * np.stack([np.cos(heading), np.sin(heading)], axis=-1)[:, None]
        return np.concatenate([here + ellipse, along(here, ahead)], axis=1), _ROBOT_RGB

    def _rays(self) -> Stream:
        """Return the sightings as rays from the camera to the mapped landmarks."""
        track, history = self._track, self._track.history
        rows = np.flatnonzero(self._has_pose & np.isin(track.t, self._drive.sightings.t))
        column = {landmark: i for i, landmark in enumerate(history.landmark)}
        known, mount_of = history.at(track.t[rows]), self._drive.settings.mount_of
        frames = zip(rows.tolist(), known, bearings_at(self._drive, track, rows), strict=True)
        following = [*track.t[rows[1:]].tolist(), math.inf]
        t, lines, colours = list[float](), list[np.ndarray](), list[np.ndarray]()
        for (row, k, seen), next_s in zip(frames, following, strict=False):
            at = Pose(*self._poses[row])
            ends = np.empty((2, len(seen), 2))
            for i, (name, bearing, _, by) in enumerate(seen):
                camera = ends[0, i] = np.array(compose(at, mount_of(by).pose)[:2])
                way = at.heading + bearing
                reach = UNPLACED_M
                if k >= 0 and name in column and math.isfinite(history.x[k, column[name]]):
                    place = (history.x[k, column[name]], history.y[k, column[name]])
                    reach = math.dist(place, camera)
                ends[1, i] = camera + reach * np.array([math.cos(way), math.sin(way)])
            t.append(now := float(track.t[row]))
            lines.append(ends)
            colours.append(np.array([_FATE_RGB[fate] for _, _, fate, _ in seen], np.uint32))
            if next_s - now > STALE_S:
                t.append(now + STALE_S)
                lines.append(ends[:, :0])
                colours.append(colours[-1][:0])

        def points(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            ends = np.stack([lines[i] for i in at], axis=1)
            shown = np.stack([colours[i] for i in at])
            return along(*ends), np.repeat(shown, DOTS, axis=1)

        return cloud_stream("rays", self._at(np.array(t)), points, shapes_of([*map(len, colours)]))

    def _landmarks(self) -> list[Stream]:
        """Return landmarks in the colour of their probability of having moved, and their names."""
        history = self._track.history
        stamps, chances = self._at(history.t), history.moved_probability
        places = np.stack([history.x, history.y], axis=-1)
        is_placed = np.isfinite(places).all(axis=-1)
        colours = _LEVEL_RGB[levels(chances)]

        def points(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            here = is_placed[at]
            shown = places[at][here].reshape(at.size, -1, 2)
            return shown, colours[at][here].reshape(shown.shape[:2])

        # Names are written again when a position changes by 0.1 m or a probability by 10 %.
        shown = np.round(np.stack([*np.moveaxis(places, -1, 0), chances], axis=1), 1)
        rounded = [row.tobytes() for row in shown]
        named = np.array(
            [i for i, row in enumerate(rounded) if not i or row != rounded[i - 1]], int
        )
        labels = [
            tuple((i, self._label(i, chance[i])) for i in np.flatnonzero(ok).tolist())
            for ok, chance in zip(is_placed[named], chances[named].tolist(), strict=True)
        ]

        def names(at: np.ndarray) -> Fields:
            here = named[at]
            shown = [_marker(stamps[here], i, places[here, i], text) for i, text in labels[at[0]]]
            return {"markers": shown}

        markers = "visualization_msgs/msg/MarkerArray"
        return [
            cloud_stream("landmarks", stamps, points, is_placed.sum(axis=1)),
            number_stream("moved_probability", ", ".join(history.landmark), stamps, chances),
            Stream("/homeward/landmark_names", markers, stamps[named], names, shapes_of(labels)),
        ]

    def _label(self, i: int, chance: float) -> str:
        """Return the name of a landmark and its probability of having moved."""
        moved = f"\nmoved: {chance:.0%}" if chance >= 0.05 else ""
        return self._track.history.landmark[i] + moved

    def _statuses(self) -> list[Stream]:
        """Return each change of status, and the status at each change and each second."""
        track, last, since = self._track, None, -math.inf
        changed, reported = list[int](), list[int]()
        for row, t in enumerate(track.t.tolist()):
            now = (track.status[row], track.reason[row])
            if now == last and t - since < STATUS_S:
                continue
            if now != last:
                changed.append(row)
            reported.append(row)
            last, since = now, t
        changes, reports = np.array(changed, int), np.array(reported, int)

        def words(row: int, text: str) -> dict[str, str]:
            status, reason = track.status[row], track.reason[row]
            message = f"{status.value}: {reason}" if reason else status.value
            return {"name": f"homeward: {track.estimator}", text: message}

        def change(at: np.ndarray) -> Fields:
            row = changed[at[0]]
            level = _WARN if LEVELS[track.status[row]] else _INFO
            return {"stamp": time(self._stamps[changes[at]]), "level": level, **words(row, "msg")}

        def report(at: np.ndarray) -> Fields:
            row = reported[at[0]]
            status = track.status[row]
            values = {"status": status.value}
            if self._has_pose[row]:
                names = ("sigma_x [m]", "sigma_y [m]", "sigma_heading [rad]")
                sigma = self._sigmas[row].tolist()
                values |= {n: f"{s:.4g}" for n, s in zip(names, sigma, strict=True)}
            pairs = [{"key": k, "value": v} for k, v in values.items()]
            found = {"level": LEVELS[status], **words(row, "message"), "values": pairs}
            return {"header": header(self._stamps[reports[at]], ""), "status": [found]}

        return [
            Stream(topic, kind, self._stamps[rows], fields, np.arange(rows.size))
            for topic, kind, rows, fields in (
                ("/homeward/status", "rcl_interfaces/msg/Log", changes, change),
                ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", reports, report),
            )
        ]

    def _true_poses(self, truth: Truth) -> Stream:
        stamps, poses = self._at(truth.t), np.column_stack([truth.x, truth.y, truth.heading])

        def fields(at: np.ndarray) -> Fields:
            return {"header": header(stamps[at]), "pose": pose(poses[at])}

        return Stream("/homeward/truth", "geometry_msgs/msg/PoseStamped", stamps, fields)

    def _images(self, images: Images) -> Stream:
        kept, last = list[int](), -math.inf
        for i, t in enumerate(images.t.tolist()):
            if t - last >= IMAGE_S:
                kept.append(i)
                last = t
        stamps = self._at(images.t[kept])

        def fields(at: np.ndarray) -> Fields:
            file = images.files[kept[at[0]]]
            return {
                "header": header(stamps[at], CAMERA),
                "format": KINDS[file.suffix.lower()].removeprefix("image/"),
                "data": np.frombuffer(file.read_bytes(), np.uint8)[None],
            }

        kind = "sensor_msgs/msg/CompressedImage"
        return Stream("/camera/image/compressed", kind, stamps, fields, np.arange(stamps.size))


def _marker(stamps: np.ndarray, i: int, places: np.ndarray, text: str) -> Fields:
    """Return the name of the landmark with index i at places, (n, 2)."""
    return {
        "header": header(stamps),
        "ns": "names",
        "id": i,
        "type": _TEXT,
        "pose": {
            "position": {"x": places[:, 0], "y": places[:, 1], "z": 0.3},
            "orientation": {"w": 1.0},
        },
        "scale": dict.fromkeys("xyz", 0.2),
        "color": dict.fromkeys("rgba", 1.0),
        "texture": {"header": header(stamps, "")},
        "text": text,
    }
