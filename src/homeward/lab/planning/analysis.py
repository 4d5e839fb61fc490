"""Analysis of a plan: accuracy at places of its floor, and what hiding landmarks costs."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np

from homeward.lab.planning.accuracy import Arcs, Information, home_sees
from homeward.lab.planning.floor import Floor, check_place, make_floor
from homeward.lab.planning.settings import Plan

CHUNK = 500
"""Number of places in a group."""
SLICE = 4000
"""Number of matrices inverted at once, so that they stay in the cache."""

Progress = Callable[[float], None]


@dataclass(frozen=True)
class PlanView:
    """Accuracy at n places of a floor with q landmarks.

    A score is the larger of the minimum errors of position and heading, each relative to its limit;
    infinite with fewer common landmarks than the limit. Homing can begin where it is at most 1.
    """

    plan: Plan
    floor: Floor
    places: np.ndarray
    """(n, 2), the free points of the floor, or one place [m]."""
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
    def names(self) -> tuple[str, ...]:
        """(q,), ids of the landmarks."""
        return tuple(self.plan.landmarks)

    @property
    def begins(self) -> np.ndarray:
        """(n,), bool: where homing can begin."""
        return np.asarray(self.score <= 1)

    @property
    def safe(self) -> np.ndarray:
        """(n,), bool: where homing can begin with any one landmark hidden."""
        worst = np.column_stack([self.score, self.hidden]).max(axis=1)
        return np.asarray(worst <= 1)

    @property
    def needed(self) -> tuple[str, ...]:
        """Landmarks without any one of which homing can begin at none of the places."""
        best = self.hidden.min(axis=0)
        return tuple(n for n, score in zip(self.names, best, strict=True) if not score <= 1)


def analyse(
    plan: Plan, progress: Progress | None = None, place: tuple[float, float] | None = None
) -> PlanView:
    """Analyse a plan at all free points of its grid, or at one place [m].

    Raises `InputError` as `make_floor`, and for a place outside the outline or in a shelf.
    """
    floor, arcs, marks = make_floor(plan), Arcs(plan), plan.marks
    if place is not None:
        check_place("--from", place, floor)
    places = floor.points if place is None else np.array([place])
    stored, found = home_sees(plan, floor, marks), []
    groups = np.array_split(places, -(-len(places) // CHUNK))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for k, result in enumerate(pool.map(partial(_at, arcs, floor, marks, stored), groups)):
            found.append(result)
            if progress is not None:
                progress((k + 1) / len(groups))
    joined = (np.concatenate(part) for part in zip(*found, strict=True))
    return PlanView(plan, floor, places, marks, stored, *joined)


def _at(
    arcs: Arcs, floor: Floor, marks: np.ndarray, stored: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Return position, heading, common (n,), score (n,), and scores with one hidden (n, q)."""
    n, visible = len(places), floor.sees(places, marks)
    position, heading = np.full(n, np.inf), np.full(n, np.inf)
    common, score, hidden = np.zeros(n, int), np.full(n, np.inf), np.full((n, len(marks)), np.inf)
    for h in range(len(arcs.headings)):
        info = arcs.information(places, marks, visible, stored, h)
        every, count = info.each.sum(axis=1), info.common.sum(axis=1)
        found = arcs.errors(every)
        common = np.maximum(common, count)
        better = found[0] < position
        position, heading = np.where(better, found, (position, heading))
        here = arcs.score(*found, count)
        score = np.minimum(score, here)
        hidden = np.minimum(hidden, _without_each(arcs, info, every, count, here))
    return position, heading, common, score, hidden


def _without_each(
    arcs: Arcs, info: Information, every: np.ndarray, count: np.ndarray, score: np.ndarray
) -> np.ndarray:
    """Return scores (n, q) without each landmark, given the sums and the score of all (n,)."""
    out = np.repeat(score[:, None], info.seen.shape[1], axis=1)
    place, mark = np.nonzero(info.seen)
    for begin in range(0, place.size, SLICE):
        row, hidden = place[begin : begin + SLICE], mark[begin : begin + SLICE]
        errors = arcs.errors(every[row] - info.each[row, hidden])
        out[row, hidden] = arcs.score(*errors, count[row] - info.common[row, hidden])
    return out
