"""Sightings in messages, by the paths of their fields, as rows of a table."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from homeward.drives.cameras.camera import sizes_of, tilt_matrix
from homeward.drives.cameras.lens import Lens
from homeward.drives.cameras.tag_pose import TagPose, tag_poses
from homeward.drives.columns import UNITS, unit_in
from homeward.drives.importers.positions import FIXED_FRAMES, axes_by_spread
from homeward.drives.measure import CORNERS, POINT, bearings, corners_of
from homeward.drives.ros.presets import ALL_SIGHTINGS, ALVAR, IN_PARTS, TRANSFORMS, id_text, values
from homeward.drives.ros.settings import BearingsTopic, Layout, wildcard_part
from homeward.drives.ros.stamps import Remarks
from homeward.errors import InputError
from homeward.geometry.frames import Pose, compose
from homeward.io.table import is_identifier, quoted

ROLES = {
    "bearing": ("bearing",),
    "position": ("forward", "left", "up"),
    "pixel": POINT,
    "corners": CORNERS,
}
"""Roles of the values that locate a landmark, by the field of `Layout` that has them."""


class Sighting(NamedTuple):
    """One landmark in one message."""

    landmark: str
    values: tuple[float, ...]
    """Of `ROLES`: bearing [rad], position [m], pixel [px], or corners of a tag in order [px]."""
    sigma: float = math.nan
    """Standard deviation of the bearing [rad], or of a corner [px]."""
    errors: int = 0
    """Number of wrong bits of a tag."""


TagDetector: TypeAlias = Callable[[Any, Lens | None], Iterator[Sighting]]
"""Returns the tags in a message of `PICTURES`; the camera may be unknown yet."""


def sightings_in(message: Any, kind: str, given: BearingsTopic) -> Iterator[Sighting]:
    """Yield the sightings in a message of a type; `InputError` where its lists do not match."""
    layout = layout_of(kind, given)
    places = values(message, layout.place)
    ids = values(message, layout.id) if layout.id else _unnamed(message, given, layout, places)
    extra = {
        name: list(map(float, found))
        for name, path in (("sigma", layout.sigma), ("errors", layout.errors))
        if path and (found := values(message, path))
    }
    for path, number in ((layout.id, len(ids)), (layout.sigma, len(extra.get("sigma", places)))):
        if number != len(places):
            problem = f"a message has {number} values of {path} and {len(places)} of {layout.place}"
            raise InputError(problem)
    axes = _axes(message, given, layout) if layout.position else ""
    scale = scale_of(layout)
    for k, (name, place) in enumerate(zip(ids, places, strict=True)):
        more: dict[str, Any] = {key: found[k] for key, found in extra.items()}
        located: tuple[float, ...]
        if layout.pixel:
            centre = place.bbox.center
            point = getattr(centre, "position", centre)
            name, located = _identified(name)[0], (point.x, point.y)
        elif layout.bearing:
            located = (scale * float(place),)
        elif layout.corners:
            located = _corners(place, layout.origin)
        else:
            if hasattr(place, "results"):
                name, place = _detection(place)
            x, y, z = place.x, place.y, place.z
            located = (x, y, z) if axes == "body" else (z, -x, -y)
        yield Sighting(id_text(name), located, **more)


def _unnamed(message: Any, given: BearingsTopic, layout: Layout, places: list[Any]) -> list[Any]:
    """Return the ids of sightings without one: the place in a list, or the name of the topic."""
    if "[]" in layout.place:
        return list(range(len(places)))
    if given.frames:
        return [landmark_of(message, given)]
    return [given.landmark or given.topic.rstrip("/").rpartition("/")[2]]


def _identified(found: Any) -> tuple[str, Any]:
    """Return a detection's id of a tracker, or else its likeliest class; and that hypothesis."""
    best = max(found.results, key=lambda result: float(_hypothesis(result).score), default=None)
    name = getattr(found, "id", "") or getattr(found, "tracking_id", "")
    known = _hypothesis(best)
    return str(name or getattr(known, "class_id", getattr(known, "id", ""))), best


def _hypothesis(result: Any) -> Any:
    return getattr(result, "hypothesis", result)


def _detection(found: Any) -> tuple[str, Any]:
    """Return the id of a detection and its position, or the centre of its box without one."""
    name, best = _identified(found)
    position = found.bbox.center.position if best is None else best.pose.pose.position
    is_missing = position.x == position.y == position.z == 0
    return name, found.bbox.center.position if is_missing else position


def scale_of(layout: Layout) -> float:
    """Return the size of the unit of bearings [rad], according to their name."""
    return UNITS["angle"][
        unit_in(layout.bearing.rpartition(".")[2].removesuffix("[]"), "angle") or "rad"
    ]


def _corners(points: Any, origin: float) -> tuple[float, ...]:
    """Return corners from four points, from eight numbers, or from fields x0 to y3."""
    if hasattr(points, "x0"):
        return tuple(getattr(points, f"{axis}{k}") for k in range(4) for axis in "xy")
    if isinstance(points, np.ndarray):
        return tuple((points - origin).ravel().tolist())
    return tuple(value - origin for p in points for value in (p.x, p.y))


def layout_of(kind: str, given: BearingsTopic) -> Layout:
    """Return the fields of landmarks in a topic: the given ones, or else those of its type."""
    known = ALL_SIGHTINGS.get(kind, Layout())
    return known if given.layout is None else given.layout._replace(axes=known.axes)


def form_of(kind: str, given: BearingsTopic) -> str:
    """Return the key of `ROLES` for the messages of a topic: images contain corners of tags."""
    layout = layout_of(kind, given)
    return next((form for form in ROLES if getattr(layout, form)), "corners")


def parts_of(kind: str, message: Any, layout: Layout | None = None) -> Iterable[Any]:
    """Return the parts of a message that have a header each, or else the message.

    The items of a list count where the message itself has no frame or no stamp.
    """
    if kind in TRANSFORMS:
        return tuple(message.transforms)
    name = getattr(layout or ALL_SIGHTINGS.get(kind), "list_name", "")
    outer = getattr(message, "header", None)
    is_complete = outer is not None and bool(outer.frame_id) and _is_set(outer.stamp)
    if not name or (kind not in IN_PARTS and is_complete):
        return (message,)
    parts = []
    for item in getattr(message, name):
        inner = getattr(getattr(item, "pose", None), "header", None)
        headers = [h for h in (getattr(item, "header", None), inner, outer) if h is not None]
        if not headers or headers == [outer]:
            return (message,)
        header = SimpleNamespace(
            frame_id=next((h.frame_id for h in headers if h.frame_id), ""),
            stamp=next((h.stamp for h in headers if _is_set(h.stamp)), headers[0].stamp),
        )
        parts.append(SimpleNamespace(header=header, **{name: [item]}))
    return parts


def _is_set(stamp: Any) -> bool:
    return bool(stamp.sec or stamp.nanosec)


def landmark_of(transform: Any, given: BearingsTopic) -> str | None:
    """Return the landmark id of a transform; None where its frame is not a landmark."""
    name = wildcard_part((given.frames or "").strip("/"), transform.child_frame_id.strip("/"))
    return name and (given.landmark or name)


def frame_of(message: Any) -> str:
    """Return the frame_id of a message; empty without one."""
    header = getattr(message, "header", None)
    return str(getattr(header, "frame_id", "")).strip("/")


def _axes(message: Any, given: BearingsTopic, layout: Layout) -> str:
    """Return the convention of the axes of positions: of the layout, or else of the frame."""
    frame = frame_of(message)
    if not layout.axes and frame in FIXED_FRAMES:
        problem = f"its points are in the fixed frame {frame}, so they are no bearings"
        raise InputError(problem, advice="use a topic with points in the frame of the camera")
    return given.axes or layout.axes or axes_of(frame, given)


def axes_of(frame: str, given: BearingsTopic) -> str:
    """Return the given axes of a camera's frame, or else those that its name implies (REP 103)."""
    return given.axes or ("optical" if frame.endswith(("optical_frame", "optical")) else "body")


NOT_DECODED = 255
"""Id of a tag that ar_track_alvar found but did not decode."""
NO_ID = "sightings without an id, left out"
NO_CORNERS = "tags whose four corners are one point, left out: their driver does not report corners"
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
SHARES = "pixels that are shares of the size of the image, as all of them are at most 1"
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
        frame: str = "",
    ) -> None:
        self.given, self.kind, self._camera, self._detector = given, kind, camera, detector
        self.frame = frame
        """The frame_id of the messages; empty without one."""
        self.form = form_of(kind, given)
        """The key of `ROLES` for the values of the sightings."""
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
    def name(self) -> str:
        """The topic and the frame, for messages."""
        return f"{self.given.topic} (frame {self.frame or 'not named'})"

    @property
    def _names(self) -> list[str]:
        return [seen.landmark for seen in self._kept]

    def add(self, t: float, message: Any) -> None:
        """Add the message of time `t` [s]."""
        if self._detector is None:
            found = list(sightings_in(message, self.kind, self.given))
        else:
            found = list(self._detector(message, self._camera()))
        counts = Counter(seen.landmark for seen in found)
        has_corners = self.form == "corners"
        for seen in found:
            name = seen.landmark.strip()
            located = seen.values[:2] if self.form == "position" else seen.values
            at_camera = self.form == "position" and not any(located)
            if not name or (self.kind == ALVAR and name == str(NOT_DECODED)):
                self._remarks.count(NO_ID)
            elif at_camera or not all(map(math.isfinite, located)):
                self._remarks.count(NOT_FINITE)
            elif seen.errors:
                self._remarks.count(BIT_ERRORS)
            elif has_corners and len(set(seen.values)) <= 2:
                self._remarks.count(NO_CORNERS)
            elif has_corners and counts[seen.landmark] > 1:
                self._remarks.count(DUPLICATE)
            elif not is_identifier(name):
                raise InputError(f"{quoted(name)} is not a valid landmark id")
            else:
                self._t.append(t)
                self._kept.append(seen._replace(landmark=name))

    def use_axes_of_data(self) -> None:
        """Assume optical axes where the positions have them, unless axes are given."""
        is_open = self.given.axes is None and layout_of(self.kind, self.given).axes != "optical"
        is_open = is_open and self.form == "position"
        if not is_open or axes_of(self.frame, self.given) == "optical":
            return
        points = np.array([seen.values for seen in self._kept])
        found = axes_by_spread(dict(zip("xyz", points.T, strict=True)))
        if found is None or found.kind != "camera":
            return
        self.given = self.given.model_copy(update={"axes": "optical"})
        self._kept = [
            seen._replace(values=(seen.values[2], -seen.values[0], -seen.values[1]))
            for seen in self._kept
        ]
        self._remarks.count(OPTICAL_BY_DATA.format(self.given.topic, self.frame), len(self._kept))

    def columns(self) -> dict[str, np.ndarray]:
        """Return t [s], landmark, bearing, elevation, sigma [rad] and range [m], (n,) each.

        Elevation, sigma and range are NaN where unknown.
        """
        values = self._values()
        lens = self._model() if self.form in ("pixel", "corners") else None
        if lens is not None and self.form == "pixel" and len(self):
            points = np.stack([values[role] for role in ROLES["pixel"]])
            if points.min() >= 0.0 and points.max() <= 1.0:
                values = lens.in_pixels(values)
                self._remarks.count(SHARES, len(self))
        found = bearings(values, lens)
        unknown = dict.fromkeys(("elevation", "sigma", "range"), np.full(len(self), np.nan))
        columns = {"t": np.array(self._t, float), "landmark": np.array(self._names, object)}
        columns |= unknown | {"camera": np.full(len(self), self.camera, object)} | found
        if self.form != "position" and self.in_reference.heading:  # otherwise unchanged
            columns["bearing"] = columns["bearing"] + self.in_reference.heading
        if self.given.sigma is not None:
            sigma = columns["sigma"]
            columns["sigma"] = np.where(np.isnan(sigma), self.given.sigma, sigma)
        # A lens model has no ray for pixels beyond its valid range.
        is_valid = np.isfinite(columns["bearing"])
        self._remarks.count(NOT_FINITE, int((~is_valid).sum()))
        return {name: values[is_valid] for name, values in columns.items()}

    def _values(self) -> dict[str, np.ndarray]:
        """Return what the messages contain, by role; points in the frame of the reference camera.

        Corners have the standard deviation and the size of each tag.
        """
        roles = ROLES[self.form]
        rows = np.array([(*seen.values, seen.sigma) for seen in self._kept], float)
        *located, sigma = rows.reshape(-1, len(roles) + 1).T
        found = dict(zip(roles, located, strict=True)) | {"sigma": sigma}
        if self.form == "position":
            places = np.array(located)
            if self.given.roll or self.given.pitch:
                places = tilt_matrix(self.given.roll or 0.0, self.given.pitch or 0.0) @ places
            place = Pose(places[0], places[1], np.zeros_like(sigma))
            found["forward"], found["left"], _ = compose(self.in_reference, place)
            found["up"] = places[2]
        if self.form == "corners":
            found["sigma"] = np.where(np.isnan(sigma), self.given.pixel_sigma, sigma)
            if self.given.tag_size is not None:
                found["size"] = sizes_of(self._names, self.given.tag_size)
        return found

    def tag_poses(self) -> dict[str, TagPose]:
        """Return the poses of tags by id, in the frame of their camera without its tilt."""
        names, values = self._names, self._values()
        camera = self._model().model_copy(update={"roll": 0.0, "pitch": 0.0})
        sizes = values.get("size", np.full(len(names), np.nan))
        found = tag_poses(corners_of(values), values["sigma"], sizes, camera, (0, 0))
        return {name: pose for name, pose in zip(names, found, strict=True) if pose is not None}

    def _model(self) -> Lens:
        """Return the camera of points in an image; `InputError` where it is unknown."""
        camera = self._camera()
        if camera is None:
            raise InputError(
                "points in an image need a camera model",
                part=self.given.topic,
                advice="add it in the topics file, as camera: FILE (a calibration), camera: TOPIC "
                "(CameraInfo), or its model",
            )
        return camera.model_copy(update=self.given.tilt)
