"""Survey of landmarks: what of it agrees with the map, by the evidence of sets.

What is wrong is found before it touches the map: landmarks move after they were surveyed, and
surveys have slips of the pen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from homeward.drives.drive import KnownLandmarks
from homeward.localizer.geometry import lever, rotation
from homeward.localizer.map.elimination import positive_inverse
from homeward.localizer.map.state import HEAD, Marginal
from homeward.localizer.map.survey_factors import SurveyFactors, align, apart_along, columns
from homeward.localizer.motion.preintegration import NC
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import AGREES, LINEAR, NEGLIGIBLE, POSE

MOST_JUDGED = 48
"""Of so many landmarks at most the survey is used; those that came first."""
MOST_FLIPS = 24
"""Steps of a search for what is wrong."""
ANYWHERE = 10.0
"""Beforehand the datum is so vague [size of the survey; rad]."""


class Survey:
    """What is known of landmarks beforehand, and what of it agrees with the map.

    Parameters
    ----------
    known : KnownLandmarks
        As the user told it.
    settings : LocalizerSettings
        Of which `moved_prior` is the probability that one of it is wrong, and `sure` that which
        one of it needs to be used.
    """

    def __init__(self, known: KnownLandmarks, settings: LocalizerSettings) -> None:
        self.known, self._prior, self._sure = known, settings.moved_prior, settings.sure
        names = list(known.landmarks)
        places = np.array([(s.x, s.y) for s in known.landmarks.values()]).reshape(-1, 2)
        if known.frame == "own" and names:
            places = places - places.mean(axis=0)  # of a grid's coordinates the map asks nothing
        sigmas = [s.sigma or known.sigma for s in known.landmarks.values()]
        self._surveyed = dict(zip(names, zip(places, sigmas, strict=True), strict=True))
        self.wrong: dict[str, float] = {}
        """Probability that a landmark stands elsewhere than the survey says, if judged ..."""
        self.wrong_distances: dict[int, float] = {}
        """... and that a distance, by its place in the list, is wrong."""
        self.used: list[str] = []
        """The surveyed landmarks that are taken for right."""

    def judge(self, free: Marginal, numbers: Mapping[str, int], ids: np.ndarray) -> SurveyFactors:
        """Judge what is known by the map without it; return what is right for sure.

        Each place and distance is right, or wrong and then anywhere. Sets of right ones are weighed
        by their evidence, with which they follow from each other, the datum and the map being
        unknown as far as they are; a local search flips the one that gains most. It starts from
        all, from those that were right before, and from the most that two landmarks have on their
        side (least median of squares, Rousseeuw 1984), which holds while most are right.

        Parameters
        ----------
        free : Marginal
            The map without it.
        numbers : mapping of str to int
            Ids of the mapped landmarks by name, where they stood first.
        ids : ndarray, shape (n,)
            All of the map, ascending.
        """
        names = [n for n in self._surveyed if n in numbers][:MOST_JUDGED]
        pairs = [
            i for i, d in enumerate(self.known.distances) if all(n in numbers for n in d.between)
        ]
        self.wrong, self.wrong_distances = {}, {}
        factors = self._factors(names, pairs, numbers)
        if len(names) < 2 and not pairs:
            self.used = []
            return SurveyFactors.none()
        problem = _Problem.of(factors, free, ids, self._prior)
        k = len(names)
        before = np.array([n in self.used for n in names] + [True] * len(pairs), bool)
        wrong = problem.wrong([np.ones(k + len(pairs), bool), before, *problem.majority()])
        if k >= 2:
            self.wrong = dict(zip(names, wrong[:k].tolist(), strict=True))
        self.wrong_distances = dict(zip(pairs, wrong[k:].tolist(), strict=True))
        sure = wrong <= 1.0 - self._sure
        self.used = [n for n, s in zip(names, sure[:k], strict=True) if s and k >= 2]
        self.used = self.used if len(self.used) >= 2 else []
        right = [i for i, s in zip(pairs, sure[k:], strict=True) if s]
        return self._factors(self.used, right, numbers)

    def _factors(
        self, names: list[str], pairs: list[int], numbers: Mapping[str, int]
    ) -> SurveyFactors:
        """Return the factors of surveyed landmarks and of distances."""
        told = [self._surveyed[n] for n in names]
        apart = [self.known.distances[i] for i in pairs]
        return SurveyFactors(
            np.array([numbers[n] for n in names], int),
            np.array([place for place, _ in told]).reshape(-1, 2),
            np.array([sigma for _, sigma in told]),
            np.array([[numbers[n] for n in d.between] for d in apart], int).reshape(-1, 2),
            np.array([d.distance for d in apart]),
            np.array([d.sigma or self.known.sigma for d in apart]),
        )


@dataclass(frozen=True)
class _Problem:
    """Which of k places and m distances are right, by the map without them."""

    factors: SurveyFactors
    mapped: np.ndarray
    """(k, 2) [m]"""
    covariance: np.ndarray
    """(2 k + m, 2 k + m): of mapped less surveyed places, and of measured less told distances."""
    off: np.ndarray
    """(m,): the latter [m]."""
    size: float
    """Of the survey [m]: what is wrong is off by about so much."""
    prior: float

    @staticmethod
    def of(factors: SurveyFactors, free: Marginal, ids: np.ndarray, prior: float) -> _Problem:
        """Return what a map says of them."""
        index, pairs = (np.searchsorted(ids, i) for i in (factors.ids, factors.pairs))
        k, m = index.size, len(pairs)
        jacobian = np.zeros((2 * k + m, free.mean.size - HEAD))
        jacobian[np.arange(2 * k), columns(index) - NC] = 1.0
        off = np.zeros(m)
        for i, pair in enumerate(pairs):
            apart, along = apart_along(free.positions[pair])
            jacobian[2 * k + i, columns(pair) - NC] = along
            off[i] = apart - factors.distances[i]
        noise = np.concatenate([np.repeat(factors.sigmas, 2), factors.distance_sigmas])
        covariance = jacobian @ free.covariance[HEAD:, HEAD:] @ jacobian.T + np.diag(noise**2)
        size = float(np.max(np.ptp(factors.places, axis=0), initial=0.0)) if k else 0.0
        size = max(size, float(factors.distances.max(initial=0.0)))
        return _Problem(factors, free.positions[index], covariance, off, size, prior)

    def majority(self) -> list[np.ndarray]:
        """Return what agrees with the two landmarks that most agree with, if there are enough."""
        k = self.factors.ids.size
        if k <= POSE:
            return []
        p, q = (np.ascontiguousarray(a).view(complex)[:, 0] for a in (self.mapped, self._places))
        i, j = np.triu_indices(k, 1)
        ratio = (p[j] - p[i]) / np.where(q[j] == q[i], np.inf, q[j] - q[i])
        i, ratio = i[near := np.abs(np.abs(ratio) - 1.0) < LINEAR], ratio[near]
        if not i.size:
            return []
        off = np.abs(p - p[i, None] - ratio[:, None] * (q - q[i, None]))
        middle = np.partition(off, k // 2, axis=1)[:, k // 2]
        best = int(middle.argmin())
        agrees = off[best] <= 1.48 * AGREES * max(float(middle[best]), 1e-9)
        return [np.concatenate([agrees, np.ones(self.off.size, bool)])]

    def wrong(self, seeds: list[np.ndarray]) -> np.ndarray:
        """Return the probability of each to be wrong, shape (k + m,), searched for from seeds."""
        found: dict[bytes, float] = {}
        for seed in seeds:
            right, evidence, tried = seed.copy(), self._evidence(seed), set[bytes]()
            for _ in range(MOST_FLIPS):
                if right.tobytes() in tried:
                    break
                tried.add(right.tobytes())
                found[right.tobytes()] = evidence
                gains = np.where(right, -1.0, 1.0) * self._odds(right)
                for i, gain in enumerate(gains.tolist()):
                    flipped = right.copy()
                    flipped[i] ^= True
                    found.setdefault(flipped.tobytes(), evidence + gain)
                i = int(gains.argmax())
                if not gains[i] > 0.0:
                    break
                right[i] ^= True
                evidence = self._evidence(right)
        sets = np.array([np.frombuffer(key, bool) for key in found])
        log = np.array(list(found.values()))
        weights = np.where(log > log.max() + math.log(NEGLIGIBLE), np.exp(log - log.max()), 0.0)
        return np.asarray(weights @ ~sets / weights.sum())

    @property
    def _places(self) -> np.ndarray:
        """(k, 2): as surveyed [m]."""
        return self.factors.places

    def _linear(self, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what all are off, and its covariance, the datum free around that of a set."""
        k = self.factors.ids.size
        covariance, residual = self.covariance.copy(), np.zeros((k, 2))
        if k >= 2:
            some = right[:k] if right[:k].sum() >= 2 else np.ones(k, bool)
            found = align(self.mapped[some], self._places[some], self.factors.sigmas[some])
            x, y, heading = found.pose.tolist()
            turned = self._places @ rotation(heading)[:2, :2].T
            residual = self.mapped - turned - (x, y)
            vague = ANYWHERE * np.array([self.size, self.size, 1.0])
            by_pose = vague * lever(turned)[:, :2].reshape(-1, 3)
            covariance[: 2 * k, : 2 * k] += by_pose @ by_pose.T
        return np.concatenate([residual.ravel(), self.off]), covariance

    def _blocks(self) -> list[np.ndarray]:
        """Return which numbers are of each place and of each distance."""
        k, m = self.factors.ids.size, self.off.size
        return [*np.arange(2 * k).reshape(-1, 2), *(2 * k + np.arange(m)).reshape(-1, 1)]

    def _log_wrong(self, dimension: int) -> float:
        """Return the log density of a wrong place or distance."""
        return -dimension * math.log(self.size)

    def _evidence(self, right: np.ndarray) -> float:
        """Return the log evidence of a set, up to a constant."""
        blocks = self._blocks()
        p, (z, covariance) = self.prior, self._linear(right)
        chosen = [b for b, r in zip(blocks, right, strict=True) if r]
        log = sum(
            math.log(1.0 - p) if r else math.log(p) + self._log_wrong(b.size)
            for b, r in zip(blocks, right, strict=True)
        )
        if chosen:
            at = np.concatenate(chosen)
            log += _log_normal(z[at], covariance[np.ix_(at, at)])
        return log

    def _odds(self, right: np.ndarray) -> np.ndarray:
        """Return the log odds of each to be right, the others of a set given, shape (k + m,)."""
        z, covariance = self._linear(right)
        odds, blocks = [], self._blocks()
        chosen = [b for b, r in zip(blocks, right, strict=True) if r]
        at = np.concatenate([np.zeros(0, int), *chosen])
        inverse = positive_inverse(covariance[np.ix_(at, at)]) if at.size else np.zeros((0, 0))
        weighted = inverse @ z[at]
        place = {int(a): i for i, a in enumerate(at)}
        for block, is_right in zip(blocks, right.tolist(), strict=True):
            if is_right:
                mine = [place[b] for b in block.tolist()]
                spread = np.linalg.inv(inverse[np.ix_(mine, mine)])
                off = spread @ weighted[mine]
            else:
                across = covariance[np.ix_(block, at)]
                off = z[block] - across @ weighted
                spread = covariance[np.ix_(block, block)] - across @ inverse @ across.T
            odds.append(_log_normal(off, spread) - self._log_wrong(block.size))
        return np.array(odds) + math.log1p(-self.prior) - math.log(self.prior)


def _log_normal(off: np.ndarray, covariance: np.ndarray) -> float:
    """Return the log density of a normal distribution."""
    root = np.linalg.cholesky(2.0 * math.pi * covariance)
    white = np.linalg.solve(root, off)
    return float(-math.pi * white @ white - np.log(root.diagonal()).sum())
