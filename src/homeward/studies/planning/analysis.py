"""The whole answer to a plan: the map, what single landmarks are worth, and where to add more."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from homeward.studies.planning.accuracy import Arcs, home_sees
from homeward.studies.planning.advice import best_places
from homeward.studies.planning.floor import Floor, make_floor
from homeward.studies.planning.settings import Plan

CHUNK = 500
"""Places are worked on in groups of this size."""
SLICE = 4000
"""Matrices are inverted so many at once, which stay in the cache."""
SAMPLE = 1500
"""Pairs are hidden, and landmarks moved, at so many places, evenly chosen ..."""
PAIR_WORK = 2_000_000
"""... or at fewer, lest there are more cases than this; but at `FEWEST` at least."""
FEWEST = 100

Progress = Callable[[float], None]


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
    """Return what can be known where on a plan.

    Parameters
    ----------
    plan : Plan
        As from `load_plan`.
    progress : callable, optional
        Told the fraction done, in [0, 1].

    Raises
    ------
    InputError
        As `make_floor`.
    """
    tell = progress or (lambda fraction: None)
    floor, arcs = make_floor(plan), Arcs(plan)
    places = floor.points
    marks = np.array(list(plan.landmarks.values()), float).reshape(-1, 2)
    stored = home_sees(plan, floor, marks)
    scenes = _scenes(arcs, floor, places, marks, stored, CHUNK)
    parts = list(_in_threads(_Scenes.singles, scenes, lambda f: tell(0.1 + 0.4 * f)))
    position, heading, common, score, hidden = (
        np.concatenate(part) for part in zip(*parts, strict=True)
    )
    rows = _sample(arcs, common)
    of_pairs = _scenes(arcs, floor, places[rows], marks, stored, CHUNK // 10)
    found = list(_in_threads(_Scenes.pairs, of_pairs, lambda f: tell(0.5 + 0.2 * f)))
    moved, begins, safe = (np.concatenate(part) for part in zip(*found, strict=True))
    advice = _advise(plan, floor, arcs, rows, lambda f: tell(0.7 + 0.3 * f))
    return PlanView(
        plan=plan,
        floor=floor,
        names=tuple(plan.landmarks),
        marks=marks,
        stored=stored,
        position=position,
        heading=heading,
        common=common,
        score=score,
        hidden=hidden,
        sample=rows,
        moved=moved,
        pair_share=begins.mean(axis=0),
        pair_safe=safe,
        advice=advice,
    )


@dataclass(frozen=True)
class _Scenes:
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
            told = self._told(h)
            fix = self.arcs.fix(told.every)
            common = np.maximum(common, told.count)
            better = fix.position < position
            position = np.where(better, fix.position, position)
            heading = np.where(better, fix.heading, heading)
            score = np.minimum(score, self.arcs.score(fix, told.count))
            hidden = np.minimum(hidden, self._hidden(told))
        return position, heading, common, score, hidden

    def pairs(self) -> tuple[np.ndarray, ...]:
        """Return scores with one moved (n, q), where homing can begin without pairs (n, q, q).

        And, (n,), where it can without any pair.
        """
        n, q = len(self.places), len(self.marks)
        best, moved = np.full((n, q, q), np.inf), np.full((n, q), np.inf)
        upper = np.triu(np.ones((q, q), bool), 1)
        for h in range(len(self.arcs.headings)):
            told = self._told(h)
            one = self._hidden(told)
            # With one of the two out of sight it is as with the other alone.
            out = np.maximum(one[:, :, None], one[:, None, :])
            place, i, j = np.nonzero(told.seen[:, :, None] & told.seen[:, None, :] & upper)
            out[place, i, j] = out[place, j, i] = self._scores(told, place, [i, j])
            best = np.minimum(best, out)
            moved = np.minimum(moved, self._moved(told, h))
        begins = np.asarray(best <= 1)
        return moved, begins, np.asarray(begins.reshape(n, -1).all(axis=1) & (q > 0))

    def _told(self, h: int) -> _Told:
        each, seen = self.arcs.informations(self.places, self.marks, self.visible, self.stored, h)
        common = seen & self.stored
        return _Told(each, seen, common, each.sum(axis=1), common.sum(axis=1))

    def _hidden(self, told: _Told) -> np.ndarray:
        """Return scores with each landmark hidden, (n, q)."""
        now = self.arcs.score(self.arcs.fix(told.every), told.count)
        out = np.repeat(now[:, None], told.seen.shape[1], axis=1)
        place, mark = np.nonzero(told.seen)
        out[place, mark] = self._scores(told, place, [mark])
        return out

    def _moved(self, told: _Told, h: int) -> np.ndarray:
        """Return scores with each landmark moved, (n, q): it still tells how the robot drove."""
        now = self.arcs.score(self.arcs.fix(told.every), told.count)
        out = np.repeat(now[:, None], told.seen.shape[1], axis=1)
        place, mark = np.nonzero(told.common)
        nowhere = np.zeros_like(self.stored)
        still, _ = self.arcs.informations(self.places, self.marks, self.visible, nowhere, h)
        out[place, mark] = self._scores(told, place, [mark], still)
        return out

    def _scores(
        self,
        told: _Told,
        place: np.ndarray,
        without: list[np.ndarray],
        still: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return scores at places (k,) without landmarks (k,), but for what they `still` tell."""
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


@dataclass(frozen=True)
class _Told:
    """What q landmarks tell at n places, in one direction."""

    each: np.ndarray
    """(n, q, d (d + 1) / 2)"""
    seen: np.ndarray
    """(n, q), bool"""
    common: np.ndarray
    """(n, q), bool: and seen from home."""
    every: np.ndarray
    """(n, d (d + 1) / 2), all together."""
    count: np.ndarray
    """(n,), of `common`."""


def _scenes(
    arcs: Arcs, floor: Floor, places: np.ndarray, marks: np.ndarray, stored: np.ndarray, size: int
) -> list[_Scenes]:
    """Return places in groups of at most a size, in order."""
    parts = np.array_split(places, -(-len(places) // size))
    return [_Scenes(arcs, floor, part, marks, stored) for part in parts]


def _advise(plan: Plan, floor: Floor, arcs: Arcs, rows: np.ndarray, tell: Progress) -> Advice:
    """Choose further places, and say what each adds at some rows of the floor."""
    chosen, candidates = best_places(plan, floor, arcs, tell)
    marks = np.array(list(plan.landmarks.values()), float).reshape(-1, 2)
    sets = [np.vstack([marks, chosen[:k]]) for k in range(len(chosen) + 1)]
    if len(chosen):
        sets.append(np.vstack([marks, candidates]))
    figures = []
    for together in sets:
        stored = home_sees(plan, floor, together)
        scenes = _scenes(arcs, floor, floor.points[rows], together, stored, CHUNK // 5)
        parts = list(_in_threads(_Scenes.singles, scenes, lambda f: None))
        score, hidden = (np.concatenate([p[i] for p in parts]) for i in (3, 4))
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


def _in_threads(
    work: Callable[[_Scenes], tuple[np.ndarray, ...]], scenes: list[_Scenes], tell: Progress
) -> Iterable[tuple[np.ndarray, ...]]:
    """Work on scenes on all cores, and yield in order."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for k, answer in enumerate(pool.map(work, scenes)):
            yield answer
            tell((k + 1) / len(scenes))
