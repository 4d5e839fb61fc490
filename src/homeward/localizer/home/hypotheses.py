"""Which home bearings are right: a search over sets, and what competes with the best one.

Sets come from poses made of triples of landmarks and, once there is a fit, from its neighbours. A
set climbs by single flips, each chosen by the odds of one bearing given the others, which are exact
for the linearised problem; pairs are tried too while q is small.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from homeward.angles import wrap
from homeward.frames import Pose, compose, inverse
from homeward.localizer.home.estimate import HomeFit
from homeward.localizer.home.gauss_newton import carried, fit, solved
from homeward.localizer.home.problem import HomeProblem
from homeward.localizer.home.resection import mixture_scores, poses_from_triples

Start = tuple[np.ndarray, np.ndarray]
"""A home, shape (3,), and a set of right home bearings, shape (q,), to climb from."""
STARTS = 8
"""Different sets that are climbed from."""
CLIMBS = 12
"""Flips at most from one start."""
PAIRS_UP_TO = 10
"""Pairs of landmarks are flipped together when home saw no more than this."""
PROMISING = 6.0
"""... and climbed from when their log evidence falls short of the best by no more than this."""
NEIGHBOURS = 3
"""So many sets that differ from the best one by the most doubtful flips are weighed with it."""
DOUBTFUL = 4.0
"""Only flips whose log odds are smaller are doubtful [1]."""
PROBABLE = 0.05
"""Only more probable sets are flipped further as the map changes."""
NEGLIGIBLE = 1e-3
"""A hypothesis less probable than this is dropped."""


@dataclass(frozen=True)
class Hypotheses:
    """Sets of right home bearings, the best first, with their posterior probabilities."""

    fits: tuple[HomeFit, ...]
    weights: np.ndarray
    """(k,), sum to one."""
    adrift: tuple[HomeFit, ...] = ()
    """Sets whose home wanders, as on the circle through its landmarks: what the fit says of them
    is of one place out of many."""

    @property
    def best(self) -> HomeFit:
        """The most probable."""
        return self.fits[0]

    def moved_probabilities(self) -> np.ndarray:
        """Return the probability that each home bearing is wrong, shape (q,)."""
        wrong = [1.0 / (1.0 + np.exp(np.clip(f.odds, -500, 500))) for f in self.fits]
        return np.asarray(self.weights @ np.array(wrong))

    @cached_property
    def unrest(self) -> float:
        """About how probable the sets are whose home wanders, the best one aside."""
        first, at_rest = self.best.evidence, 1.0 / float(self.weights[0])
        wanders = sum(math.exp(min(f.evidence - first, 500.0)) for f in self.adrift)
        return wanders / (wanders + at_rest)

    @cached_property
    def peak(self) -> float:
        """The log evidence of the most probable set, its home at rest or not."""
        return max(f.evidence for f in (*self.fits, *self.adrift))

    def rivals(self, deviations: float) -> float:
        """Return the probability of those that put home elsewhere than the best one does."""
        if len(self.fits) == 1:
            return 0.0
        best = self.best
        spread = np.linalg.inv(best.spread + 1e-12 * np.eye(3))
        total = 0.0
        for other, weight in zip(self.fits[1:], self.weights[1:], strict=True):
            d = other.home - best.home
            d[2] = wrap(d[2])
            if d @ spread @ d > deviations**2:
                total += float(weight)
        return total


def search(problem: HomeProblem, also: Sequence[Start] = ()) -> Hypotheses | None:
    """Return the most probable sets, or None when home cannot be fixed.

    Parameters
    ----------
    problem : HomeProblem
        What is known.
    also : sequence of tuples
        Homes and sets to climb from besides those that the problem itself suggests.
    """
    found: dict[bytes, HomeFit] = {}
    for home, right in [*also, *starts(problem)]:
        _climb(problem, home, right, found)
    if not found:
        return None
    if problem.bearings.size <= PAIRS_UP_TO:
        _flip_pairs(problem, max(found.values(), key=lambda f: f.evidence), found)
    return _weigh(problem, found)


def _flip_pairs(problem: HomeProblem, best: HomeFit, found: dict[bytes, HomeFit]) -> None:
    """Climb from the best set with two bearings flipped, where that looks promising from it."""
    for pair in combinations(range(problem.bearings.size), 2):
        right = best.right.copy()
        right[list(pair)] ^= True
        if right.sum() < problem.fewest or right.tobytes() in found:
            continue
        tried = solved(best.linear, right)
        if tried is not None and tried.evidence > best.evidence - PROMISING:
            _climb(problem, tried.home, right, found)


def follow(problem: HomeProblem, hypotheses: Hypotheses) -> Hypotheses | None:
    """Return the same sets, flipped where that is better, after the map has changed a little."""
    found: dict[bytes, HomeFit] = {}
    lead: HomeFit | None = None
    for wanders in hypotheses.adrift:
        again = fit(problem, wanders.home, wanders.right, steps=3)
        if again is not None:
            found[again.right.tobytes()] = again
    for hypothesis, weight in zip(hypotheses.fits, hypotheses.weights.tolist(), strict=True):
        again = _fit_beside(lead, problem, hypothesis.home, hypothesis.right)
        if again is None:
            continue
        lead = lead or again
        found[again.right.tobytes()] = again
        flip = _best_flip(problem, again) if weight > PROBABLE else None
        if flip is not None:
            _climb(problem, again.home, flip, found)
    return _weigh(problem, found) if found else None


def renamed(hypotheses: Hypotheses, names: Sequence[str], now: Sequence[str]) -> list[Start]:
    """Return hypotheses on landmarks `names` as starts for landmarks `now`, new ones left out."""
    starts = []
    for f in hypotheses.fits:
        right = dict(zip(names, f.right.tolist(), strict=True))
        starts.append((f.home, np.array([right.get(n, False) for n in now], bool)))
    return starts


def challenged(problem: HomeProblem, hypotheses: Hypotheses, start: Start) -> Hypotheses:
    """Return the sets with those among them that are climbed to from another home and set."""
    found = {f.right.tobytes(): f for f in (*hypotheses.adrift, *hypotheses.fits)}
    known = set(found)
    _climb(problem, *start, found)
    weighed = _weigh(problem, found)
    if known.issuperset(f.right.tobytes() for f in weighed.fits):
        return hypotheses
    return follow(problem, weighed) or hypotheses


def carry(problem: HomeProblem, hypotheses: Hypotheses) -> Hypotheses | None:
    """Return them after the map has changed by next to nothing: the best one is carried on alone.

    The others stay what they were when last followed, and as probable.
    """
    best = carried(hypotheses.best, problem)
    if best is None:
        return follow(problem, hypotheses)
    return Hypotheses((best, *hypotheses.fits[1:]), hypotheses.weights, hypotheses.adrift)


def posed(problem: HomeProblem, hypotheses: Hypotheses) -> Hypotheses | None:
    """Return them with the pose of another keyframe of the same map, home where it was.

    Parameters
    ----------
    problem : HomeProblem
        With the other pose in place of the newest one.
    hypotheses : Hypotheses
        As probable afterwards as before, since the pose says nothing of them.
    """
    fits = [carried(f, problem) for f in hypotheses.fits]
    there = tuple(f for f in fits if f is not None)
    return Hypotheses(there, hypotheses.weights) if len(there) == len(fits) else None


def starts(problem: HomeProblem) -> list[Start]:
    """Return where to climb from, the sets all different."""
    found: list[Start] = []
    if problem.prior is not None:
        found.append((problem.prior, np.ones(problem.bearings.size, bool)))
    if problem.bearings.size >= 3:
        found.extend(_from_triples(problem))
    unique = {right.tobytes(): (home, right) for home, right in reversed(found)}
    return list(unique.values())[::-1][: STARTS + 2]


def _from_triples(problem: HomeProblem) -> list[Start]:
    """Return the best poses of home made of triples, with the set that each one makes right."""
    points = problem.landmarks
    cameras = poses_from_triples(points, problem.bearings)
    if not len(cameras):
        return []
    q = len(points)
    marginals = problem.covariance[4:, 4:].reshape(q, 2, q, 2)[np.arange(q), :, np.arange(q)]
    scores, right = mixture_scores(
        cameras, points, marginals, problem.bearings, problem.sigmas, problem.moved_prior
    )
    found: dict[bytes, Start] = {}
    unmount = inverse(Pose(*problem.mount))
    for i in np.argsort(-scores)[: 6 * STARTS]:
        if right[i].sum() >= 3 and right[i].tobytes() not in found:
            home = np.array(compose(Pose(*cameras[i]), unmount))
            found[right[i].tobytes()] = (home, right[i])
        if len(found) == STARTS:
            break
    return list(found.values())


def _climb(
    problem: HomeProblem, home: np.ndarray, right: np.ndarray, found: dict[bytes, HomeFit]
) -> None:
    """Flip one bearing at a time while the evidence grows; keep every set met on the way."""
    best: HomeFit | None = None
    for _ in range(CLIMBS):
        known = found.get(right.tobytes())
        now = fit(problem, home, right) if known is None else known
        if now is None:
            return
        found[right.tobytes()] = now
        if known is not None or (best is not None and now.evidence <= best.evidence):
            return
        best = now
        flip = _best_flip(problem, now)
        if flip is None:
            return
        home, right = now.home, flip


def _best_flip(problem: HomeProblem, now: HomeFit) -> np.ndarray | None:
    """Return the set with the one flip that gains most, or None when none gains."""
    if not now.right.size:
        return None
    gain = np.where(now.right, -now.odds, now.odds)
    if now.right.sum() <= problem.fewest:
        gain[now.right] = -np.inf
    i = int(np.argmax(gain))
    if not gain[i] > 0.0:
        return None
    flipped = now.right.copy()
    flipped[i] ^= True
    return flipped


def _weigh(problem: HomeProblem, found: dict[bytes, HomeFit]) -> Hypotheses:
    """Return the fits and the best one's neighbours as hypotheses, without the negligible ones.

    What an iteration that has not come to rest says of its evidence is not comparable; but where
    it is greater all the same, the set is kept, for home may be anywhere along its way.
    """
    settled = {key: f for key, f in found.items() if f.settled} or found
    best = max(settled.values(), key=lambda f: f.evidence)
    fits = [*settled.values(), *_neighbours(problem, best, settled)]
    fits.sort(key=lambda f: -f.evidence)
    weights = np.exp(np.array([f.evidence for f in fits]) - fits[0].evidence)
    keep = weights > NEGLIGIBLE
    weights = weights[keep] / weights[keep].sum()
    at_rest = tuple(f for f, k in zip(fits, keep, strict=True) if k)
    least = best.evidence + math.log(NEGLIGIBLE)
    adrift = [f for f in found.values() if not f.settled and f.evidence > least]
    return Hypotheses(at_rest, weights, tuple(adrift) if best.settled else ())


def _neighbours(problem: HomeProblem, best: HomeFit, found: Container[bytes]) -> Iterator[HomeFit]:
    """Yield fits to sets that differ from the best one by a doubtful flip, and are not found."""
    for i in np.argsort(np.abs(best.odds))[:NEIGHBOURS]:
        right = best.right.copy()
        right[i] ^= True
        if abs(best.odds[i]) < DOUBTFUL and right.tobytes() not in found:
            tried = _fit_beside(best, problem, best.home, right)
            if tried is not None and tried.settled:
                yield tried


def _fit_beside(
    lead: HomeFit | None, problem: HomeProblem, home: np.ndarray, right: np.ndarray
) -> HomeFit | None:
    """Fit home from `home` (3,), with no new linearisation if it is where another fit has it."""
    if lead is not None and right.sum() >= problem.fewest:
        quick = solved(lead.linear, right, lead.doubt)
        if quick is not None and quick.settled and quick.is_beside(home):
            return quick
    return fit(problem, home, right, steps=3)
