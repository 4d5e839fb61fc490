"""Bearings out of messages: as they are, or of points in an image or in space."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from homeward.drives.ros.measurements.camera import Intrinsics
from homeward.drives.ros.measurements.rows import Remarks
from homeward.drives.ros.messages.definitions import BEARINGS
from homeward.drives.ros.settings import BearingsTopic
from homeward.drives.text.table import is_identifier, quoted
from homeward.errors import InputError

DETECTIONS = "vision_msgs/msg/Detection2DArray"
TAGS = "apriltag_msgs/msg/AprilTagDetectionArray"
TAG_POSES = "apriltag_ros/msg/AprilTagDetectionArray"
POSE_ARRAY = "geometry_msgs/msg/PoseArray"
POINT = "geometry_msgs/msg/PointStamped"
IN_IMAGE = (TAGS, DETECTIONS)
"""Types whose points are pixels, and need a camera model."""

NO_ID = "sightings without an id"
NOTHING_THERE = "sightings that are not finite, or at the camera itself"
FIXED_FRAMES = ("map", "odom", "world", "earth")
"""Frames that do not move with the robot (REP 105)."""


class Sighting(NamedTuple):
    """One landmark in one message."""

    landmark: str
    a: float
    """The bearing [rad]; or the column [pixel]; or ahead [m]."""
    b: float = 0.0
    """The row [pixel]; or to the left [m]."""
    sigma: float = math.nan
    """[rad]"""


def sightings_of(message: Any, told: BearingsTopic) -> Iterator[Sighting]:
    """Return what a message of any of `READERS`, as rosbags decodes it, tells."""
    return READERS[message.__msgtype__](message, told)


def _bearings(message: Any, told: BearingsTopic) -> Iterator[Sighting]:
    ids, values, sigmas = message.landmarks, message.bearings, message.sigmas
    if len(ids) != len(values) or len(sigmas) not in (0, len(ids)):
        raise InputError(
            f"{told.topic}: a message has {len(ids)} landmarks, {len(values)} bearings and "
            f"{len(sigmas)} sigmas"
        )
    if not len(sigmas):
        sigmas = np.full(len(ids), math.nan)
    for landmark, value, sigma in zip(ids, values.tolist(), sigmas.tolist(), strict=True):
        yield Sighting(landmark, value, sigma=sigma)


def _detections(message: Any, told: BearingsTopic) -> Iterator[Sighting]:
    for detection in message.detections:
        centre = detection.bbox.center
        point = getattr(centre, "position", centre)
        yield Sighting(_detected(detection), point.x, point.y)


def _detected(detection: Any) -> str:
    """Return what a detector calls a thing: its own id, or its likeliest class.

    The message has had several forms; a tracker's id is the only one that tells two of a class
    apart.
    """
    for name in ("id", "tracking_id"):
        if value := getattr(detection, name, ""):
            return str(value)
    best = max(detection.results, key=_score, default=None)
    if best is None:
        return ""
    hypothesis = getattr(best, "hypothesis", best)
    return str(getattr(hypothesis, "class_id", getattr(hypothesis, "id", "")))


def _score(result: Any) -> float:
    return float(getattr(result, "hypothesis", result).score)


def _tags(message: Any, told: BearingsTopic) -> Iterator[Sighting]:
    for tag in message.detections:
        yield Sighting(str(tag.id), tag.centre.x, tag.centre.y)


def _tag_poses(message: Any, told: BearingsTopic) -> Iterator[Sighting]:
    for tag in message.detections:
        name = "+".join(str(i) for i in tag.id)
        yield Sighting(name, *_level(tag.pose.pose.pose.position, told.axes or "optical"))


def _pose_array(message: Any, told: BearingsTopic) -> Iterator[Sighting]:
    axes = _axes(message, told)
    for place, pose in enumerate(message.poses):
        yield Sighting(str(place), *_level(pose.position, axes))


def _point(message: Any, told: BearingsTopic) -> Iterator[Sighting]:
    name = told.landmark or told.topic.rstrip("/").rpartition("/")[2]
    yield Sighting(name, *_level(message.point, _axes(message, told)))


READERS: dict[str, Callable[[Any, BearingsTopic], Iterator[Sighting]]] = {
    BEARINGS: _bearings,
    TAGS: _tags,
    TAG_POSES: _tag_poses,
    DETECTIONS: _detections,
    POSE_ARRAY: _pose_array,
    POINT: _point,
}
"""By type, the best first."""


def _axes(message: Any, told: BearingsTopic) -> str:
    """Return how the axes of a message's frame lie (REP 103)."""
    frame = message.header.frame_id.strip("/")
    if frame in FIXED_FRAMES:
        raise InputError(
            f"{told.topic}: its points are in the frame {frame}, which does not move with the "
            "robot, so they tell no bearings"
        )
    return told.axes or ("optical" if frame.endswith(("optical_frame", "optical")) else "body")


def _level(point: Any, axes: str) -> tuple[float, float]:
    """Return how far a point lies ahead and to the left [m]."""
    return (point.x, point.y) if axes == "body" else (point.z, -point.x)


class SightingRows:
    """The sightings of a topic, as they come in."""

    def __init__(self, told: BearingsTopic, kind: str, remarks: Remarks) -> None:
        self.told, self.kind = told, kind
        self._t: list[float] = []
        self._ids: list[str] = []
        self._values: list[tuple[float, float, float]] = []
        self._remarks = remarks

    def add(self, t: float, message: Any) -> None:
        """Take the message of time `t` [s]."""
        for landmark, a, b, sigma in sightings_of(message, self.told):
            name = landmark.strip()
            absent = not (math.isfinite(a) and math.isfinite(b))
            if not name:
                self._remarks.count(NO_ID)
            elif absent or (self.kind not in (BEARINGS, *IN_IMAGE) and a == b == 0):
                self._remarks.count(NOTHING_THERE)
            elif not is_identifier(name):
                raise InputError(f"{self.told.topic}: {quoted(name)} cannot be a landmark's id")
            else:
                self._t.append(t)
                self._ids.append(name)
                self._values.append((a, b, sigma))

    def columns(self, camera: Intrinsics | None) -> dict[str, np.ndarray]:
        """Return t [s], landmark, bearing and sigma [rad] of all sightings, shape (n,) each."""
        values = np.array(self._values, float).reshape(-1, 3)
        a, b, sigma = values.T
        if self.kind == BEARINGS:
            bearing = a
        elif self.kind in IN_IMAGE:
            if camera is None:
                raise InputError(
                    f"{self.told.topic}: points of an image need a camera model; name its "
                    "CameraInfo topic, or the model itself, in the topics file"
                )
            bearing = camera.bearings(a, b)
        else:
            bearing = np.arctan2(b, a)
        if self.told.sigma is not None:
            sigma = np.where(np.isnan(sigma), self.told.sigma, sigma)
        ids = np.empty(len(self._ids), object)
        ids[:] = self._ids
        return {"t": np.array(self._t, float), "landmark": ids, "bearing": bearing, "sigma": sigma}
