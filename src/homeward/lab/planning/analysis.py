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

    def singles(self) -> tuple[np.ndarray, ...]:
        """Return position, heading, common (n,), score (n,), and scores with one hidden (n, q)."""
        n, q = len(self.places), len(self.marks)
        position, heading = np.full(n, np.inf), np.full(n, np.inf)
        common, score, hidden = np.zeros(n, int), np.full(n, np.inf), np.full((n, q), np.inf)
        for h in range(len(self.arcs.headings)):
            info = self._information(h, self.stored)
            fix = self.arcs.fix(info.every)
            common = np.maximum(common, info.count)
            better = fix.position < position
            position = np.where(better, fix.position, position)
            heading = np.where(better, fix.heading, heading)
            score = np.minimum(score, self.arcs.score(fix, info.count))
            hidden = np.minimum(hidden, self._without(info, info.seen))
        return position, heading, common, score, hidden

    def pairs(self) -> tuple[np.ndarray, ...]:
        """Return scores with one landmark moved (n, q), and where homing can begin without pairs.

        These are (n, q, q) for each pair of hidden landmarks, and (n,) for all pairs.
        """
        n, q = len(self.places), len(self.marks)
        best, moved = np.full((n, q, q), np.inf), np.full((n, q), np.inf)
        upper = np.triu(np.ones((q, q), bool), 1)
        for h in range(len(self.arcs.headings)):
            info = self._information(h, self.stored)
            one = self._without(info, info.seen)
            # If one of the two is not in view, only the other one counts.
            out = np.maximum(one[:, :, None], one[:, None, :])
            place, i, j = np.nonzero(info.seen[:, :, None] & info.seen[:, None, :] & upper)
            out[place, i, j] = out[place, j, i] = self._scores(info, place, [i, j])
            best = np.minimum(best, out)
            # A moved landmark still contributes information on the motion.
            still = self._information(h, np.zeros_like(self.stored)).each
            moved = np.minimum(moved, self._without(info, info.common, still))
        begins = np.asarray(best <= 1)
        return moved, begins, np.asarray(begins.reshape(n, -1).all(axis=1) & (q > 0))

    def _information(self, h: int, stored: np.ndarray) -> Information:
        return self.arcs.information(self.places, self.marks, self.visible, stored, h)

    def _without(
        self, info: Information, which: np.ndarray, still: np.ndarray | None = None
    ) -> np.ndarray:
        """Return scores (n, q) without each landmark in `which`, with the information `still`."""
        now = self.arcs.score(self.arcs.fix(info.every), info.count)
        out = np.repeat(now[:, None], which.shape[1], axis=1)
        place, mark = np.nonzero(which)
        out[place, mark] = self._scores(info, place, [mark], still)
        return out

    def _scores(
        self,
        info: Information,
        place: np.ndarray,
        without: list[np.ndarray],
        still: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return scores at places (k,) without landmarks (k,), with the information `still`."""
        scores = np.empty(place.size)
        for begin in range(0, place.size, SLICE):
            part = slice(begin, begin + SLICE)
            row = place[part]
            information, left = info.every[row], info.count[row]
            for mark in without:
                information -= info.each[row, mark[part]]
                left -= info.common[row, mark[part]]
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
    on_progress: Progress,
) -> list[np.ndarray]:
    """Apply `work` to groups of places (n, 2) on all cores; return the joined arrays."""
    stored, found = home_sees(arcs.plan, floor, marks), []
    parts = np.array_split(places, -(-len(places) // size))
    groups = [Places(arcs, floor, part, marks, stored) for part in parts]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for k, answer in enumerate(pool.map(work, groups)):
            found.append(answer)
            on_progress((k + 1) / len(groups))
    return [np.concatenate(part) for part in zip(*found, strict=True)]


CHUNK = 500
"""Number of places in a group."""
SAMPLE = 1500
"""Maximum number of evenly chosen places for hidden pairs and moved landmarks."""
PAIR_WORK = 2_000_000
"""Maximum number of hidden pairs at all places; `MIN_SAMPLE` places are used in any case."""
MIN_SAMPLE = 100


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
    sample: np.ndarray
    """(m,), rows of the places of the following arrays."""
    moved: np.ndarray
    """(m, q), the score with one landmark known to have moved since home was stored."""
    pair_share: np.ndarray
    """(q, q), share of the sample where homing can begin with both hidden (diagonal: one)."""
    pair_safe: np.ndarray
    """(m,), bool: homing can begin there with any two landmarks hidden."""

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
    on_progress = progress or (lambda fraction: None)
    floor, arcs = make_floor(plan), Arcs(plan)
    places, marks = floor.points, plan.marks
    position, heading, common, score, hidden = in_groups(
        Places.singles, CHUNK, arcs, floor, places, marks, lambda f: on_progress(0.1 + 0.6 * f)
    )
    rows = _sample(arcs, common)
    moved, begins, safe = in_groups(
        Places.pairs,
        CHUNK // 10,
        arcs,
        floor,
        places[rows],
        marks,
        lambda f: on_progress(0.7 + 0.3 * f),
    )
    known = plan, floor, tuple(plan.landmarks), marks, home_sees(plan, floor, marks)
    best = position, heading, common, score, hidden
    return PlanView(*known, *best, rows, moved, begins.mean(axis=0), safe)


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
    position, heading, common, score, hidden = (values[0] for values in places.singles())
    figures = float(position), float(heading), int(common), float(score)
    return StartView(plan, place, *figures, hidden)


def _sample(arcs: Arcs, common: np.ndarray) -> np.ndarray:
    """Return the places for hidden pairs."""
    work = float((common.astype(float) ** 2).mean()) / 2 * len(arcs.headings)
    number = min(SAMPLE, max(MIN_SAMPLE, int(PAIR_WORK / max(work, 1.0))))
    return np.unique(np.linspace(0, common.size - 1, min(common.size, number)).astype(int))
