"""Groups of places on a floor, and what hiding landmarks does at each."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from homeward.studies.planning.accuracy import Arcs
from homeward.studies.planning.floor import Floor

SLICE = 4000
"""Matrices are inverted so many at once, which stay in the cache."""

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


def group(
    arcs: Arcs, floor: Floor, places: np.ndarray, marks: np.ndarray, stored: np.ndarray, size: int
) -> list[Places]:
    """Return places in groups of at most a size, in order."""
    parts = np.array_split(places, -(-len(places) // size))
    return [Places(arcs, floor, part, marks, stored) for part in parts]


def in_threads(
    work: Callable[[Places], tuple[np.ndarray, ...]], groups: list[Places], tell: Progress
) -> Iterable[tuple[np.ndarray, ...]]:
    """Work on groups on all cores, and yield in order."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for k, answer in enumerate(pool.map(work, groups)):
            yield answer
            tell((k + 1) / len(groups))
