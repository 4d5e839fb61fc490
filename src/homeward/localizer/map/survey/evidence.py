"""Outlier rejection in a survey: the evidence of sets of surveyed positions and distances.

Outliers are found before they affect the map: landmarks move after they were surveyed, and surveys
contain slips of the pen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from homeward.geometry.angles import TWO_PI
from homeward.geometry.se2 import lever, rotation
from homeward.localizer.map.bodies import Bodies
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.survey.factors import (
    SurveyFactors,
    align,
    coordinates,
    distance_and_jacobian,
    rotated,
)
from homeward.localizer.motions import HEAD
from homeward.localizer.tunables import (
    EXCHANGED,
    GATE,
    IMPROBABLE,
    MAX_TESTED,
    MIN_CHANGE,
    MIN_SCALE,
    NUM_NEIGHBOURS,
    UNDECIDED,
    VAGUE_DATUM,
)


class SurveyTest(NamedTuple):
    """Posterior probabilities of k surveyed places and m distances."""

    wrong: np.ndarray
    """(k + m,): that a landmark is not at its own place, and that a distance is wrong."""
    exchanged: np.ndarray
    """(k, k): that two landmarks are at each other's place."""
    both_right: np.ndarray
    """(k, k): that two landmarks both are at their own places."""


@dataclass(frozen=True)
class Residuals:
    """Residuals of k surveyed places and m distances against the map; see `tested`."""

    factors: SurveyFactors
    size: float
    """Of the site [m]."""
    mapped: np.ndarray
    """(k, 2): positions of the landmarks in the map [m]."""
    of_map: np.ndarray
    """(2 k + m, 2 k + m): covariance of coordinates in the map, and of distances [m^2]."""
    off: np.ndarray
    """(2 k + m,): residuals of the distances, after zeros [m]."""

    @staticmethod
    def of(factors: SurveyFactors, free: Marginal, ids: np.ndarray, size: float) -> Residuals:
        """Return the residuals against a map `free`, whose landmarks are `ids` (n,), ascending."""
        index, pairs = np.searchsorted(ids, factors.ids), np.searchsorted(ids, factors.pairs)
        k, m = index.size, len(pairs)
        jacobian, off = np.zeros((2 * k + m, free.mean.size - HEAD)), np.zeros(2 * k + m)
        jacobian[np.arange(2 * k), coordinates(index)] = 1.0
        apart, along = distance_and_jacobian(free.positions[pairs])
        at = coordinates(pairs.ravel()).reshape(-1, 4)
        jacobian[2 * k + np.arange(m)[:, None], at], off[2 * k :] = along, apart - factors.distances
        of_map = jacobian @ free.covariance[HEAD:, HEAD:] @ jacobian.T
        of_map[2 * k :, 2 * k :] += np.diag(factors.distance_sigmas**2)
        return Residuals(factors, size, free.positions[index], of_map, off)

    @property
    def item(self) -> np.ndarray:
        """(2 k + m,): index of the place or distance of each residual."""
        k, m = len(self.mapped), len(self.factors.pairs)
        return np.concatenate([np.repeat(np.arange(k), 2), k + np.arange(m)])

    def only(self, places: np.ndarray) -> Residuals:
        """Return the residuals of some places, by their indices, and of all distances."""
        n = 2 * len(self.mapped)
        rows = np.concatenate([coordinates(places), np.arange(n, self.off.size)])
        factors, of_map = self.factors.only(places), self.of_map[np.ix_(rows, rows)]
        return Residuals(factors, self.size, self.mapped[places], of_map, self.off[rows])

    def about(self, inliers: np.ndarray, order: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return all residuals and their covariance, with a vague datum around that of a set.

        Of the surveyed places, that at `order` (k,) is a landmark's.
        """
        k, size = len(self.mapped), self.size
        if not k:
            return self.off, self.of_map
        at, places = coordinates(order), self.factors.places[order]
        covariance = self.factors.covariance[np.ix_(at, at)]
        some = inliers[:k] if inliers[:k].sum() >= 2 else np.ones(k, bool)
        of_some = covariance[np.ix_(np.repeat(some, 2), np.repeat(some, 2))]
        pose = align(self.mapped[some], places[some], of_some).pose
        rotate = rotation(pose[2])[:2, :2]
        out, residual = places @ rotate.T, self.off.copy()
        vague = np.zeros((self.off.size, 3))
        vague[: 2 * k] = lever(out)[:, :2].reshape(-1, 3) * (size, size, 1.0)
        known = self.of_map + VAGUE_DATUM**2 * vague @ vague.T
        known[: 2 * k, : 2 * k] += rotated(covariance, rotate)
        residual[: 2 * k] = (self.mapped - out - pose[:2]).ravel()
        return residual, known


def tested(
    factors: SurveyFactors,
    free: Marginal,
    ids: np.ndarray,
    prior: np.ndarray,
    size: float,
    bodies: Bodies,
) -> SurveyTest:
    """Test k places and m distances against the map.

    At most `MAX_TESTED` places, the first ones, are tested together, with the distances. The others
    are tested given those of them that are in place, each one or body independently of the rest.

    `free` is the map without the survey, `ids` (n,) those of its landmarks, ascending, `prior` (k +
    m,) the prior probability of each to be an outlier, and `size` that of the site [m].
    `numpy.linalg.LinAlgError` if the map is too uncertain for the test.
    """
    k, every = factors.ids.size, Residuals.of(factors, free, ids, size)
    if k <= MAX_TESTED:
        return _tested_together(every, prior, bodies)
    first, rest = np.arange(MAX_TESTED), np.arange(MAX_TESTED, k)
    together = np.concatenate([first, np.arange(k, prior.size)])
    found = _tested_together(every.only(first), prior[together], bodies.among(first))
    wrong = np.zeros(prior.size)
    wrong[together] = found.wrong
    wrong[rest] = _wrong_given(wrong, rest, every, prior, bodies)
    both = np.minimum.outer(1.0 - wrong[:k], 1.0 - wrong[:k])  # they do not exclude each other
    exchanged, at = np.zeros((k, k)), np.ix_(first, first)
    both[at], exchanged[at] = found.both_right, found.exchanged
    return SurveyTest(wrong, exchanged, both)


def relative_scale(residuals: Residuals) -> tuple[float, float]:
    """Return the size of the survey over that of the map, less 1, and its standard deviation [1].

    By generalised least squares of k places, at least two, and distances. Such an error is common
    to all, so that no comparison of sets of them finds it.
    """
    k = len(residuals.mapped)
    off, covariance = residuals.about(np.ones(residuals.off.size, bool), np.arange(k))
    along = np.zeros(off.size)
    along[: 2 * k] = (residuals.mapped - residuals.mapped.mean(axis=0)).ravel()
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), np.column_stack([along, off]))
    information = float(whitened[:, 0] @ whitened[:, 0])
    return -float(whitened[:, 0] @ whitened[:, 1]) / information, information**-0.5


def stretch(residuals: Residuals) -> float:
    """Return the `relative_scale` where it is beyond its error, else 0 [1]."""
    off, sigma = relative_scale(residuals)
    return off if abs(off) > GATE * sigma else 0.0


def is_another_size(size: float) -> bool:
    """Return whether a map that is `size` times as large as another one contradicts it."""
    return abs(math.log(max(size, MIN_SCALE))) > math.log1p(MIN_CHANGE)


def _wrong_given(
    wrong: np.ndarray, rest: np.ndarray, residuals: Residuals, prior: np.ndarray, bodies: Bodies
) -> np.ndarray:
    """Return the probability of each place of the `rest` (r,) to be an outlier, shape (r,).

    Those of all others, in `wrong` (k + m,), decide which of them are inliers.
    """
    labels = _Labels.of(residuals, prior, bodies)
    right = wrong < 0.5
    right[rest] = False
    within = labels.bodies.members & np.isin(np.arange(right.size), rest)
    within = within[within.sum(axis=1) > 1]
    changed = np.vstack([np.eye(right.size, dtype=bool)[rest], within])
    about = residuals.about(right, np.arange(len(residuals.mapped)))
    _, density = _weigh(right, residuals.item, *about, right | changed)
    alone, as_one = np.split(density, [rest.size])
    as_one = as_one - within[:, rest] @ alone

    def log(sets: np.ndarray) -> np.ndarray:
        inside = ~(~sets @ within.T)
        return np.asarray(labels.log_prior(sets) + sets[:, rest] @ alone + inside @ as_one)

    best = right.copy()
    best[rest] = alone > labels.log_outlier[rest]
    for _ in range(2 * rest.size):
        found = log(np.vstack([best, best ^ changed]))
        gains = found[1:] - found[0]
        if not gains.max() > 0.0:
            break
        best = best ^ changed[gains.argmax()]
    unit = np.eye(rest.size, dtype=bool) | (within[:, rest].T @ within[:, rest])
    weights = (changed[:, rest] @ unit) * np.exp(np.minimum(gains, 0.0))[:, None]
    out = ~best[rest] + (weights * ~(best ^ changed)[:, rest]).sum(axis=0)
    return np.asarray(out / (1.0 + weights.sum(axis=0)))


@dataclass(frozen=True)
class _Labels:
    """Prior of the labels, inlier or outlier, of places and distances."""

    prior: np.ndarray
    bodies: Bodies
    log_outlier: np.ndarray
    """(k + m,): log density of each as an outlier, which may be anywhere on the site."""
    more: np.ndarray
    """(b,): see `Bodies.log_labels`."""

    @staticmethod
    def of(residuals: Residuals, prior: np.ndarray, bodies: Bodies) -> _Labels:
        """Return the prior; a body that moved may be anywhere on the site, too."""
        k, m = len(residuals.mapped), len(residuals.factors.pairs)
        log_outlier = -np.bincount(residuals.item, minlength=k + m) * math.log(residuals.size)
        more = _log_moved(bodies, residuals) - bodies.members @ log_outlier[:k]
        bodies = Bodies(np.pad(bodies.members, ((0, 0), (0, m))), bodies.one_body)
        return _Labels(prior, bodies, log_outlier, more)

    def log_prior(self, sets: np.ndarray) -> np.ndarray:
        """Return the log prior (f,) of sets of inliers (f, k + m), with the outliers' density."""
        log = self.bodies.log_labels(sets, self.prior, self.more)
        return np.asarray(log + ~sets @ self.log_outlier)


def _tested_together(residuals: Residuals, prior: np.ndarray, bodies: Bodies) -> SurveyTest:
    """Test k places and m distances jointly.

    An outlier may be anywhere on the site, and so may a body that moved; two landmarks may be
    exchanged, each at the place of the other. Sets of inliers are compared by their evidence, datum
    and map being uncertain as they are. A local search from the set of all flips the one, or the
    body, that gains most, as long as any does; then it exchanges two, as long as that gains.
    """
    mapped, places, item = residuals.mapped, residuals.factors.places, residuals.item
    k, m = len(mapped), len(residuals.factors.pairs)
    labels = _Labels.of(residuals, prior, bodies)
    bodies = labels.bodies

    found: dict[bytes, float] = {}
    """Evidence by the place of each landmark (k,) and the inliers (k + m,)."""
    singles = np.eye(k + m, dtype=bool)
    log_exchanged = math.log(EXCHANGED / max(math.comb(k, 2), 1))

    def climb(
        inliers: np.ndarray, order: np.ndarray, least: float = -math.inf
    ) -> tuple[float, np.ndarray]:
        """Flip one at a time; return the best evidence, and its set.

        Not if the evidence of the first set is below `least`.
        """
        fixed = (order != np.arange(k)).nonzero()[0]
        for _ in range(2 * inliers.size):  # all may be outliers, as at another place
            some = (bodies.members & inliers).any(axis=1, keepdims=True)
            changed = np.vstack([singles, bodies.members & (inliers == some)])
            sets = inliers ^ changed[~changed[:, fixed].any(axis=1)]  # both are exchanged, or none
            evidence, gains = _weigh(inliers, item, *residuals.about(inliers, order), sets)
            all_sets = np.vstack([inliers, sets])
            log_prior = labels.log_prior(all_sets)
            gains += log_prior[1:] - log_prior[0]
            evidence += float(log_prior[0]) + fixed.size // 2 * log_exchanged
            found[np.concatenate([order, inliers]).tobytes()] = evidence
            for flipped, gain in zip(sets, gains.tolist(), strict=True):
                found.setdefault(np.concatenate([order, flipped]).tobytes(), evidence + gain)
            if evidence < least or not gains.max(initial=0.0) > 0.0:
                break
            inliers = sets[gains.argmax()]
        return evidence, inliers

    order, every = np.arange(k), np.ones(k + m, bool)
    best = climb(every, order)
    while not best[1].all():
        tried, least = [best], best[0] - UNDECIDED + log_exchanged
        orders = [order]
        for start in (every, best[1]):
            for i, j in _exchangeable(mapped, places, start[:k], order):
                other, inliers = order.copy(), start.copy()
                other[[i, j]], inliers[[i, j]] = order[[j, i]], True
                tried.append(climb(inliers, other, least))
                orders.append(other)
        i = max(range(len(tried)), key=lambda i: tried[i][0])
        if not i:
            break
        best, order = tried[i], orders[i]
    log = np.array(list(found.values()))
    weights = np.exp(np.maximum(log - log.max(), 2.0 * math.log(IMPROBABLE)))
    weights /= weights.sum()
    sets = np.array([np.frombuffer(key, order.dtype) for key in found])
    at, right = sets[:, :k, None] == np.arange(k), sets[:, k:] > 0
    right[:, :k] &= at.diagonal(axis1=1, axis2=2)
    own = right[:, :k]
    both = np.asarray((own * weights[:, None]).T @ own)
    exchanged = np.einsum("h,hij->ij", weights, at) * ~np.eye(k, dtype=bool)
    return SurveyTest(1.0 - weights @ right, exchanged, both)


def _exchangeable(
    mapped: np.ndarray, surveyed: np.ndarray, inliers: np.ndarray, order: np.ndarray
) -> list[tuple[int, int]]:
    """Return pairs of k landmarks, not exchanged yet, that fit better if they are; the best first.

    By the residuals after a rigid motion of them and the other `inliers` (k,), in closed form
    (Procrustes) with equal weights.
    """
    p, q = (np.ascontiguousarray(a).view(complex)[:, 0] for a in (mapped, surveyed[order]))
    own = (order == np.arange(order.size)).nonzero()[0]
    i, j = (own[a] for a in np.triu_indices(own.size, 1))
    of, pairs = np.tile(inliers, (i.size, 1)), np.arange(i.size)
    of[pairs, i] = of[pairs, j] = True
    count = of.sum(axis=1, keepdims=True)
    a, b = (of * (x - (of * x).sum(axis=1, keepdims=True) / count) for x in (p, q))
    now = (a * b.conj()).sum(axis=1)
    then = abs(now - (p[i] - p[j]) * (q[i] - q[j]).conj())
    off = (abs(a) ** 2 + abs(b) ** 2).sum(axis=1) - 2.0 * then
    (better,) = (then > abs(now)).nonzero()
    first = better[np.argsort((off / count[:, 0])[better])[:NUM_NEIGHBOURS]]
    return list(zip(i[first].tolist(), j[first].tolist(), strict=True))


def _log_moved(bodies: Bodies, residuals: Residuals) -> np.ndarray:
    """Return the log density (b,) of the mapped positions of each body if it moved."""
    factors, mapped, size = residuals.factors, residuals.mapped, residuals.size
    # A Gaussian as dense as the uniform density, on the site and in heading.
    vague, found = np.array([size, size, TWO_PI]) / math.sqrt(TWO_PI), []
    for of in bodies.members:
        rows = np.flatnonzero(np.repeat(of, 2))
        at, places = np.ix_(rows, rows), factors.places[of] - factors.places[of].mean(axis=0)
        there = align(mapped[of], places, factors.covariance[at])
        known = residuals.of_map[at] + rotated(
            factors.covariance[at], rotation(there.pose[2])[:2, :2]
        )
        by_pose = there.by_pose * vague
        found.append(_log_normal(there.residual.ravel(), known + by_pose @ by_pose.T))
    return np.array(found)


def _weigh(
    inliers: np.ndarray, item: np.ndarray, z: np.ndarray, covariance: np.ndarray, sets: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the log density of a set, up to a constant, and the gain of other sets (f, k).

    Each other set has either some items less, or some more.
    """
    at = inliers[item]
    # By triangular factors, since what a vague datum leaves of a covariance is small.
    root = np.linalg.cholesky(covariance[np.ix_(at, at)])
    of_set = np.column_stack([np.eye(len(z)), z, covariance])[at]
    whitened = solve_triangular(root, of_set, lower=True)
    left, residual, across = whitened[:, : len(z)], whitened[:, len(z)], whitened[:, len(z) + 1 :]
    inverse, weighted = left.T @ left, left.T @ residual
    off, spread = z - across.T @ residual, covariance - across.T @ across
    gains, changed = np.zeros(len(sets)), (sets ^ inliers)[:, item]
    count, is_less = changed.sum(axis=1), ~(changed & ~at).any(axis=1)
    for size in np.unique(count[count > 0]):
        for less in (True, False):
            some = (count == size) & (is_less == less)
            rows = changed[some].nonzero()[1].reshape(-1, size)
            square = rows[:, :, None], rows[:, None, :]
            if less:  # given the others of the set
                own = np.linalg.inv(inverse[square])
                given = (own @ weighted[rows][:, :, None])[:, :, 0]
                gains[some] = -_log_normal(given, own)
            else:
                gains[some] = _log_normal(off[rows], spread[square])
    log_volume = np.log(root.diagonal()).sum() + 0.5 * at.sum() * math.log(math.tau)
    return float(-0.5 * residual @ residual - log_volume), gains


def _log_normal(off: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the log densities of normal distributions (..., n), shape (...)."""
    root = np.linalg.cholesky(2.0 * math.pi * covariance)
    white = np.linalg.solve(root, off[..., None])[..., 0]
    scale = np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(axis=-1)
    return np.asarray(-math.pi * (white**2).sum(axis=-1) - scale)
