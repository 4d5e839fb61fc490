"""Outlier rejection in a survey: the evidence of sets of surveyed positions and distances.

Outliers are found before they affect the map: landmarks move after they were surveyed, and surveys
contain slips of the pen.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from homeward.geometry.angles import TWO_PI
from homeward.geometry.se2 import lever, rotation
from homeward.localizer.map.bodies import Bodies
from homeward.localizer.map.state import HEAD, Marginal
from homeward.localizer.map.survey.factors import (
    SurveyFactors,
    align,
    columns,
    distance_and_jacobian,
    rotated,
)
from homeward.localizer.motion.preintegration import NC
from homeward.localizer.tunables import (
    EXCHANGED,
    IMPROBABLE,
    NUM_EXCHANGES,
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


def tested(
    factors: SurveyFactors,
    free: Marginal,
    ids: np.ndarray,
    prior: np.ndarray,
    size: float,
    bodies: Bodies,
) -> SurveyTest:
    """Test k places and m distances against the map.

    An outlier may be anywhere on the site, and so may a body that moved; two landmarks may be
    exchanged, each at the place of the other. Sets of inliers are compared by their evidence, datum
    and map being uncertain as they are. A local search from the set of all flips the one, or the
    body, that gains most, as long as any does; then it exchanges two, as long as that gains.

    `free` is the map without the survey, `ids` (n,) those of its landmarks, ascending, `prior` (k +
    m,) the prior probability of each to be an outlier, and `size` that of the site [m].
    `numpy.linalg.LinAlgError` if the map is too uncertain for the test.
    """
    index, pairs = np.searchsorted(ids, factors.ids), np.searchsorted(ids, factors.pairs)
    k, m, mapped = index.size, len(pairs), free.positions[index]
    jacobian, off = np.zeros((2 * k + m, free.mean.size - HEAD)), np.zeros(m)
    jacobian[np.arange(2 * k), columns(index) - NC] = 1.0
    for i, pair in enumerate(pairs):
        apart, jacobian[2 * k + i, columns(pair) - NC] = distance_and_jacobian(free.positions[pair])
        off[i] = apart - factors.distances[i]
    of_map = jacobian @ free.covariance[HEAD:, HEAD:] @ jacobian.T
    of_map[2 * k :, 2 * k :] += np.diag(factors.distance_sigmas**2)
    item = np.concatenate([np.repeat(np.arange(k), 2), k + np.arange(m)])
    log_outlier = -np.bincount(item) * math.log(size)
    more = _log_moved(bodies, factors, mapped, of_map, size) - bodies.members @ log_outlier[:k]
    bodies = Bodies(np.pad(bodies.members, ((0, 0), (0, m))), bodies.one_body)

    def linear(inliers: np.ndarray, order: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return all residuals and their covariance, with a vague datum around that of a set.

        Of the surveyed places, that at `order` (k,) is a landmark's.
        """
        if not k:
            return off, of_map
        at, places = (2 * order[:, None] + (0, 1)).ravel(), factors.places[order]
        covariance = factors.covariance[np.ix_(at, at)]
        some = inliers[:k] if inliers[:k].sum() >= 2 else np.ones(k, bool)
        of_some = covariance[np.ix_(np.repeat(some, 2), np.repeat(some, 2))]
        pose = align(mapped[some], places[some], of_some).pose
        rotate = rotation(pose[2])[:2, :2]
        out = places @ rotate.T
        vague = np.zeros((len(item), 3))
        vague[: 2 * k] = lever(out)[:, :2].reshape(-1, 3) * (size, size, 1.0)
        known = of_map + VAGUE_DATUM**2 * vague @ vague.T
        known[: 2 * k, : 2 * k] += rotated(covariance, rotate)
        residual = (mapped - out - pose[:2]).ravel()
        return np.concatenate([residual, off]), known

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
            evidence, gains = _weigh(inliers, item, *linear(inliers, order), sets)
            all_sets = np.vstack([inliers, sets])
            labels = bodies.log_labels(all_sets, prior, more) + ~all_sets @ log_outlier
            gains += labels[1:] - labels[0]
            evidence += float(labels[0]) + fixed.size // 2 * log_exchanged
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
            for i, j in _exchangeable(mapped, factors.places, start[:k], order):
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
    first = better[np.argsort((off / count[:, 0])[better])[:NUM_EXCHANGES]]
    return list(zip(i[first].tolist(), j[first].tolist(), strict=True))


def _log_moved(
    bodies: Bodies, factors: SurveyFactors, mapped: np.ndarray, of_map: np.ndarray, size: float
) -> np.ndarray:
    """Return the log density (b,) of the positions `mapped` (k, 2) of each body if it moved."""
    # A Gaussian as dense as the uniform density, on the site and in heading.
    vague, found = np.array([size, size, TWO_PI]) / math.sqrt(TWO_PI), []
    for of in bodies.members:
        rows = np.flatnonzero(np.repeat(of, 2))
        at, places = np.ix_(rows, rows), factors.places[of] - factors.places[of].mean(axis=0)
        there = align(mapped[of], places, factors.covariance[at])
        known = of_map[at] + rotated(factors.covariance[at], rotation(there.pose[2])[:2, :2])
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
    gains = np.zeros(len(sets))
    for i, changed in enumerate((sets ^ inliers)[:, item]):
        if at[changed].all():  # given the others of the set
            own = np.linalg.inv(inverse[np.ix_(changed, changed)])
            gains[i] = -_log_normal(own @ weighted[changed], own)
        else:
            gains[i] = _log_normal(off[changed], spread[np.ix_(changed, changed)])
    log_volume = np.log(root.diagonal()).sum() + 0.5 * at.sum() * math.log(math.tau)
    return float(-0.5 * residual @ residual - log_volume), gains


def _log_normal(off: np.ndarray, covariance: np.ndarray) -> float:
    """Return the log density of a normal distribution."""
    root = np.linalg.cholesky(2.0 * math.pi * covariance)
    white = np.linalg.solve(root, off)
    return float(-math.pi * white @ white - np.log(root.diagonal()).sum())
