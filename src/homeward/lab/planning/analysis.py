"""Analysis of a plan: accuracy map, and what hiding landmarks costs."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from homeward.lab.planning.accuracy import Arcs, Information, home_sees
from homeward.lab.planning.floor import Floor, check_place, make_floor
from homeward.lab.planning.settings import Plan

SLICE = 4000
"""Number of matrices inverted at once, so that they stay in the cache."""

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Places:
    """n places and q landmarks."""

    arcs: Arcs
    floor: Floor
    places: np.ndarray
    """(n, 2) [m]"""
    marks: np.ndarray
    """(q, 2) [m]"""
    stored: np.ndarray
    """(q,), bool"""

    @cached_property
    def visible(self) -> np.ndarray:
        """(n, q), bool: line of sight; computed lazily, in a thread."""
        return self.floor.sees(self.places, self.marks)

    def results(self) -> tuple[np.ndarray, ...]:
        """Return position, heading, common (n,), score (n,), and scores with one hidden (n, q)."""
        n, q = len(self.places), len(self.marks)
        position, heading = np.full(n, np.inf), np.full(n, np.inf)
        common, score, hidden = np.zeros(n, int), np.full(n, np.inf), np.full((n, q), np.inf)
        for h in range(len(self.arcs.headings)):
            info = self.arcs.information(self.places, self.marks, self.visible, self.stored, h)
            fix = self.arcs.fix(info.every)
            common = np.maximum(common, info.count)
            better = fix.position < position
            position = np.where(better, fix.position, position)
            heading = np.where(better, fix.heading, heading)
            here = self.arcs.score(fix, info.count)
            score = np.minimum(score, here)
            hidden = np.minimum(hidden, self._without_each(info, here))
        return position, heading, common, score, hidden

    def _without_each(self, info: Information, score: np.ndarray) -> np.ndarray:
        """Return scores (n, q) without each landmark, given those with all landmarks (n,)."""
        out = np.repeat(score[:, None], len(self.marks), axis=1)
        place, mark = np.nonzero(info.seen)
        for begin in range(0, place.size, SLICE):
            row, hidden = place[begin : begin + SLICE], mark[begin : begin + SLICE]
            fix = self.arcs.fix(info.every[row] - info.each[row, hidden])
            out[row, hidden] = self.arcs.score(fix, info.count[row] - info.common[row, hidden])
        return out


CHUNK = 500
"""Number of places in a group."""


@dataclass(frozen=True)
class PlanView:
    """Accuracy at n places of a floor with q landmarks.

    A score is the larger of the minimum errors of position and heading, each relative to its limit;
    infinite with fewer common landmarks than the limit. Homing can begin where it is at most 1.
    """

    plan: Plan
    floor: Floor
    names: tuple[str, ...]
    marks: np.ndarray
    """(q, 2) [m]"""
    stored: np.ndarray
    """(q,), bool: whether home sees the landmark."""
    position: np.ndarray
    """(n,), minimum position error [m], RMS; infinite where unobservable."""
    heading: np.ndarray
    """(n,), minimum heading error [rad], RMS; infinite where unobservable."""
    common: np.ndarray
    """(n,), number of landmarks seen there and from home."""
    score: np.ndarray
    """(n,)"""
    hidden: np.ndarray
    """(n, q), the score with one landmark hidden."""

    @property
    def begins(self) -> np.ndarray:
        """(n,), bool: where homing can begin."""
        return np.asarray(self.score <= 1)

    @property
    def safe(self) -> np.ndarray:
        """(n,), bool: where homing can begin with any one landmark hidden."""
        worst = np.column_stack([self.score, self.hidden]).max(axis=1)
        return np.asarray(worst <= 1)


def analyse(plan: Plan, progress: Progress | None = None) -> PlanView:
    """Analyse a plan; errors as `make_floor`."""
    floor, arcs, marks = make_floor(plan), Arcs(plan), plan.marks
    stored, found = home_sees(plan, floor, marks), []
    parts = np.array_split(floor.points, -(-len(floor.points) // CHUNK))
    groups = [Places(arcs, floor, part, marks, stored) for part in parts]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for k, result in enumerate(pool.map(Places.results, groups)):
            found.append(result)
            if progress is not None:
                progress((k + 1) / len(groups))
    joined = (np.concatenate(part) for part in zip(*found, strict=True))
    return PlanView(plan, floor, tuple(plan.landmarks), marks, stored, *joined)


@dataclass(frozen=True)
class StartView:
    """Whether homing can begin at one place; errors and score as in `PlanView`."""

    plan: Plan
    place: tuple[float, float]
    """[m]"""
    position: float
    heading: float
    common: int
    score: float
    hidden: np.ndarray
    """(q,)"""

    @property
    def begins(self) -> bool:
        """Whether homing can begin."""
        return self.score <= 1

    @property
    def costly(self) -> tuple[str, ...]:
        """Landmarks without any one of which homing could not begin."""
        return tuple(n for n, s in zip(self.plan.landmarks, self.hidden, strict=True) if not s <= 1)


def analyse_start(plan: Plan, place: tuple[float, float]) -> StartView:
    """Analyse one place of a plan.

    Raises `InputError` as `make_floor`, and for a place outside the outline or in a shelf.
    """
    floor = make_floor(plan)
    check_place("--from", place, floor)
    marks = plan.marks
    places = Places(Arcs(plan), floor, np.array([place]), marks, home_sees(plan, floor, marks))
    position, heading, common, score, hidden = (values[0] for values in places.results())
    figures = float(position), float(heading), int(common), float(score)
    return StartView(plan, place, *figures, hidden)
