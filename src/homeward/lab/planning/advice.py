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
from dataclasses import fields
from itertools import repeat

import numpy as np

from homeward.lab.planning.accuracy import Arcs, Told, home_sees
from homeward.lab.planning.floor import Floor, candidate_places
from homeward.lab.planning.settings import Plan

CAP = 3.0
DECIMALS = 9
"""Costs that differ by less are the same."""
PLACES = 120
"""Costs are means over so many places of the floor, evenly chosen."""


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
    now, more = (_all_round(floor, arcs, marks, places) for marks in (plan.marks, candidates))
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
            now = _with(now, more, chosen[-1])
    return candidates[chosen], candidates


def _all_round(floor: Floor, arcs: Arcs, marks: np.ndarray, places: np.ndarray) -> Told:
    """Return what landmarks tell at m places, in each of H directions."""
    visible, stored = floor.sees(places, marks), home_sees(arcs.plan, floor, marks)
    told = [arcs.told(places, marks, visible, stored, h) for h in range(len(arcs.headings))]
    return Told(*(np.array([getattr(t, f.name) for t in told]) for f in fields(Told)))


def _with(now: Told, more: Told, c: int) -> Told:
    """Return what is told now, and by landmark `c` of more."""
    pairs = ((getattr(now, f.name), getattr(more, f.name)) for f in fields(Told))
    return Told(*(np.concatenate([a, b[:, :, c : c + 1]], axis=2) for a, b in pairs))


def _cost_with(arcs: Arcs, now: Told, more: Told, c: int) -> tuple[float, float]:
    return _cost(arcs, _with(now, more, c))


def _cost(arcs: Arcs, state: Told) -> tuple[float, float]:
    """Return the mean over places of the score with the worst landmark hidden, and with none."""
    every, count = state.every, state.count
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
