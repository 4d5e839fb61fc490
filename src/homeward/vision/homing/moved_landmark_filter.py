"""What pictures say to a landmark being called moved.

Most features whose home bearing is wrong were mistaken for another of home's. Such matches come
and go, or slide along an edge. What is on a thing that was moved is seen again and again, well away
from where it stood; or keeps its place among the features of that thing; or has gone where a
neighbour has that does.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterable

from homeward.angles import wrap
from homeward.estimator import LandmarkEstimate
from homeward.vision.comparison import Comparison
from homeward.vision.front_end import home_name

LASTING, LASTING_SHARE = 8, 0.3
"""A landmark may be called moved if seen so often, in such a share of the frames since then,"""
FEWEST_MOVED_M = 0.2
"""and so far across the line from home [m]: by less, features slide along edges;"""
FEWEST_TOGETHER, TOGETHER_SHARE = 3, 0.1
"""or if in so many frames, and for so many of its sightings, it went along with others that
contradict the robot's motion, too;"""
BESIDE, ALIKE = 0.2, 0.2
"""or if home saw it so near to such a landmark [rad], and its distance, and what its home bearing
is wrong by, are the same but for this share."""


class MovedLandmarkFilter:
    """Remembers how landmarks were seen, and withholds a verdict that a wrong match explains."""

    def __init__(self) -> None:
        self._frames = 0
        self._seen: dict[str, tuple[int, int]] = {}
        """How often each landmark was seen, and after how many frames first."""
        self._together: Counter[str] = Counter()
        """In how many frames each one was on a thing that seemed to have been moved."""

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
        """Return landmarks of which none is called moved that may be a wrong match."""
        called = [m for m in landmarks if m.moved]
        sure = [m for m in called if self._lasts(m) or self._is_of_a_thing(m)]
        believed = {m.landmark for m in called if any(m is s or _beside(m, s) for s in sure)}
        return [
            m
            if not m.moved or m.landmark in believed
            else dataclasses.replace(m, moved=None, moved_probability=math.nan)
            for m in landmarks
        ]

    def _lasts(self, found: LandmarkEstimate) -> bool:
        """Say whether a landmark moved while it was watched, or is seen again and again far off."""
        times, first = self._seen.get(found.landmark, (0, self._frames))
        lasting = times >= LASTING and times >= LASTING_SHARE * (self._frames - first)
        away = found.distance * abs(_turned(found))
        return math.isfinite(found.moved_at) or (lasting and away >= FEWEST_MOVED_M)

    def _is_of_a_thing(self, found: LandmarkEstimate) -> bool:
        """Say whether a landmark went along with others often enough."""
        times, _ = self._seen.get(found.landmark, (0, 0))
        return self._together[found.landmark] >= max(FEWEST_TOGETHER, TOGETHER_SHARE * times)


def _turned(found: LandmarkEstimate) -> float:
    """Return by how much a home bearing is wrong [rad]."""
    return float(wrap(found.home_bearing_estimated - found.home_bearing_stored))


def _beside(found: LandmarkEstimate, sure: LandmarkEstimate) -> bool:
    """Say whether a landmark stood beside another at home, and has gone where that one has."""
    apart = wrap(found.home_bearing_stored - sure.home_bearing_stored)
    return (
        abs(float(apart)) < BESIDE
        and abs(float(wrap(_turned(found) - _turned(sure)))) < ALIKE * abs(_turned(sure))
        and abs(found.distance - sure.distance) < ALIKE * sure.distance
    )
