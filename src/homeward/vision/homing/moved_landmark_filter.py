"""Moved-landmark filter: tells landmarks that moved from wrong matches.

Most features whose home bearing is wrong were mistaken for another of home's: such matches come and
go, or slide along an edge. A feature of an object that moved is seen again and again, well away
from where it stood; or is matched with others of that object; or went where such a neighbour went.
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

LASTING, LASTING_SHARE = 8, 0.3
"""A landmark lasts that was seen so often, and in such a share of the frames since the first."""
MIN_MOVED_M = 0.2
"""Least move of a lasting landmark across the line from home [m]: by less, features slide on
edges."""
MIN_TOGETHER, TOGETHER_SHARE = 3, 0.1
"""Least number of frames, and share of its sightings, in which a landmark was in a moved group."""
ALIKE = 0.2
"""Largest angle at home between a moved landmark and a neighbour of it [rad], and largest
difference of their distances and of their bearing errors, as a share."""


class MovedLandmarkFilter:
    """Counts how landmarks were seen, and withdraws a verdict that a wrong match explains."""

    def __init__(self) -> None:
        self._frames = 0
        self._seen: dict[str, tuple[int, int]] = {}
        """How often each landmark was seen, and after how many frames first."""
        self._together: Counter[str] = Counter()
        """In how many frames each was in a moved group."""

    def add_frame(self, names: Iterable[str]) -> None:
        """Take the landmarks that one frame showed."""
        for name in names:
            times, first = self._seen.get(name, (0, self._frames))
            self._seen[name] = times + 1, first
        self._frames += 1

    def add_comparison(self, seen: Comparison) -> None:
        """Take how a frame compares with home's picture."""
        self._together.update(home_name(row) for row in seen.home_row[seen.moved].tolist())

    def filtered(self, landmarks: list[LandmarkEstimate]) -> list[LandmarkEstimate]:
        """Return landmarks; none is called moved that may be a wrong match."""
        called = [m for m in landmarks if m.moved]
        sure = [m for m in called if self._lasts(m) or self._in_moved_group(m)]
        believed = {m.landmark for m in called if any(m is s or _beside(m, s) for s in sure)}
        return [
            m
            if not m.moved or m.landmark in believed
            else dataclasses.replace(m, moved=None, moved_probability=math.nan)
            for m in landmarks
        ]

    def _lasts(self, found: LandmarkEstimate) -> bool:
        """Say whether a landmark moved while it was watched, or is seen lastingly far off."""
        times, first = self._seen.get(found.landmark, (0, self._frames))
        lasting = times >= LASTING and times >= LASTING_SHARE * (self._frames - first)
        away = found.distance * abs(_turned(found))
        return math.isfinite(found.moved_at) or (lasting and away >= MIN_MOVED_M)

    def _in_moved_group(self, found: LandmarkEstimate) -> bool:
        """Say whether a landmark was in a moved group often enough."""
        times, _ = self._seen.get(found.landmark, (0, 0))
        return self._together[found.landmark] >= max(MIN_TOGETHER, TOGETHER_SHARE * times)


def _turned(found: LandmarkEstimate) -> float:
    """Return by how much a home bearing is wrong [rad]."""
    return float(wrap(found.home_bearing_estimated - found.home_bearing_stored))


def _beside(found: LandmarkEstimate, sure: LandmarkEstimate) -> bool:
    """Say whether a landmark stood beside another at home, and has gone where that one has."""
    apart = wrap(found.home_bearing_stored - sure.home_bearing_stored)
    return (
        abs(float(apart)) < ALIKE
        and abs(float(wrap(_turned(found) - _turned(sure)))) < ALIKE * abs(_turned(sure))
        and abs(found.distance - sure.distance) < ALIKE * sure.distance
    )
