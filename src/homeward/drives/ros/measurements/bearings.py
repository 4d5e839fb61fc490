"""Sightings in messages, by the paths of their fields."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from homeward.drives.cameras.lens import Lens
from homeward.drives.ros.measurements.structure import scale_of
from homeward.drives.ros.messages.presets import (
    ALL_SIGHTINGS,
    IN_PARTS,
    TRANSFORMS,
    id_text,
    values,
)
from homeward.drives.ros.settings import BearingsTopic, Layout, wildcard_part
from homeward.errors import InputError

FIXED_FRAMES = ("map", "odom", "world", "earth")
"""Frames that do not move with the robot (REP 105)."""


class Sighting(NamedTuple):
    """One landmark in one message."""

    landmark: str
    a: float
    """Bearing [rad], or column [px], or distance ahead [m]."""
    b: float = 0.0
    """Row [px], or distance to the left [m]."""
    up: float = 0.0
    """Height above the camera [m], of a point in space."""
    sigma: float = math.nan
    """Standard deviation of the bearing [rad], or of a corner [px]."""
    corners: tuple[tuple[float, float], ...] = ((math.nan, math.nan),) * 4
    """Columns and rows of a tag's corners [px], in order."""
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
            raise InputError(
                f"a message has {number} values of {path} and {len(places)} of {layout.place}",
            )
    axes = _axes(message, given, layout) if layout.position else ""
    scale = scale_of(layout)
    for k, (name, place) in enumerate(zip(ids, places, strict=True)):
        more: dict[str, Any] = {key: found[k] for key, found in extra.items()}
        if layout.bearing:
            yield Sighting(id_text(name), scale * float(place), **more)
        elif layout.corners:
            yield Sighting(id_text(name), 0.0, corners=_corners(place, layout.origin), **more)
        elif layout.pixel:
            centre = place.bbox.center
            point = getattr(centre, "position", centre)
            yield Sighting(_identified(name)[0], point.x, point.y)
        else:
            if hasattr(place, "results"):
                name, place = _detection(place)
            yield Sighting(id_text(name), *_ahead_left_up(place, axes))


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


def _corners(points: Any, origin: float) -> tuple[tuple[float, float], ...]:
    """Return corners from four points, from eight numbers, or from fields x0 to y3."""
    if isinstance(points, np.ndarray):
        return tuple((x - origin, y - origin) for x, y in points.reshape(-1, 2).tolist())
    if hasattr(points, "x0"):
        return tuple((getattr(points, f"x{k}"), getattr(points, f"y{k}")) for k in range(4))
    return tuple((p.x - origin, p.y - origin) for p in points)


def layout_of(kind: str, given: BearingsTopic) -> Layout:
    """Return the fields of landmarks in a topic: the given ones, or else those of its type."""
    known = ALL_SIGHTINGS.get(kind, Layout())
    return known if given.layout is None else given.layout._replace(axes=known.axes)


def has_bearings(kind: str, given: BearingsTopic) -> bool:
    """Whether the messages of a topic contain bearings."""
    return bool(layout_of(kind, given).bearing)


def has_positions(kind: str, given: BearingsTopic) -> bool:
    """Whether the messages of a topic contain points in space."""
    return bool(layout_of(kind, given).position)


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
        raise InputError(
            f"its points are in the fixed frame {frame}, so they are no bearings",
            advice="use a topic with points in the frame of the camera",
        )
    return given.axes or layout.axes or axes_of(frame, given)


def axes_of(frame: str, given: BearingsTopic) -> str:
    """Return the given axes of a camera's frame, or else those that its name implies (REP 103)."""
    return given.axes or ("optical" if frame.endswith(("optical_frame", "optical")) else "body")


def _ahead_left_up(point: Any, axes: str) -> tuple[float, float, float]:
    """Return the position of a point in the body axes of its frame [m]."""
    return (point.x, point.y, point.z) if axes == "body" else (point.z, -point.x, -point.y)
