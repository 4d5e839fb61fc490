"""Analysis of a plan: the map, the value of each landmark, and the best places for more."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import repeat

import numpy as np

from homeward.lab.planning.accuracy import Arcs, Information, home_sees
from homeward.lab.planning.floor import Floor, candidate_places, make_floor
from homeward.lab.planning.settings import Plan

SLICE = 4000
"""Number of matrices inverted at once, which stay in the cache."""

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Places:
    """n places, and q landmarks in sight of them or not."""

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
        """(n, q), bool: a line of sight, found when first asked for, in a thread."""
        return self.floor.sees(self.places, self.marks)

    def singles(self) -> tuple[np.ndarray, ...]:
        """Return position, heading, common (n,), score (n,), and scores with one hidden (n, q)."""
        n, q = len(self.places), len(self.marks)
        position, heading = np.full(n, np.inf), np.full(n, np.inf)
        common, score, hidden = np.zeros(n, int), np.full(n, np.inf), np.full((n, q), np.inf)
        for h in range(len(self.arcs.headings)):
            told = self._told(h, self.stored)
            fix = self.arcs.fix(told.every)
            common = np.maximum(common, told.count)
            better = fix.position < position
            position = np.where(better, fix.position, position)
            heading = np.where(better, fix.heading, heading)
            score = np.minimum(score, self.arcs.score(fix, told.count))
            hidden = np.minimum(hidden, self._without(told, told.seen))
        return position, heading, common, score, hidden

    def pairs(self) -> tuple[np.ndarray, ...]:
        """Return scores with one moved (n, q), where homing can begin without pairs (n, q, q).

        And, (n,), where it can without any pair.
        """
        n, q = len(self.places), len(self.marks)
        best, moved = np.full((n, q, q), np.inf), np.full((n, q), np.inf)
        upper = np.triu(np.ones((q, q), bool), 1)
        for h in range(len(self.arcs.headings)):
            told = self._told(h, self.stored)
            one = self._without(told, told.seen)
            # With one of the two out of sight it is as with the other alone.
            out = np.maximum(one[:, :, None], one[:, None, :])
            place, i, j = np.nonzero(told.seen[:, :, None] & told.seen[:, None, :] & upper)
            out[place, i, j] = out[place, j, i] = self._scores(told, place, [i, j])
            best = np.minimum(best, out)
            # A moved landmark still gives information on the motion.
            still = self._told(h, np.zeros_like(self.stored)).each
            moved = np.minimum(moved, self._without(told, told.common, still))
        begins = np.asarray(best <= 1)
        return moved, begins, np.asarray(begins.reshape(n, -1).all(axis=1) & (q > 0))

    def _told(self, h: int, stored: np.ndarray) -> Information:
        return self.arcs.told(self.places, self.marks, self.visible, stored, h)

    def _without(
        self, told: Information, which: np.ndarray, still: np.ndarray | None = None
    ) -> np.ndarray:
        """Return scores (n, q) without each landmark where it is `which`, but for `still`."""
        now = self.arcs.score(self.arcs.fix(told.every), told.count)
        out = np.repeat(now[:, None], which.shape[1], axis=1)
        place, mark = np.nonzero(which)
        out[place, mark] = self._scores(told, place, [mark], still)
        return out

    def _scores(
        self,
        told: Information,
        place: np.ndarray,
        without: list[np.ndarray],
        still: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return scores at places (k,) without landmarks (k,), but with the information `still`."""
        scores = np.empty(place.size)
        for begin in range(0, place.size, SLICE):
            part = slice(begin, begin + SLICE)
            row = place[part]
            information, left = told.every[row], told.count[row]
            for mark in without:
                information -= told.each[row, mark[part]]
                left -= told.common[row, mark[part]]
                if still is not None:
                    information += still[row, mark[part]]
            scores[part] = self.arcs.score(self.arcs.fix(information), left)
        return scores


def in_groups(
    work: Callable[[Places], tuple[np.ndarray, ...]],
    size: int,
    arcs: Arcs,
    floor: Floor,
    places: np.ndarray,
    marks: np.ndarray,
    tell: Progress,
) -> list[np.ndarray]:
    """Work on places (n, 2) in groups of at most a size on all cores; return arrays of all."""
    stored, found = home_sees(arcs.plan, floor, marks), []
    parts = np.array_split(places, -(-len(places) // size))
    groups = [Places(arcs, floor, part, marks, stored) for part in parts]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for k, answer in enumerate(pool.map(work, groups)):
            found.append(answer)
            tell((k + 1) / len(groups))
    return [np.concatenate(part) for part in zip(*found, strict=True)]


CAP = 3.0
DECIMALS = 9
"""Costs that differ by less are the same."""
PLACES = 120
"""Number of places of the floor, evenly chosen, over which costs are means."""


def best_places(
    plan: Plan, floor: Floor, arcs: Arcs, tell: Callable[[float], None]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the places (k, 2) for further landmarks that greedy takes, and all candidates (c, 2).

    The places [m] are in the order of their use; fewer than asked for where no further one helps.
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


def _all_round(floor: Floor, arcs: Arcs, marks: np.ndarray, places: np.ndarray) -> Information:
    """Return the information from landmarks at m places, in each of H directions."""
    visible, stored = floor.sees(places, marks), home_sees(arcs.plan, floor, marks)
    told = [arcs.told(places, marks, visible, stored, h) for h in range(len(arcs.headings))]
    return Information(*(np.array([getattr(t, f.name) for t in told]) for f in fields(Information)))


def _with(now: Information, more: Information, c: int) -> Information:
    """Return the information now together with that of landmark `c` of more."""
    pairs = ((getattr(now, f.name), getattr(more, f.name)) for f in fields(Information))
    return Information(*(np.concatenate([a, b[:, :, c : c + 1]], axis=2) for a, b in pairs))


def _cost_with(arcs: Arcs, now: Information, more: Information, c: int) -> tuple[float, float]:
    return _cost(arcs, _with(now, more, c))


def _cost(arcs: Arcs, state: Information) -> tuple[float, float]:
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


CHUNK = 500
"""Places are worked on in groups of this size."""
SAMPLE = 1500
"""Number of places, evenly chosen, at which pairs are hidden and landmarks moved ..."""
PAIR_WORK = 2_000_000
"""... or fewer, so that there are not more cases than this; but at least `FEWEST`."""
FEWEST = 100


@dataclass(frozen=True)
class Advice:
    """Places for k further landmarks, in the order of their use; shares are of the sample."""

    places: np.ndarray
    """(k, 2) [m]"""
    candidates: np.ndarray
    """(c, 2), among which they were chosen [m]."""
    share: np.ndarray
    """(k + 1,), from which homing can begin, after none, one, two .. of them."""
    safe: np.ndarray
    """(k + 1,), from which it can begin whichever one landmark is hidden."""
    best_safe: float
    """`safe` with all candidates at once: no choice among them does better."""


@dataclass(frozen=True)
class PlanView:
    """What can be known where on a plan: n places on the floor, q landmarks.

    Scores are the larger of position's and heading's error at best, each as a share of its limit;
    infinite with fewer common landmarks than the limit asks for. Homing can begin where it is at
    most 1.
    """

    plan: Plan
    floor: Floor
    names: tuple[str, ...]
    marks: np.ndarray
    """(q, 2) [m]"""
    stored: np.ndarray
    """(q,), bool: which of them home sees."""
    position: np.ndarray
    """(n,), root mean square error of the position at best [m]; infinite where it is not told."""
    heading: np.ndarray
    """(n,), the same of the heading [rad]."""
    common: np.ndarray
    """(n,), how many landmarks are seen there and from home."""
    score: np.ndarray
    """(n,)"""
    hidden: np.ndarray
    """(n, q), the score when one landmark is hidden."""
    sample: np.ndarray
    """(m,), rows of the places that the following are of."""
    moved: np.ndarray
    """(m, q), the score when one landmark was moved since home was stored, and that is known."""
    pair_share: np.ndarray
    """(q, q), share of them from which homing can begin with both hidden; on the diagonal, one."""
    pair_safe: np.ndarray
    """(m,), bool: homing can begin there whichever two landmarks are hidden."""
    advice: Advice

    @property
    def begins(self) -> np.ndarray:
        """(n,), bool: where homing can begin."""
        return np.asarray(self.score <= 1)

    @property
    def safe(self) -> np.ndarray:
        """(n,), bool: where it can begin whichever one landmark is hidden."""
        worst = np.column_stack([self.score, self.hidden]).max(axis=1)
        return np.asarray(worst <= 1)


def analyse(plan: Plan, progress: Progress | None = None) -> PlanView:
    """Return what can be known where on a plan; errors as `make_floor`."""
    tell = progress or (lambda fraction: None)
    floor, arcs = make_floor(plan), Arcs(plan)
    places, marks = floor.points, plan.marks
    position, heading, common, score, hidden = in_groups(
        Places.singles, CHUNK, arcs, floor, places, marks, lambda f: tell(0.1 + 0.4 * f)
    )
    rows = _sample(arcs, common)
    moved, begins, safe = in_groups(
        Places.pairs, CHUNK // 10, arcs, floor, places[rows], marks, lambda f: tell(0.5 + 0.2 * f)
    )
    advice = _advise(plan, floor, arcs, rows, lambda f: tell(0.7 + 0.3 * f))
    known = plan, floor, tuple(plan.landmarks), marks, home_sees(plan, floor, marks)
    best = position, heading, common, score, hidden
    return PlanView(*known, *best, rows, moved, begins.mean(axis=0), safe, advice)


def _advise(plan: Plan, floor: Floor, arcs: Arcs, rows: np.ndarray, tell: Progress) -> Advice:
    """Choose further places, and say what each adds at some rows of the floor."""
    chosen, candidates = best_places(plan, floor, arcs, tell)
    sets = [np.vstack([plan.marks, chosen[:k]]) for k in range(len(chosen) + 1)]
    if len(chosen):
        sets.append(np.vstack([plan.marks, candidates]))
    figures = []
    for together in sets:
        sampled, quiet = floor.points[rows], lambda f: None
        *_, score, hidden = in_groups(
            Places.singles, CHUNK // 5, arcs, floor, sampled, together, quiet
        )
        worst = np.column_stack([score, hidden]).max(axis=1)
        figures.append(((score <= 1).mean(), (worst <= 1).mean()))
    share, safe = np.array(figures).T
    n = len(chosen) + 1
    return Advice(chosen, candidates, share[:n], safe[:n], float(safe[-1]))


def _sample(arcs: Arcs, common: np.ndarray) -> np.ndarray:
    """Return at which places pairs are hidden."""
    work = float((common.astype(float) ** 2).mean()) / 2 * len(arcs.headings)
    most = min(SAMPLE, max(FEWEST, int(PAIR_WORK / max(work, 1.0))))
    return np.unique(np.linspace(0, common.size - 1, min(common.size, most)).astype(int))
