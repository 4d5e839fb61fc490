"""Groups of places on a floor, and what hiding landmarks does at each."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from homeward.lab.planning.accuracy import Arcs, Told, home_sees
from homeward.lab.planning.floor import Floor

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
            # One that was moved still tells how the robot drove.
            still = self._told(h, np.zeros_like(self.stored)).each
            moved = np.minimum(moved, self._without(told, told.common, still))
        begins = np.asarray(best <= 1)
        return moved, begins, np.asarray(begins.reshape(n, -1).all(axis=1) & (q > 0))

    def _told(self, h: int, stored: np.ndarray) -> Told:
        return self.arcs.told(self.places, self.marks, self.visible, stored, h)

    def _without(
        self, told: Told, which: np.ndarray, still: np.ndarray | None = None
    ) -> np.ndarray:
        """Return scores (n, q) without each landmark where it is `which`, but for `still`."""
        now = self.arcs.score(self.arcs.fix(told.every), told.count)
        out = np.repeat(now[:, None], which.shape[1], axis=1)
        place, mark = np.nonzero(which)
        out[place, mark] = self._scores(told, place, [mark], still)
        return out

    def _scores(
        self,
        told: Told,
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
