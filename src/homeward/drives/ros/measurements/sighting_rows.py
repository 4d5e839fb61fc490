"""The sightings of a topic, as rows of a table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from homeward.drives.cameras.camera import sizes_of, tilt_matrix
from homeward.drives.cameras.lens import Lens
from homeward.drives.cameras.tag_pose import TagPose, tag_poses
from homeward.drives.importers.positions import axes_by_spread
from homeward.drives.measure import bearings
from homeward.drives.ros.measurements.bearings import (
    Sighting,
    TagDetector,
    axes_of,
    has_bearings,
    has_positions,
    layout_of,
    sightings_in,
)
from homeward.drives.ros.measurements.rows import Remarks
from homeward.drives.ros.messages.presets import ALVAR, CORNERS
from homeward.drives.ros.settings import BearingsTopic
from homeward.errors import InputError
from homeward.geometry.frames import Pose, compose
from homeward.io.table import is_identifier, quoted

NOT_DECODED = 255
"""Id of a tag that ar_track_alvar found but did not decode."""
NO_ID = "sightings without an id, left out"
BIT_ERRORS = "tags decoded with bit errors, left out"
DUPLICATE = "sightings of a tag that appears twice in one image, left out"
NOT_FINITE = (
    "sightings that are not finite, or at the camera's position (as PhotonVision's in 2D mode), "
    "left out"
)
OPTICAL_BY_DATA = (
    "positions in {} in optical axes (x right, z ahead) according to their values, although the "
    "name of their frame {!r} does not end in optical; add axes: body to the topic if that is wrong"
)
CameraOf: TypeAlias = Callable[[], Lens | None]
"""Returns the camera, or None while it is unknown."""


class SightingRows:
    """The sightings of a topic, collected while a log is read."""

    def __init__(
        self,
        given: BearingsTopic,
        kind: str,
        remarks: Remarks,
        camera: CameraOf,
        detector: TagDetector | None = None,
    ) -> None:
        self.given, self.kind, self._camera, self._detector = given, kind, camera, detector
        self.in_reference = Pose(0.0, 0.0, 0.0)
        """The camera's pose in the frame of the reference camera of all bearings [m, m, rad]."""
        self.camera = ""
        """Name of the camera, if its bearings are from another one than the reference camera."""
        self._t: list[float] = []
        self._kept: list[Sighting] = []
        self._remarks = remarks

    def __len__(self) -> int:
        return len(self._t)

    @property
    def has_positions(self) -> bool:
        """Whether the sightings are points in space."""
        return has_positions(self.kind, self.given)

    def add(self, t: float, message: Any) -> None:
        """Add the message of time `t` [s]."""
        if self._detector is None:
            found = list(sightings_in(message, self.kind, self.given))
        else:
            found = list(self._detector(message, self._camera()))
        counts = Counter(seen.landmark for seen in found)
        for seen in found:
            name = seen.landmark.strip()
            values = seen.corners if self.kind in CORNERS else ((seen.a, seen.b),)
            at_camera = self.has_positions and seen.a == seen.b == 0
            if not name or (self.kind == ALVAR and name == str(NOT_DECODED)):
                self._remarks.count(NO_ID)
            elif at_camera or not np.isfinite(values).all():
                self._remarks.count(NOT_FINITE)
            elif seen.errors:
                self._remarks.count(BIT_ERRORS)
            elif self.kind in CORNERS and counts[seen.landmark] > 1:
                self._remarks.count(DUPLICATE)
            elif not is_identifier(name):
                raise InputError(f"{quoted(name)} is not a valid landmark id")
            else:
                self._t.append(t)
                self._kept.append(seen._replace(landmark=name))

    def use_axes_of_data(self, frame: str) -> None:
        """Assume optical axes where the positions have them, unless axes are given."""
        is_open = self.given.axes is None and layout_of(self.kind, self.given).axes != "optical"
        if not (self.has_positions and is_open) or axes_of(frame, self.given) == "optical":
            return
        points = np.array([(seen.a, seen.b, seen.up) for seen in self._kept])
        found = axes_by_spread(dict(zip("xyz", points.T, strict=True)))
        if found is None or found.kind != "camera":
            return
        self.given = self.given.model_copy(update={"axes": "optical"})
        self._kept = [seen._replace(a=seen.up, b=-seen.a, up=-seen.b) for seen in self._kept]
        self._remarks.count(OPTICAL_BY_DATA.format(self.given.topic, frame), len(self._kept))

    def columns(self) -> dict[str, np.ndarray]:
        """Return t [s], landmark, bearing, elevation, sigma [rad] and range [m], (n,) each.

        Elevation, sigma and range are NaN where unknown.
        """
        values = self._values()
        is_bearing = "bearing" in values
        found = bearings(values, None if is_bearing or self.has_positions else self._model())
        unknown = np.full(len(self), np.nan)
        bearing, sigma = found["bearing"], found.get("sigma", unknown)
        if not self.has_positions and self.in_reference.heading:  # otherwise unchanged
            bearing = bearing + self.in_reference.heading
        if self.given.sigma is not None:
            sigma = np.where(np.isnan(sigma), self.given.sigma, sigma)
        ids = np.array([seen.landmark for seen in self._kept], object)
        columns = {"t": np.array(self._t, float), "landmark": ids}
        columns |= {"bearing": bearing, "elevation": found.get("elevation", unknown)}
        columns |= {"sigma": sigma, "range": found.get("range", unknown)}
        columns["camera"] = np.full(len(ids), self.camera, object)
        # A lens model has no ray for pixels beyond its valid range.
        is_valid = np.isfinite(bearing)
        self._remarks.count(NOT_FINITE, int((~is_valid).sum()))
        return {name: values[is_valid] for name, values in columns.items()}

    def _values(self) -> dict[str, np.ndarray]:
        """Return what the messages contain, by role."""
        rows = [(seen.a, seen.b, seen.up, seen.sigma) for seen in self._kept]
        a, b, up, sigma = np.array(rows, float).reshape(-1, 4).T
        if self.has_positions:
            forward, left, up = self._places(a, b, up)
            return {"forward": forward, "left": left, "up": up, "sigma": sigma}
        if has_bearings(self.kind, self.given):
            return {"bearing": a, "sigma": sigma}
        if self.kind not in CORNERS:
            return {"column": a, "row": b, "sigma": sigma}
        tags = {"corners": self._corners(), "sigma": self._corner_sigmas()}
        if self.given.tag_size is not None:
            tags["size"] = sizes_of([seen.landmark for seen in self._kept], self.given.tag_size)
        return tags

    def tag_poses(self) -> dict[str, TagPose]:
        """Return the poses of tags by id, in the frame of their camera without its tilt."""
        names, level = [seen.landmark for seen in self._kept], {"roll": 0.0, "pitch": 0.0}
        camera, sizes = self._model().model_copy(update=level), sizes_of(names, self.given.tag_size)
        found = tag_poses(self._corners(), self._corner_sigmas(), sizes, camera, (0, 0))
        return {name: pose for name, pose in zip(names, found, strict=True) if pose is not None}

    def _places(
        self, a: np.ndarray, b: np.ndarray, up: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x, y, z [m] in the frame of the reference camera, of points in that of theirs."""
        if self.given.roll or self.given.pitch:
            level = tilt_matrix(self.given.roll or 0.0, self.given.pitch or 0.0)
            a, b, up = level @ np.array([a, b, up])
        x, y, _ = compose(self.in_reference, Pose(a, b, np.zeros_like(a)))
        return x, y, up

    def _corner_sigmas(self) -> np.ndarray:
        """Return the standard deviations of the corners of tags, (n,) [px]."""
        sigma = np.array([seen.sigma for seen in self._kept], float)
        return np.where(np.isnan(sigma), self.given.pixel_sigma, sigma)

    def _corners(self) -> np.ndarray:
        """Return the corners of tags, (n, 4, 2) [px]."""
        return np.array([seen.corners for seen in self._kept], float).reshape(-1, 4, 2)

    def _model(self) -> Lens:
        """Return the camera of points in an image; `InputError` where it is unknown."""
        camera = self._camera()
        if camera is None:
            raise InputError(
                "points in an image need a camera model",
                part=self.given.topic,
                advice="add camera to the topic in the topics file: a CameraInfo topic, "
                "a calibration file, or the model",
            )
        return camera.model_copy(update=self.given.tilt)
