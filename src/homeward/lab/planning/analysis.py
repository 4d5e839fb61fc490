"""The whole answer to a plan: the map, what single landmarks are worth, and where to add more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.lab.planning.accuracy import Arcs, home_sees
from homeward.lab.planning.advice import best_places
from homeward.lab.planning.floor import Floor, make_floor
from homeward.lab.planning.places import Places, Progress, in_groups
from homeward.lab.planning.settings import Plan

CHUNK = 500
"""Places are worked on in groups of this size."""
SAMPLE = 1500
"""Pairs are hidden, and landmarks moved, at so many places, evenly chosen ..."""
PAIR_WORK = 2_000_000
"""... or at fewer, lest there are more cases than this; but at `FEWEST` at least."""
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
    """Return what can be known where on a plan.

    Raises
    ------
    InputError
        As `make_floor`.
    """
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
    return PlanView(
        plan=plan,
        floor=floor,
        names=tuple(plan.landmarks),
        marks=marks,
        stored=home_sees(plan, floor, marks),
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
