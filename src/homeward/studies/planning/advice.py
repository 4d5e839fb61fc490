"""The best places for further landmarks, one after the other, for the worst case.

The cost of a set of landmarks is the mean over the floor of the score with the worst one of them
hidden, cut off at `CAP`, where too few are in common plus how many are missing. More landmarks
never raise it, since information only grows. Greedy takes the place that lowers it the most; where
none does, the same cost with nothing hidden. That is the best for one landmark; for more there is
no guarantee: a worst case is not submodular, and neither is a fix, of which the third landmark is
worth more than the second. What does hold is the other side: no choice of any number of places can
do better than all candidates at once.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat

import numpy as np

from homeward.studies.planning.accuracy import Arcs, home_sees
from homeward.studies.planning.floor import Floor, candidate_places
from homeward.studies.planning.settings import Plan

CAP = 3.0
DECIMALS = 9
"""Costs that differ by less are the same."""
PLACES = 120
"""Costs are means over so many places of the floor, evenly chosen."""


@dataclass(frozen=True)
class _State:
    """The landmarks so far at m places, in each of H directions."""

    each: np.ndarray
    """(H, m, q, d (d + 1) / 2)"""
    seen: np.ndarray
    """(H, m, q), bool"""
    common: np.ndarray
    """(H, m, q), bool: and seen from home."""

    def with_more(self, other: _State, c: int) -> _State:
        """Return it with landmark `c` of another."""
        pairs = ((getattr(self, n), getattr(other, n)) for n in ("each", "seen", "common"))
        return _State(*(np.concatenate([a, b[:, :, c : c + 1]], axis=2) for a, b in pairs))


def best_places(
    plan: Plan, floor: Floor, arcs: Arcs, tell: Callable[[float], None]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the places for the plan's number of further landmarks that greedy takes.

    Returns
    -------
    chosen : ndarray, shape (k, 2)
        In that order [m]; fewer than asked for where no further one helps.
    candidates : ndarray, shape (c, 2)
        Among which [m].
    """
    points = floor.points
    places = points[np.unique(np.linspace(0, len(points) - 1, PLACES).astype(int))]
    candidates = candidate_places(plan, floor) if plan.further else np.zeros((0, 2))
    now = _state(plan, floor, arcs, plan.marks, places)
    more = _state(plan, floor, arcs, candidates, places)
    cost = _cost(arcs, now)
    free, chosen = list(range(len(candidates))), list[int]()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        while free and len(chosen) < plan.further:
            tell(len(chosen) / plan.further)
            costs = list(pool.map(_cost_with, repeat(arcs), repeat(now), repeat(more), free))
            k = min(range(len(free)), key=costs.__getitem__)
            if not costs[k] < cost:
                break
            cost = costs[k]
            chosen.append(free.pop(k))
            now = now.with_more(more, chosen[-1])
    return candidates[chosen], candidates


def _state(plan: Plan, floor: Floor, arcs: Arcs, marks: np.ndarray, places: np.ndarray) -> _State:
    visible, stored = floor.sees(places, marks), home_sees(plan, floor, marks)
    told = [arcs.informations(places, marks, visible, stored, h) for h in range(len(arcs.headings))]
    seen = np.array([s for _, s in told])
    return _State(np.array([each for each, _ in told]), seen, seen & stored)


def _cost_with(arcs: Arcs, now: _State, more: _State, c: int) -> tuple[float, float]:
    return _cost(arcs, now.with_more(more, c))


def _cost(arcs: Arcs, state: _State) -> tuple[float, float]:
    """Return the mean over places of the score with the worst landmark hidden, and with none."""
    every, count = state.each.sum(axis=2), state.common.sum(axis=2)
    H, m, q = state.seen.shape
    none = _score(arcs, every.reshape(H * m, -1), count.reshape(-1)).reshape(H, m)
    hidden = np.repeat(none[:, :, None], q + 1, axis=2)
    h, place, mark = np.nonzero(state.seen)
    left = every[h, place] - state.each[h, place, mark]
    hidden[h, place, mark] = _score(arcs, left, count[h, place] - state.common[h, place, mark])
    # The robot takes the best direction; chance hides the worst landmark.
    costs = hidden.min(axis=0).max(axis=1).mean(), none.min(axis=0).mean()
    return round(float(costs[0]), DECIMALS), round(float(costs[1]), DECIMALS)


def _score(arcs: Arcs, information: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return scores cut off at `CAP`, beyond it by how many landmarks are missing."""
    score = np.minimum(arcs.score(arcs.fix(information), count), CAP)
    return np.asarray(score + np.maximum(arcs.plan.limits.landmarks - count, 0))
