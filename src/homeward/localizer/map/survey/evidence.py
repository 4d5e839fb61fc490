"""Outlier rejection in a survey: the evidence of sets of surveyed positions and distances.

Outliers are found before they affect the map: landmarks move after they were surveyed, and surveys
contain slips of the pen.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import betaln

from homeward.geometry.se2 import lever, rotation
from homeward.localizer.map.state import HEAD, Marginal
from homeward.localizer.map.survey.factors import (
    SurveyFactors,
    align,
    columns,
    distance_and_jacobian,
    rotated,
)
from homeward.localizer.motion.preintegration import NC
from homeward.localizer.tunables import IMPROBABLE, UPHEAVAL, VAGUE_DATUM


def outlier_probabilities(
    factors: SurveyFactors, free: Marginal, ids: np.ndarray, prior: np.ndarray, size: float
) -> np.ndarray:
    """Return the probability of each of k places and m distances to be an outlier, (k + m,).

    An outlier may be anywhere on the site. Sets of inliers are compared by their evidence, datum
    and map being uncertain as they are. A local search from the set of all flips the one that gains
    most, as long as any does.

    Parameters
    ----------
    factors : SurveyFactors
        The places and distances.
    free : Marginal
        The map without the survey.
    ids : ndarray, shape (n,)
        Of the map's landmarks, ascending.
    prior : ndarray, shape (k + m,)
        Prior probability of each to be an outlier.
    size : float
        Of the site [m].

    Raises
    ------
    numpy.linalg.LinAlgError
        If the map is too uncertain for the test.
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

    def linear(inliers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return all residuals and their covariance, with a vague datum around that of a set."""
        if not k:
            return off, of_map
        some = inliers[:k] if inliers[:k].sum() >= 2 else np.ones(k, bool)
        of_some = factors.covariance[np.ix_(np.repeat(some, 2), np.repeat(some, 2))]
        pose = align(mapped[some], factors.places[some], of_some).pose
        rotate = rotation(pose[2])[:2, :2]
        out = factors.places @ rotate.T
        vague = np.zeros((len(item), 3))
        vague[: 2 * k] = lever(out)[:, :2].reshape(-1, 3) * (size, size, 1.0)
        known = of_map + VAGUE_DATUM**2 * vague @ vague.T
        known[: 2 * k, : 2 * k] += rotated(factors.covariance, rotate)
        residual = (mapped - out - pose[:2]).ravel()
        return np.concatenate([residual, off]), known

    found: dict[bytes, float] = {}
    inliers = np.ones(k + m, bool)
    for _ in range(2 * inliers.size):  # all may be outliers, as at another place
        before, labels = _log_label_prior(inliers, prior)
        evidence, gains = _weigh(inliers, item, *linear(inliers), labels - log_outlier)
        evidence += before + float(log_outlier[~inliers].sum())
        found[inliers.tobytes()] = evidence
        for i, gain in enumerate(gains.tolist()):
            flipped = inliers.copy()
            flipped[i] ^= True
            found.setdefault(flipped.tobytes(), evidence + gain)
        i = int(gains.argmax())
        if not gains[i] > 0.0:
            break
        inliers[i] ^= True
    log = np.array(list(found.values()))
    weights = np.exp(np.maximum(log - log.max(), 2.0 * math.log(IMPROBABLE)))
    outliers = ~np.array([np.frombuffer(key, bool) for key in found])
    return np.asarray(weights @ outliers / weights.sum())


def _log_label_prior(inliers: np.ndarray, prior: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the log prior of a set of inliers, and the log prior odds of each to be one.

    As a rule each is an outlier with its own probability (k,); after an upheaval, or at another
    place, any share may be, as for home bearings (`homeward.localizer.home.evidence`).
    """
    odds = np.log1p(-prior) - np.log(prior)
    rule, number = float(np.where(inliers, np.log1p(-prior), np.log(prior)).sum()), inliers.sum()
    step = np.where(inliers, -1, 1)
    now = _with_upheaval(np.array(rule), number, inliers.size)
    then = _with_upheaval(rule + step * odds, number + step, inliers.size)
    return float(now), step * (then - now)


def _with_upheaval(rule: np.ndarray, inliers: np.ndarray, of: int) -> np.ndarray:
    """Return the log prior with an upheaval as the alternative, for numbers of inliers."""
    upheaval = math.log(UPHEAVAL) + betaln(1.0 + inliers, 1.0 + of - inliers)
    return np.asarray(np.logaddexp(math.log1p(-UPHEAVAL) + rule, upheaval))


def _weigh(
    inliers: np.ndarray, item: np.ndarray, z: np.ndarray, covariance: np.ndarray, labels: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the log evidence of a set, up to a constant, and the gain by flipping each member."""
    at = inliers[item]
    # By triangular factors, since what a vague datum leaves of a covariance is small.
    root = np.linalg.cholesky(covariance[np.ix_(at, at)])
    of_set = np.column_stack([np.eye(len(z)), z, covariance])[at]
    whitened = solve_triangular(root, of_set, lower=True)
    left, residual, across = whitened[:, : len(z)], whitened[:, len(z)], whitened[:, len(z) + 1 :]
    inverse, weighted = left.T @ left, left.T @ residual
    off, spread = z - across.T @ residual, covariance - across.T @ across
    odds = labels.copy()
    for i in range(inliers.size):
        mine = item == i
        if inliers[i]:  # given the others of the set
            own = np.linalg.inv(inverse[np.ix_(mine, mine)])
            odds[i] += _log_normal(own @ weighted[mine], own)
        else:
            odds[i] += _log_normal(off[mine], spread[np.ix_(mine, mine)])
    log_volume = np.log(root.diagonal()).sum() + 0.5 * at.sum() * math.log(math.tau)
    evidence = float(-0.5 * residual @ residual - log_volume)
    return evidence, np.where(inliers, -odds, odds)


def _log_normal(off: np.ndarray, covariance: np.ndarray) -> float:
    """Return the log density of a normal distribution."""
    root = np.linalg.cholesky(2.0 * math.pi * covariance)
    white = np.linalg.solve(root, off)
    return float(-math.pi * white @ white - np.log(root.diagonal()).sum())
