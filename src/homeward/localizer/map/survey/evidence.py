"""Evidence of what of a survey is right: sets of places and distances that the map agrees with.

What is wrong is found before it touches the map: landmarks move after they were surveyed, and
surveys have slips of the pen.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import betaln

from homeward.localizer.geometry import lever, rotation
from homeward.localizer.map.state import HEAD, Marginal
from homeward.localizer.map.survey.factors import (
    SurveyFactors,
    align,
    apart_along,
    columns,
    turned,
)
from homeward.localizer.motion.preintegration import NC
from homeward.localizer.tunables import IMPROBABLE, UPHEAVAL

MOST_JUDGED = 48
"""So many landmarks at most are judged together: it takes the cube of their number."""
ANYWHERE = 10.0
"""Beforehand the datum is so vague [size of the survey; rad]."""


def wrong_probabilities(
    factors: SurveyFactors, free: Marginal, ids: np.ndarray, prior: np.ndarray, size: float
) -> np.ndarray:
    """Return the probability of each of k places and m distances to be wrong, shape (k + m,).

    Each is right, or wrong and then anywhere on the site. Sets of right ones are weighed by their
    evidence, with which they follow from each other, datum and map being unknown as far as they
    are; a local search from all of them flips the one that gains most, as long as any does.

    Parameters
    ----------
    factors : SurveyFactors
        The places and distances.
    free : Marginal
        The map without any of it.
    ids : ndarray, shape (n,)
        Of the map's landmarks, ascending.
    prior : ndarray, shape (k + m,)
        Of each to be wrong.
    size : float
        Of the site [m].

    Raises
    ------
    numpy.linalg.LinAlgError
        When the map is too vague to judge by.
    """
    index, pairs = np.searchsorted(ids, factors.ids), np.searchsorted(ids, factors.pairs)
    k, m, mapped = index.size, len(pairs), free.positions[index]
    jacobian, off = np.zeros((2 * k + m, free.mean.size - HEAD)), np.zeros(m)
    jacobian[np.arange(2 * k), columns(index) - NC] = 1.0
    for i, pair in enumerate(pairs):
        apart, jacobian[2 * k + i, columns(pair) - NC] = apart_along(free.positions[pair])
        off[i] = apart - factors.distances[i]
    of_map = jacobian @ free.covariance[HEAD:, HEAD:] @ jacobian.T
    of_map[2 * k :, 2 * k :] += np.diag(factors.distance_sigmas**2)
    item = np.concatenate([np.repeat(np.arange(k), 2), k + np.arange(m)])
    log_wrong = -np.bincount(item) * math.log(size)

    def linear(right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what all are off, and its covariance, the datum being free around a set's."""
        if not k:
            return off, of_map
        some = right[:k] if right[:k].sum() >= 2 else np.ones(k, bool)
        of_some = factors.covariance[np.ix_(np.repeat(some, 2), np.repeat(some, 2))]
        pose = align(mapped[some], factors.places[some], of_some).pose
        rotate = rotation(pose[2])[:2, :2]
        out = factors.places @ rotate.T
        vague = np.zeros((len(item), 3))
        vague[: 2 * k] = lever(out)[:, :2].reshape(-1, 3) * (size, size, 1.0)
        known = of_map + ANYWHERE**2 * vague @ vague.T
        known[: 2 * k, : 2 * k] += turned(factors.covariance, rotate)
        residual = (mapped - out - pose[:2]).ravel()
        return np.concatenate([residual, off]), known

    found: dict[bytes, float] = {}
    right = np.ones(k + m, bool)
    for _ in range(2 * right.size):  # all may be wrong, as in another place
        before, labels = _log_labels(right, prior)
        evidence, gains = _weigh(right, item, *linear(right), labels - log_wrong)
        evidence += before + float(log_wrong[~right].sum())
        found[right.tobytes()] = evidence
        for i, gain in enumerate(gains.tolist()):
            flipped = right.copy()
            flipped[i] ^= True
            found.setdefault(flipped.tobytes(), evidence + gain)
        i = int(gains.argmax())
        if not gains[i] > 0.0:
            break
        right[i] ^= True
    log = np.array(list(found.values()))
    weights = np.exp(np.maximum(log - log.max(), 2.0 * math.log(IMPROBABLE)))
    wrong = ~np.array([np.frombuffer(key, bool) for key in found])
    return np.asarray(weights @ wrong / weights.sum())


def _log_labels(right: np.ndarray, prior: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the log probability that just these are right, and the log odds of each of them.

    As a rule each is wrong with a probability of its own (k,); after an upheaval, or in another
    place, any share may be, as of home's bearings (`homeward.localizer.home.evidence`).
    """
    odds = np.log1p(-prior) - np.log(prior)
    rule, number = float(np.where(right, np.log1p(-prior), np.log(prior)).sum()), right.sum()
    step = np.where(right, -1, 1)
    now = _mixed(np.array(rule), number, right.size)
    then = _mixed(rule + step * odds, number + step, right.size)
    return float(now), step * (then - now)


def _mixed(rule: np.ndarray, right: np.ndarray, of: int) -> np.ndarray:
    """Return the log probability by a rule, or by an upheaval, of so many right ones."""
    upheaval = math.log(UPHEAVAL) + betaln(1.0 + right, 1.0 + of - right)
    return np.asarray(np.logaddexp(math.log1p(-UPHEAVAL) + rule, upheaval))


def _weigh(
    right: np.ndarray, item: np.ndarray, z: np.ndarray, covariance: np.ndarray, labels: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the log evidence of a set, up to a constant, and what flipping each one gains."""
    at = right[item]
    # By triangular factors: vague as the datum is, what is left of a covariance is small.
    root = np.linalg.cholesky(covariance[np.ix_(at, at)])
    of_set = np.column_stack([np.eye(len(z)), z, covariance])[at]
    whitened = solve_triangular(root, of_set, lower=True)
    left, residual, across = whitened[:, : len(z)], whitened[:, len(z)], whitened[:, len(z) + 1 :]
    inverse, weighted = left.T @ left, left.T @ residual
    off, spread = z - across.T @ residual, covariance - across.T @ across
    odds = labels.copy()
    for i in range(right.size):
        mine = item == i
        if right[i]:  # by the others of the set
            own = np.linalg.inv(inverse[np.ix_(mine, mine)])
            odds[i] += _log_normal(own @ weighted[mine], own)
        else:
            odds[i] += _log_normal(off[mine], spread[np.ix_(mine, mine)])
    log_volume = np.log(root.diagonal()).sum() + 0.5 * at.sum() * math.log(math.tau)
    evidence = float(-0.5 * residual @ residual - log_volume)
    return evidence, np.where(right, -odds, odds)


def _log_normal(off: np.ndarray, covariance: np.ndarray) -> float:
    """Return the log density of a normal distribution."""
    root = np.linalg.cholesky(2.0 * math.pi * covariance)
    white = np.linalg.solve(root, off)
    return float(-math.pi * white @ white - np.log(root.diagonal()).sum())
