"""Multiple-hypothesis outlier rejection: local search over sets of inlier home bearings.

Seeds come from poses by triples of landmarks, later from the current hypotheses. A set is improved
by single flips, chosen by the odds of one bearing given the others, which are exact for the
linearised problem.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.se2 import between, compose, difference
from homeward.localizer.home.estimate import HomeFit, fit, propagated, solved
from homeward.localizer.home.problem import USUAL, Assumption, HomeProblem
from homeward.localizer.reference.sets import POSE_AND_YAW
from homeward.localizer.resection import SightLines, mixture_scores, poses_from_triples
from homeward.localizer.tunables import (
    IMPROBABLE,
    INLIER,
    MAX_FLIPS,
    MAX_SEEDS,
    MINIMAL,
    NUM_NEIGHBOURS,
    PROBABLE,
    SAME_BEARINGS,
    UNDECIDED,
)

Seed = tuple[np.ndarray, np.ndarray, Assumption]
"""Start of a search: a home, shape (3,), a set of inlier home bearings, shape (q,), and the
assumption."""
Key = tuple[Assumption, bytes]
"""Key of a fit: assumption and set."""


@dataclass(frozen=True)
class Hypotheses:
    """Sets of inlier home bearings, the best first, with posterior probabilities."""

    fits: tuple[HomeFit, ...]
    weights: np.ndarray
    """(k,): posterior probabilities; they sum to one."""
    unconverged: tuple[HomeFit, ...] = ()
    """Sets whose fit does not converge, as on the circle through the landmarks: their evidence is
    that of one place out of many."""

    @property
    def best(self) -> HomeFit:
        """The most probable one."""
        return self.fits[0]

    def moved_probabilities(self) -> np.ndarray:
        """Return the probability of each home bearing to be an outlier, shape (q,)."""
        wrong = [1.0 / (1.0 + np.exp(np.clip(f.odds, -500, 500))) for f in self.fits]
        apart = np.array([f.problem.is_exchanged for f in self.fits])
        return np.asarray(self.weights @ np.where(apart, 1.0, np.array(wrong)))

    def exchanged(self, sure: float) -> dict[str, str]:
        """Return two landmarks, each with the other, that are exchanged with probability `sure`."""
        pair = self.best.problem.assumed.exchanged
        same = [f.problem.assumed.exchanged == pair for f in self.fits]
        if pair is None or self.weights @ same < sure:
            return {}
        return dict([pair, pair[::-1]])

    @cached_property
    def unconverged_probability(self) -> float:
        """Approximate probability of the unconverged sets, the best one aside."""
        first, converged = self.best.log_evidence, 1.0 / float(self.weights[0])
        unconverged = sum(math.exp(min(f.log_evidence - first, 500.0)) for f in self.unconverged)
        return unconverged / (unconverged + converged)

    @cached_property
    def max_log_evidence(self) -> float:
        """Log evidence of the most probable set, converged or not."""
        return max(f.log_evidence for f in (*self.fits, *self.unconverged))

    def rivals(self, deviations: float) -> float:
        """Return the probability of hypotheses with home elsewhere than the best one.

        A home from which all bearings are the same, but for noise, is not elsewhere: the covariance
        of the mixture contains both.
        """
        if len(self.fits) == 1:
            return 0.0
        best = self.best
        off = difference(np.array([f.home for f in self.fits]), best.home)
        # By the smaller noise of both: the larger would hide that the other home is more precise.
        scale = best.problem.assumed.noise_scale
        finest = [f if f.problem.assumed.noise_scale < scale else best for f in self.fits]
        covariances = np.array([f.covariance for f in finest]) + 1e-12 * np.eye(3)
        apart = (off * np.linalg.solve(covariances, off[:, :, None])[:, :, 0]).sum(axis=1)
        reach = best.home_distance
        away = np.maximum(np.hypot(off[:, 0], off[:, 1]) / reach, np.abs(off[:, 2]))
        return float(self.weights @ ((apart > deviations**2) & (away > SAME_BEARINGS)))


def search(problem: HomeProblem, also: Sequence[Seed] = ()) -> Hypotheses | None:
    """Return the most probable sets, or None when home cannot be determined.

    `also` are seeds in addition to those of the problem itself.
    """
    found: dict[Key, HomeFit] = {}
    for home, inliers, assumed in [*also, *seeds(problem)]:
        _local_search(problem.under(assumed), home, inliers, found)
    if not found:
        return None
    _exchange(found)
    return _weigh(found)


def _exchange(found: dict[Key, HomeFit]) -> None:
    """Search from the best set with two bearings exchanged, where one was wrong and both then fit.

    Those that fit best are tried.
    """
    best = max(found.values(), key=lambda f: f.log_evidence)
    problem, inliers = best.problem, best.inliers
    if inliers.all() or problem.assumed.exchanged or not problem.names:
        return
    innovation, variance = best.innovations
    off = wrap(innovation[:, None] + problem.bearings - problem.bearings[:, None])
    square = off**2 / variance[:, None]
    fits = np.triu((square < INLIER**2) & ~(inliers & inliers[:, None]), 1) & (square.T < INLIER**2)
    pairs = np.argwhere(fits)
    order = np.argsort((square + square.T)[fits])[:NUM_NEIGHBOURS]
    for i, j in pairs[order].tolist():
        assumed = problem.assumed._replace(exchanged=(problem.names[i], problem.names[j]))
        chosen = inliers.copy()
        chosen[[i, j]] = True
        _local_search(problem.under(assumed), best.home, chosen, found)


def update(problem: HomeProblem, hypotheses: Hypotheses) -> Hypotheses | None:
    """Update the hypotheses after a small change of the map; flip where that is better."""
    found: dict[Key, HomeFit] = {}
    leads: dict[Assumption, HomeFit] = {}
    for unconverged in hypotheses.unconverged:
        under = problem.under(unconverged.problem.assumed)
        again = fit(under, unconverged.home, unconverged.inliers, steps=3)
        if again is not None:
            found[again.key] = again
    for hypothesis, weight in zip(hypotheses.fits, hypotheses.weights.tolist(), strict=True):
        assumed = hypothesis.problem.assumed
        lead = leads.get(assumed)
        under = problem.under(assumed) if lead is None else lead.problem
        again = _fit_nearby(lead, under, hypothesis.home, hypothesis.inliers)
        if again is None:
            continue
        leads.setdefault(assumed, again)
        found[again.key] = again
        flip = _best_flip(under, again) if weight > PROBABLE else None
        if flip is not None:
            _local_search(under, again.home, flip, found)
    if not found:
        return None
    _exchange(found)
    return _weigh(found)


def seeds_for(hypotheses: Hypotheses, names: Sequence[str], now: Sequence[str]) -> list[Seed]:
    """Return hypotheses on landmarks `names` as seeds for landmarks `now`, new ones left out."""
    seeds = []
    for f in hypotheses.fits:
        inliers = dict(zip(names, f.inliers.tolist(), strict=True))
        chosen = np.array([inliers.get(n, False) for n in now], bool)
        assumed = f.problem.assumed
        if not {*(assumed.exchanged or ())} <= {*now}:
            assumed = assumed._replace(exchanged=None)
        seeds.append((f.home, chosen, assumed))
    return seeds


def try_seed(problem: HomeProblem, hypotheses: Hypotheses, seed: Seed) -> Hypotheses:
    """Try a seed: return the hypotheses, with those that a local search from it finds."""
    found = {f.key: f for f in (*hypotheses.unconverged, *hypotheses.fits)}
    known, (home, inliers, assumed) = set(found), seed
    _local_search(problem.under(assumed), home, inliers, found)
    if known.issuperset(found):
        return hypotheses
    weighed = _weigh(found)
    if known.issuperset(f.key for f in weighed.fits):
        return hypotheses
    return update(problem, weighed) or hypotheses


def propagate(problem: HomeProblem, hypotheses: Hypotheses) -> Hypotheses | None:
    """Propagate the best hypothesis alone, after a negligible change of the map.

    The others keep their fit and probability. None where the best one must be fitted again.
    """
    best = propagated(hypotheses.best, problem)
    if best is None:
        return None
    return Hypotheses((best, *hypotheses.fits[1:]), hypotheses.weights, hypotheses.unconverged)


def with_pose(problem: HomeProblem, hypotheses: Hypotheses) -> Hypotheses | None:
    """Return the hypotheses with the pose of another keyframe of the same map.

    The problem has that pose in place of the newest one; probabilities do not change.
    """
    fits = [propagated(f, problem) for f in hypotheses.fits]
    kept = tuple(f for f in fits if f is not None)
    return Hypotheses(kept, hypotheses.weights) if len(kept) == len(fits) else None


def seeds(problem: HomeProblem, most: int = MAX_SEEDS) -> list[Seed]:
    """Return seeds of the local search, all sets under one assumption being different.

    They are `most` under the usual assumption, and `MAX_SEEDS` under each other.
    """
    found: list[Seed] = []
    q, points = problem.bearings.size, problem.landmarks
    cameras = poses_from_triples(points, problem.bearings, problem.offsets)
    each = POSE_AND_YAW + np.arange(2 * q).reshape(-1, 2)
    marginals = problem.covariance[each[:, :, None], each[:, None]]
    eyes = np.zeros((q, 3)) if problem.offsets is None else problem.offsets
    seen = problem.bearings, problem.sigmas, np.arange(q)
    innovations = SightLines(eyes, *seen, points, marginals).innovations(cameras)[:2]
    for assumed in problem.assumptions:
        under = problem.under(assumed)
        if under.prior is not None:
            found.append((under.prior, np.ones(q, bool), assumed))
        if len(cameras):
            number = most if assumed == USUAL else MAX_SEEDS
            found.extend(_best_of_triples(cameras, innovations, under, number))
    return found


def _best_of_triples(
    cameras: np.ndarray, innovations: tuple[np.ndarray, np.ndarray], problem: HomeProblem, most: int
) -> list[Seed]:
    """Return the best `most` of home's cameras (k, 3), with the inliers of each."""
    scores, inliers = mixture_scores(*innovations, problem.sigmas, problem.moved_prior)
    first: dict[bytes, int] = {}
    best = np.argsort(-scores)[: 6 * most]
    for i in best[np.count_nonzero(inliers[best], axis=1) >= MINIMAL].tolist():
        first.setdefault(inliers[i].tobytes(), i)
    chosen = list(first.values())[:most]
    homes = compose(cameras[chosen], between(problem.mount, np.zeros(3)))
    return [(h, i, problem.assumed) for h, i in zip(homes, inliers[chosen], strict=True)]


def _local_search(
    problem: HomeProblem, home: np.ndarray, inliers: np.ndarray, found: dict[Key, HomeFit]
) -> None:
    """Flip one bearing at a time while the evidence grows; collect all sets on the way."""
    best: HomeFit | None = None
    for _ in range(MAX_FLIPS):
        known = found.get((problem.assumed, inliers.tobytes()))
        now = fit(problem, home, inliers) if known is None else known
        if now is None:
            return
        found[now.key] = now
        if known is not None or (best is not None and now.log_evidence <= best.log_evidence):
            return
        best = now
        flip = _best_flip(problem, now)
        if flip is None:
            return
        home, inliers = now.home, flip


def _best_flip(problem: HomeProblem, now: HomeFit) -> np.ndarray | None:
    """Return the set after the single flip that gains most, or None if none gains."""
    if not now.inliers.size:
        return None
    gain = np.where(now.inliers, -now.odds, now.odds)
    if now.inliers.sum() <= problem.min_inliers:
        gain[now.inliers] = -np.inf
    i = int(np.argmax(gain))
    if not gain[i] > 0.0:
        return None
    flipped = now.inliers.copy()
    flipped[i] ^= True
    return flipped


def _weigh(found: dict[Key, HomeFit]) -> Hypotheses:
    """Return fits as hypotheses: with the best one's neighbours, without improbable ones.

    The evidence of an unconverged fit is not comparable. If it is not improbable, the set is kept
    aside, since home may be anywhere along the iteration.
    """
    converged = {key: f for key, f in found.items() if f.converged} or found
    best = max(converged.values(), key=lambda f: f.log_evidence)
    fits = [*converged.values(), *_neighbours(best, converged)]
    fits.sort(key=lambda f: -f.log_evidence)
    weights = np.exp(np.array([f.log_evidence for f in fits]) - fits[0].log_evidence)
    keep = weights > IMPROBABLE
    weights = weights[keep] / weights[keep].sum()
    kept = tuple(f for f, k in zip(fits, keep, strict=True) if k)
    least = best.log_evidence + math.log(IMPROBABLE)
    unconverged = [f for f in found.values() if not f.converged and f.log_evidence > least]
    return Hypotheses(kept, weights, tuple(unconverged) if best.converged else ())


def _neighbours(best: HomeFit, found: Container[Key]) -> Iterator[HomeFit]:
    """Yield fits to sets that differ from the best one by an undecided flip, if not yet found."""
    for i in np.argsort(np.abs(best.odds))[:NUM_NEIGHBOURS]:
        inliers = best.inliers.copy()
        inliers[i] ^= True
        key = best.problem.assumed, inliers.tobytes()
        if abs(best.odds[i]) < UNDECIDED and key not in found:
            tried = _fit_nearby(best, best.problem, best.home, inliers)
            if tried is not None and tried.converged:
                yield tried


def _fit_nearby(
    lead: HomeFit | None, problem: HomeProblem, home: np.ndarray, inliers: np.ndarray
) -> HomeFit | None:
    """Fit home from `home` (3,), reusing another fit's linearisation if it has the same home."""
    if lead is not None and inliers.sum() >= problem.min_inliers:
        quick = solved(lead, inliers, lead.inflation)
        if quick is not None and quick.converged and quick.is_same_home(home):
            return quick
    return fit(problem, home, inliers, steps=3)
