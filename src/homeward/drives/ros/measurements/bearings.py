"""Bearings out of messages: as they are, or of points in an image or in space."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from homeward.drives.cameras.camera import tag_bearings
from homeward.drives.cameras.lens import Lens
from homeward.drives.ros.measurements.rows import Remarks
from homeward.drives.ros.settings import BEARINGS, PICTURES, BearingsTopic
from homeward.errors import InputError
from homeward.geometry.frames import Pose, compose
from homeward.io.table import is_identifier, quoted

DETECTIONS = "vision_msgs/msg/Detection2DArray"
TAGS = "apriltag_msgs/msg/AprilTagDetectionArray"
TAG_ARRAY = "apriltag_msgs/msg/ApriltagArrayStamped"
FIDUCIALS = "fiducial_msgs/msg/FiducialArray"
MARKERS = "aruco_msgs/msg/MarkerArray"
FIDUCIAL_POSES = "fiducial_msgs/msg/FiducialTransformArray"
TAG_POSES = "apriltag_ros/msg/AprilTagDetectionArray"
POSE_ARRAY = "geometry_msgs/msg/PoseArray"
POINT = "geometry_msgs/msg/PointStamped"
CORNERS = (TAGS, TAG_ARRAY, FIDUCIALS, *PICTURES)
"""Types that tell the corners of tags."""
IN_IMAGE = (*CORNERS, DETECTIONS)
"""Types whose points are pixels, and need a camera model."""
HALF_PIXEL = 0.5
"""AprilTag 3, whose corners apriltag_msgs/AprilTagDetection holds, has the middle of the first
pixel at (0.5, 0.5) (issue 121 of AprilRobotics/apriltag), and camera models at (0, 0) [px]."""

NO_ID = "sightings without an id"
BIT_ERRORS = "tags that were read with errors, left out"
TWICE = "sightings of a tag that is in one image more than once, left out"
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
    """[rad], or of a corner [px]."""
    corners: tuple[tuple[float, float], ...] = ((math.nan, math.nan),) * 4
    """Of a tag: columns and rows [px], in turn."""
    errors: int = 0
    """Of a tag: bits that were read otherwise than they must be."""


Reader: TypeAlias = Callable[[Any, BearingsTopic], Iterator[Sighting]]
Eye: TypeAlias = Callable[[Any, Lens | None], Iterator[Sighting]]
"""Returns the tags in a message of `PICTURES`; the camera may not have been told yet."""
CameraOf: TypeAlias = Callable[[], Lens | None]
"""Returns the camera, as far as it has been told."""


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


def _detection(found: Any) -> Sighting:
    """Return a detection by the id of a tracker, or else by its likeliest class."""
    centre = found.bbox.center
    point = getattr(centre, "position", centre)
    name = getattr(found, "id", "") or getattr(found, "tracking_id", "")
    if not name:
        hypotheses = [getattr(result, "hypothesis", result) for result in found.results]
        best = max(hypotheses, key=lambda hypothesis: float(hypothesis.score), default=None)
        name = getattr(best, "class_id", getattr(best, "id", ""))
    return Sighting(str(name), point.x, point.y)


def _corners(points: Any, off: float = 0.0) -> tuple[tuple[float, float], ...]:
    return tuple((p.x - off, p.y - off) for p in points)


def _points(
    named: Callable[[Any, BearingsTopic], Iterable[tuple[Any, Any]]], axes: str | None = None
) -> Reader:
    """Return a reader of named points in space; without `axes` their frame specifies the axes."""

    def read(message: Any, told: BearingsTopic) -> Iterator[Sighting]:
        lie = _axes(message, told) if axes is None else told.axes or axes
        for name, point in named(message, told):
            yield Sighting(str(name), *_level(point, lie))

    return read


READERS: dict[str, Reader] = {
    BEARINGS: _bearings,
    TAGS: lambda message, _: (
        Sighting(str(tag.id), 0.0, corners=_corners(tag.corners, HALF_PIXEL), errors=tag.hamming)
        for tag in message.detections
    ),
    TAG_ARRAY: lambda message, _: (
        Sighting(str(tag.id), 0.0, corners=_corners(tag.corners), errors=tag.hamming)
        for tag in message.apriltags
    ),
    FIDUCIALS: lambda message, _: (
        Sighting(
            str(tag.fiducial_id),
            0.0,
            corners=tuple((getattr(tag, f"x{k}"), getattr(tag, f"y{k}")) for k in range(4)),
        )
        for tag in message.fiducials
    ),
    MARKERS: _points(lambda message, _: ((m.id, m.pose.pose.position) for m in message.markers)),
    FIDUCIAL_POSES: _points(
        lambda message, _: ((t.fiducial_id, t.transform.translation) for t in message.transforms),
        "optical",
    ),
    TAG_POSES: _points(
        lambda message, _: (
            ("+".join(map(str, tag.id)), tag.pose.pose.pose.position) for tag in message.detections
        ),
        "optical",
    ),
    DETECTIONS: lambda message, _: map(_detection, message.detections),
    POSE_ARRAY: _points(
        lambda message, _: ((place, pose.position) for place, pose in enumerate(message.poses))
    ),
    POINT: _points(
        lambda message, told: [
            (told.landmark or told.topic.rstrip("/").rpartition("/")[2], message.point)
        ]
    ),
}
"""By type, the best first."""

IN_SPACE = tuple(kind for kind in READERS if kind not in (BEARINGS, *IN_IMAGE))
"""Types whose points are in space [m]."""


def frame_of(message: Any) -> str:
    """Return the frame that the header of a message names; empty without one."""
    header = getattr(message, "header", None)
    return str(getattr(header, "frame_id", "")).strip("/")


def _axes(message: Any, told: BearingsTopic) -> str:
    """Return how the axes of a message's frame lie (REP 103)."""
    frame = frame_of(message)
    if frame in FIXED_FRAMES:
        raise InputError(
            f"{told.topic}: its points are in the frame {frame}, which does not move with the "
            "robot, so they tell no bearings"
        )
    return axes_of(frame, told)


def axes_of(frame: str, told: BearingsTopic) -> str:
    """Return how the axes of a camera's frame lie, by its name where nothing is said (REP 103)."""
    return told.axes or ("optical" if frame.endswith(("optical_frame", "optical")) else "body")


def _level(point: Any, axes: str) -> tuple[float, float]:
    """Return how far a point lies ahead and to the left [m]."""
    return (point.x, point.y) if axes == "body" else (point.z, -point.x)


class SightingRows:
    """The sightings of a topic, as they come in."""

    def __init__(
        self,
        told: BearingsTopic,
        kind: str,
        remarks: Remarks,
        camera: CameraOf,
        eye: Eye | None = None,
    ) -> None:
        self.told, self.kind, self._camera, self._eye = told, kind, camera, eye
        self.in_reference = Pose(0.0, 0.0, 0.0)
        """The camera in the frame of the camera that all bearings are given for [m, m, rad]."""
        self._t: list[float] = []
        self._kept: list[Sighting] = []
        self._remarks = remarks

    def __len__(self) -> int:
        return len(self._t)

    def add(self, t: float, message: Any) -> None:
        """Take the message of time `t` [s]."""
        if self._eye is None:
            met = list(READERS[self.kind](message, self.told))
        else:
            met = list(self._eye(message, self._camera()))
        times = Counter(seen.landmark for seen in met)
        for seen in met:
            name = seen.landmark.strip()
            told = seen.corners if self.kind in CORNERS else ((seen.a, seen.b),)
            at_camera = self.kind not in (BEARINGS, *IN_IMAGE) and seen.a == seen.b == 0
            if not name:
                self._remarks.count(NO_ID)
            elif at_camera or not np.isfinite(told).all():
                self._remarks.count(NOTHING_THERE)
            elif seen.errors:
                self._remarks.count(BIT_ERRORS)
            elif self.kind in CORNERS and times[seen.landmark] > 1:
                self._remarks.count(TWICE)
            elif not is_identifier(name):
                raise InputError(f"{self.told.topic}: {quoted(name)} cannot be a landmark's id")
            else:
                self._t.append(t)
                self._kept.append(seen._replace(landmark=name))

    def columns(self) -> dict[str, np.ndarray]:
        """Return t [s], landmark, bearing and sigma [rad] of all sightings, shape (n,) each."""
        bearing, sigma = self._measured()
        if self.kind not in IN_SPACE and self.in_reference.heading:  # else to the last bit
            bearing = bearing + self.in_reference.heading
        if self.told.sigma is not None:
            sigma = np.where(np.isnan(sigma), self.told.sigma, sigma)
        ids = np.array([seen.landmark for seen in self._kept], object)
        columns = {"t": np.array(self._t, float), "landmark": ids}
        columns |= {"bearing": bearing, "sigma": sigma}
        # A lens that folds over has no ray for pixels beyond.
        there = np.isfinite(bearing)
        self._remarks.count(NOTHING_THERE, int((~there).sum()))
        return {name: values[there] for name, values in columns.items()}

    def _measured(self) -> tuple[np.ndarray, np.ndarray]:
        """Return bearings and their deviations [rad], NaN where not known, (n,) each."""
        rows = [(seen.a, seen.b, seen.sigma) for seen in self._kept]
        a, b, sigma = np.array(rows, float).reshape(-1, 3).T
        if self.kind == BEARINGS:
            return a, sigma
        if self.kind in IN_SPACE:
            x, y, _ = compose(self.in_reference, Pose(a, b, np.zeros_like(a)))
            return np.arctan2(y, x), sigma
        camera = self._camera()
        if camera is None:
            raise InputError(
                f"{self.told.topic}: points of an image need a camera model; name its "
                "CameraInfo topic, or the model itself, in the topics file"
            )
        camera = camera.model_copy(update=self.told.tilt)
        if self.kind == DETECTIONS:
            return camera.directions(a, b)[0], sigma
        corners = np.array([seen.corners for seen in self._kept], float).reshape(-1, 4, 2)
        each = np.where(np.isnan(sigma), self.told.pixel_sigma, sigma)
        bearing, sigma = tag_bearings(corners, each, camera, (0, 0))
        return bearing, sigma
