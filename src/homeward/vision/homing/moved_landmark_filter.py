"""Moved-landmark filter: distinguishes landmarks that moved from wrong matches.

Most features whose home bearing is wrong were matched with another feature of home: such matches
come and go, or slide along an edge. A feature of a moved object is seen repeatedly, clearly away
from its old position; or is matched together with others of that object; or has moved like a
neighbour of which that is known.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterable

from homeward.estimator import LandmarkEstimate
from homeward.geometry.angles import wrap
from homeward.vision.comparison import Comparison
from homeward.vision.front_end import home_name

LASTING_SIGHTINGS, LASTING_SHARE = 8, 0.3
"""Minimum number of sightings of a lasting landmark, also as a share of frames since the first."""
MIN_MOVED_M = 0.2
"""Minimum shift of a lasting landmark across the line from home [m]: features slide on edges by
less."""
MIN_TOGETHER, TOGETHER_SHARE = 3, 0.1
"""Minimum number of frames, also as a share of its sightings, with a landmark in a moved group."""
ALIKE = 0.2
"""Maximum angle at home between a moved landmark and a neighbour [rad], and maximum relative
difference of their distances and of their bearing errors."""


class MovedLandmarkFilter:
    """Collects sightings of landmarks, and reverts `moved` where a wrong match explains it."""

    def __init__(self) -> None:
        self._frames = 0
        self._seen: dict[str, tuple[int, int]] = {}
        """Number of sightings of each landmark, and of frames before the first."""
        self._together: Counter[str] = Counter()
        """Number of frames in which each landmark was in a moved group."""

    def add_frame(self, names: Iterable[str]) -> None:
        """Add the landmarks seen in one frame."""
        for name in names:
            times, first = self._seen.get(name, (0, self._frames))
            self._seen[name] = times + 1, first
        self._frames += 1

    def add_comparison(self, seen: Comparison) -> None:
        """Add the comparison of a frame with home's picture."""
        self._together.update(home_name(row) for row in seen.home_row[seen.moved].tolist())

    def filtered(self, landmarks: list[LandmarkEstimate]) -> list[LandmarkEstimate]:
        """Return the landmarks; `moved` is None where it may be due to a wrong match."""
        moved = [m for m in landmarks if m.moved]
        certain = [m for m in moved if self._lasts(m) or self._in_moved_group(m)]
        kept = {m.landmark for m in moved if any(m is s or _moved_alike(m, s) for s in certain)}
        return [
            m
            if not m.moved or m.landmark in kept
            else dataclasses.replace(m, moved=None, moved_probability=math.nan)
            for m in landmarks
        ]

    def _lasts(self, found: LandmarkEstimate) -> bool:
        """Return whether a landmark moved during the drive, or is lastingly seen elsewhere."""
        times, first = self._seen.get(found.landmark, (0, self._frames))
        lasting = times >= LASTING_SIGHTINGS and times >= LASTING_SHARE * (self._frames - first)
        away = found.distance * abs(_bearing_error(found))
        return math.isfinite(found.moved_at) or (lasting and away >= MIN_MOVED_M)

    def _in_moved_group(self, found: LandmarkEstimate) -> bool:
        """Return whether a landmark was in a moved group in enough frames."""
        times, _ = self._seen.get(found.landmark, (0, 0))
        return self._together[found.landmark] >= max(MIN_TOGETHER, TOGETHER_SHARE * times)


def _bearing_error(found: LandmarkEstimate) -> float:
    """Return the error of a stored home bearing [rad]."""
    return float(wrap(found.home_bearing_estimated - found.home_bearing_stored))


def _moved_alike(found: LandmarkEstimate, other: LandmarkEstimate) -> bool:
    """Return whether two landmarks were neighbours at home, and have moved in the same way."""
    apart = wrap(found.home_bearing_stored - other.home_bearing_stored)
    error, error_of_other = _bearing_error(found), _bearing_error(other)
    return (
        abs(float(apart)) < ALIKE
        and abs(float(wrap(error - error_of_other))) < ALIKE * abs(error_of_other)
        and abs(found.distance - other.distance) < ALIKE * other.distance
    )
