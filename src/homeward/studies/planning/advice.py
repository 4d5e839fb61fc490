"""The best places for further landmarks, one after the other, for the worst case.

The cost of a set of landmarks is the mean over the floor of the score with the worst one of them
hidden, cut off at `CAP`, where too few are in common plus how many are missing. More landmarks
never raise it, since information only grows. Greedy takes the place that lowers it the most. That
is the best for one landmark; for more there is no guarantee: a worst case is not submodular, and
neither is a fix, of which the third landmark is worth more than the second. What does hold is the
other side: no choice of any number of places can do better than all candidates at once.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat

import numpy as np

from homeward.studies.planning.accuracy import Arcs, lines_of_sight
from homeward.studies.planning.floor import Floor, candidate_places
from homeward.studies.planning.settings import Plan

CAP = 3.0
PLACES = 120
"""Costs are means over so many places of the floor, evenly chosen."""


@dataclass(frozen=True)
class Advice:
    """Places for k further landmarks, in the order of their use; shares are of m sample places."""

    places: np.ndarray
    """(k, 2) [m]"""
    candidates: np.ndarray
    """(c, 2), among which they were chosen [m]."""
    share: np.ndarray
    """(k + 1,), from which homing can begin, after none, one, two .. of them."""
    safe: np.ndarray
    """(k + 1,), from which it can begin whichever one landmark is hidden."""
    cost: np.ndarray
    """(k + 1,), what greedy lowers."""
    best_safe: float
    """`safe` with all candidates at once: nothing among them can do better."""


@dataclass(frozen=True)
class _State:
    """The landmarks so far at m places, in each of H directions."""

    each: np.ndarray
    """(H, m, q, d (d + 1) / 2)"""
    seen: np.ndarray
    """(H, m, q), bool"""
    common: np.ndarray
    """(H, m, q), bool: and seen from home."""

    def with_more(self, other: _State, which: slice) -> _State:
        """Return it with some landmarks of another."""
        pairs = ((getattr(self, n), getattr(other, n)) for n in ("each", "seen", "common"))
        return _State(*(np.concatenate([a, b[:, :, which]], axis=2) for a, b in pairs))


def advise(
    plan: Plan, floor: Floor, arcs: Arcs, progress: Callable[[float], None] | None = None
) -> Advice:
    """Return the best places for the plan's number of further landmarks, greedily."""
    tell = progress or (lambda fraction: None)
    points = floor.points
    places = points[np.unique(np.linspace(0, len(points) - 1, PLACES).astype(int))]
    marks = np.array(list(plan.landmarks.values()), float).reshape(-1, 2)
    candidates = candidate_places(plan, floor) if plan.further else np.zeros((0, 2))
    now = _state(plan, floor, arcs, marks, places)
    more = _state(plan, floor, arcs, candidates, places)
    figures = [_figures(arcs, now)]
    best_safe = _figures(arcs, now.with_more(more, slice(None)))[2]
    free = list(range(len(candidates)))
    chosen: list[int] = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        while free and len(chosen) < plan.further:
            tell(len(chosen) / plan.further)
            sets = [now.with_more(more, slice(c, c + 1)) for c in free]
            tried = list(pool.map(_figures, repeat(arcs), sets))
            k = min(range(len(free)), key=lambda i: tried[i][0])
            if not tried[k][0] < figures[-1][0] - 1e-12:
                break
            now = sets[k]
            figures.append(tried[k])
            chosen.append(free.pop(k))
    cost, share, safe = np.array(figures).T
    return Advice(candidates[chosen], candidates, share, safe, cost, best_safe)


def _state(plan: Plan, floor: Floor, arcs: Arcs, marks: np.ndarray, places: np.ndarray) -> _State:
    visible, stored = lines_of_sight(plan, floor, marks, places)
    told = [arcs.informations(places, marks, visible, stored, h) for h in range(len(arcs.headings))]
    seen = np.array([s for _, s in told])
    return _State(np.array([each for each, _ in told]), seen, seen & stored)


def _figures(arcs: Arcs, state: _State) -> tuple[float, float, float]:
    """Return cost, share and safe share of a set of landmarks."""
    every, count = state.each.sum(axis=2), state.common.sum(axis=2)
    H, m, q = state.seen.shape
    none = _score(arcs, every.reshape(H * m, -1), count.reshape(-1)).reshape(H, m)
    hidden = np.repeat(none[:, :, None], q + 1, axis=2)
    h, place, mark = np.nonzero(state.seen)
    left = every[h, place] - state.each[h, place, mark]
    hidden[h, place, mark] = _score(arcs, left, count[h, place] - state.common[h, place, mark])
    # The robot takes the best direction; chance hides the worst landmark.
    worst = hidden.min(axis=0).max(axis=1)
    return float(worst.mean()), _share(none.min(axis=0)), _share(worst)


def _score(arcs: Arcs, information: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return scores cut off at `CAP`, beyond it by how many landmarks are missing."""
    score = np.minimum(arcs.score(arcs.fix(information), count), CAP)
    return np.asarray(score + np.maximum(arcs.plan.limits.landmarks - count, 0))


def _share(scores: np.ndarray) -> float:
    return float((scores <= 1).mean())
