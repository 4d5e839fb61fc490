"""Views of landmarks on a visit: the directions from which a camera could see each, and did.

A landmark that was not seen is evidence that it is gone only where it could be seen. Walls and
shelves are unknown, so that is where a robot saw it before: from the same direction, at least as
far away. Directions are sectors around the landmark, in the frame of the place.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.geometry.se2 import MIN_DISTANCE, compose, sight
from homeward.localizer.tunables import INLIER
from homeward.places.joint_map import JointMap

SECTORS = 24
"""Number of sectors around a landmark, of 15 degrees each."""
RANGE_QUANTILE = 0.9
"""Range of the camera, as a quantile of the distances of its sightings."""
MAX_DISTANCES = 4000
"""Maximum number of distances for that quantile."""

MAX_PAIRS = 500_000
"""Maximum number of pairs of a frame and a landmark at a time, for 50 MB of memory."""


def _none() -> np.ndarray:
    return np.zeros(SECTORS)


@dataclass
class Views:
    """Views of the landmarks of a place by one camera, up to now."""

    passed: dict[str, np.ndarray] = field(default_factory=dict)
    """By landmark, (SECTORS,): minimum distance of the camera in each sector with the landmark in
    its field of view [m]; infinite where it never was."""
    seen: dict[str, np.ndarray] = field(default_factory=dict)
    """By landmark that was seen, (SECTORS,): maximum distance at which it was [m], or 0."""
    _distances: list[float] = field(default_factory=list)

    def add(self, places: JointMap, frames: VisitFrames, origin: Pose) -> None:
        """Add frames; `origin` is the pose of their home in the frame of the place."""
        step, number = max(MAX_PAIRS // max(len(places.names), 1), 1), len(frames.seen)
        cameras = compose(np.array(origin), frames.cameras)
        sigmas = np.zeros(number) if frames.sigmas is None else frames.sigmas
        half = math.pi if frames.field_of_view is None else 0.5 * frames.field_of_view
        for some in (slice(k, k + step) for k in range(0, number, step)):
            self._add(places, cameras[some], sigmas[some], frames.seen[some], half)

    def _add(
        self,
        places: JointMap,
        cameras: np.ndarray,
        sigmas: np.ndarray,
        seen: Sequence[Collection[str]],
        half: float,
    ) -> None:
        """Add some frames; `half` is half of the field of view [rad]."""
        index = {name: i for i, name in enumerate(places.names)}
        saw = np.zeros((len(seen), len(places.names)), bool)
        for row, names in enumerate(seen):
            saw[row, [index[n] for n in names if n in index]] = True
        there = sight(cameras[:, None], places.positions[None])
        distances = np.hypot(there.offset[..., 0], there.offset[..., 1])
        is_certain = np.isfinite(sigmas)[:, None]
        self._distances += distances[saw & is_certain].tolist()
        del self._distances[:-MAX_DISTANCES]
        reach = np.quantile(self._distances, RANGE_QUANTILE) if self._distances else 0.0
        errors = INLIER * np.hypot(sigmas[:, None], places.sigmas)
        around = errors / np.maximum(distances, MIN_DISTANCE)
        inside = (np.abs(wrap(there.bearing)) + around < half) | (half >= math.pi)
        inside &= (distances + errors < reach) & (around < math.pi / SECTORS)
        back = np.arctan2(there.offset[..., 1], there.offset[..., 0]) + math.pi
        sectors = np.floor(back * (SECTORS / math.tau)).astype(int) % SECTORS
        nearest = np.full((len(places.names), SECTORS), np.inf)
        farthest = np.zeros((len(places.names), SECTORS))
        for found, keep, at in (
            (inside | (saw & is_certain), nearest, np.minimum),
            (saw & is_certain, farthest, np.maximum),
        ):
            rows, columns = np.nonzero(found)
            at.at(keep, (columns, sectors[rows, columns]), distances[rows, columns])
        for i, name in enumerate(places.names):
            if saw[:, i].any():
                self.seen[name] = np.maximum(self.seen.get(name, _none()), farthest[i])
            if np.isfinite(nearest[i]).any():
                before = self.passed.get(name, np.full(SECTORS, np.inf))
                self.passed[name] = np.minimum(before, nearest[i])

    def views(self, places: JointMap, origin: Pose) -> Views:
        """Return these views, as `VisitFrames.views`."""
        return self

    def in_sight(self, known: Mapping[str, np.ndarray]) -> tuple[dict[str, int], float]:
        """Return the number of views with each landmark in sight, and the share that saw it.

        A view is a sector in which it was in the field of view, at most as far away as it was seen
        there before: `known` are the distances of `seen` on earlier visits. The share is that of
        landmarks that were seen.
        """
        number, of_seen, saw = dict[str, int](), 0, 0
        for name, passed in self.passed.items():
            is_in_sight = passed <= known.get(name, _none())
            number[name] = int(is_in_sight.sum())
            if name in self.seen:
                of_seen += number[name]
                saw += int((is_in_sight & (self.seen[name] > 0.0)).sum())
        return number, saw / of_seen if of_seen else 0.0


@dataclass(frozen=True)
class VisitFrames:
    """Poses of the camera and landmarks seen, in m frames."""

    cameras: np.ndarray
    """(m, 3), in the frame of the drive's home."""
    seen: Sequence[Collection[str]]
    field_of_view: float | None
    """[rad]"""
    sigmas: np.ndarray | None = None
    """(m,): standard deviations of the positions [m], NaN if not certain; None: all exact."""

    def views(self, places: JointMap, origin: Pose) -> Views:
        """Return the views of a place; `origin` is the pose of the drive's home in its frame."""
        found = Views()
        found.add(places, self, origin)
        return found
