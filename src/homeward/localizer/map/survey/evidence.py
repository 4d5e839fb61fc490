"""Outlier rejection in a survey: the evidence of sets of surveyed positions and distances.

Outliers are found before they affect the map: landmarks move after they were surveyed, and surveys
contain slips of the pen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import betaln

from homeward.geometry.angles import TWO_PI
from homeward.geometry.se2 import lever, rotation
from homeward.localizer.map.bodies import Bodies, find_bodies
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

    An outlier may be anywhere on the site, and so may a body that moved. Sets of inliers are
    compared by their evidence, datum and map being uncertain as they are. A local search from the
    set of all flips the one, or the body, that gains most, as long as any does.

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
    labels = _labels(factors, mapped, of_map[: 2 * k, : 2 * k], prior, size)

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
    inliers, singles = np.ones(k + m, bool), np.eye(k + m, dtype=bool)
    for _ in range(2 * inliers.size):  # all may be outliers, as at another place
        members = labels.bodies.members
        some = (members & inliers).any(axis=1, keepdims=True)
        sets = inliers ^ np.vstack([singles, members & (inliers == some)])
        evidence, gains = _weigh(inliers, item, *linear(inliers), sets)
        now, *then = labels.log_density(np.vstack([inliers, sets])).tolist()
        gains += np.array(then) - now
        evidence += now
        found[inliers.tobytes()] = evidence
        for flipped, gain in zip(sets, gains.tolist(), strict=True):
            found.setdefault(flipped.tobytes(), evidence + gain)
        i = int(gains.argmax())
        if not gains[i] > 0.0:
            break
        inliers = sets[i]
    log = np.array(list(found.values()))
    weights = np.exp(np.maximum(log - log.max(), 2.0 * math.log(IMPROBABLE)))
    outliers = ~np.array([np.frombuffer(key, bool) for key in found])
    return np.asarray(weights @ outliers / weights.sum())


@dataclass(frozen=True)
class _Labels:
    """Labels of k items, inlier or outlier: their prior, and the density of the outliers.

    As a rule each is an outlier with its own probability; after an upheaval, or at another place,
    any share may be, as for home bearings (`homeward.localizer.home.evidence`).
    """

    prior: np.ndarray
    """(k,): prior probability of each to be an outlier."""
    log_outlier: np.ndarray
    """(k,): log density of each as an outlier."""
    bodies: Bodies
    log_moved: np.ndarray
    """(b,): log density of each body that moved, less that of its members as outliers."""

    def log_density(self, inliers: np.ndarray) -> np.ndarray:
        """Return the log density of sets of inliers (f, k), shape (f,)."""
        rule = np.where(inliers, np.log1p(-self.prior), np.log(self.prior)).sum(axis=1)
        rule += self.bodies.log_prior(inliers, self.prior, self.log_moved)
        number = inliers.sum(axis=1)
        upheaval = betaln(1.0 + number, 1.0 + inliers.shape[1] - number)
        upheaval += self.bodies.log_prior(inliers, 0.5, self.log_moved)
        log = np.logaddexp(math.log1p(-UPHEAVAL) + rule, math.log(UPHEAVAL) + upheaval)
        return np.asarray(log + np.where(inliers, 0.0, self.log_outlier).sum(axis=1))


def _labels(
    factors: SurveyFactors, mapped: np.ndarray, of_map: np.ndarray, prior: np.ndarray, size: float
) -> _Labels:
    """Return the labels of k places, at `mapped` (k, 2) now, and of m distances."""
    k, m = len(mapped), len(prior) - len(mapped)
    log_outlier = -np.repeat([2.0, 1.0], [k, m]) * math.log(size)
    bodies = find_bodies(factors.places, size)
    log_moved = np.zeros(len(bodies.members))
    # A Gaussian as dense as the uniform density, on the site and in heading.
    vague = np.array([size, size, TWO_PI]) / math.sqrt(TWO_PI)
    for i, of in enumerate(bodies.members):
        at = np.ix_(np.repeat(of, 2), np.repeat(of, 2))
        places = factors.places[of] - factors.places[of].mean(axis=0)
        there = align(mapped[of], places, factors.covariance[at])
        known = of_map[at] + rotated(factors.covariance[at], rotation(there.pose[2])[:2, :2])
        by_pose = there.by_pose * vague
        log_moved[i] = _log_normal(there.residual.ravel(), known + by_pose @ by_pose.T)
        log_moved[i] -= log_outlier[:k][of].sum()
    members = np.column_stack([bodies.members, np.zeros((len(log_moved), m), bool)])
    return _Labels(prior, log_outlier, Bodies(members, bodies.one_body), log_moved)


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
