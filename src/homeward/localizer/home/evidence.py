"""Evidence of a set of inliers by Laplace's method, and the log odds of each home bearing.

The evidence is the integral over all unknowns, home included, so that sets of different size can be
compared.

An inlier errs by its noise alone. The error of an outlier is unknown (Box and Tiao, 1968): a
landmark may have been pushed a little or carried across the room. So its density is half Gaussian,
half uniform on the circle; adding the variance of the prediction to it is exact.

The share of outliers is unknown, too, and integrated out: as a rule each bearing is an outlier with
a known probability, but after an upheaval any share is equally probable. So each outlier makes
another one more plausible; all the more one on the same body, which is then off by about as much.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.special import betaln

from homeward.geometry.angles import TWO_PI, wrap
from homeward.localizer.home.linearisation import HOME, RESIDUAL, REST, Linear, Whitened
from homeward.localizer.tunables import OUTLIER_SIGMA, UPHEAVAL

UNIFORM_FROM = math.sqrt(TWO_PI)
"""Standard deviation from which a predicted bearing may be anywhere on the circle: no Gaussian is
then denser than the uniform density [rad]."""


def log_inlier(off: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the log density of residuals `off` [rad] of inliers, predicted with `variance`."""
    variance = np.maximum(variance, 1e-12)
    normal = -0.5 * off**2 / variance - 0.5 * np.log(TWO_PI * variance)
    return np.where(variance > UNIFORM_FROM**2, -math.log(TWO_PI), normal)


def log_outlier(off: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the log density of residuals `off` [rad] of outliers, predicted with `variance`."""
    pushed, anywhere = log_inlier(off, variance + OUTLIER_SIGMA**2), -math.log(TWO_PI)
    return np.asarray(np.logaddexp(pushed, anywhere) - math.log(2.0))


def log_odds(off: np.ndarray, variance: np.ndarray, share: np.ndarray | float) -> np.ndarray:
    """Return the log odds of inlier against outlier.

    `off` is the stored minus the predicted bearing [rad], `variance` its variance for an inlier,
    and `share` the prior probability of an outlier.
    """
    prior = np.log1p(-share) - np.log(share)
    return np.asarray(prior + log_inlier(off, variance) - log_outlier(off, variance))


def log_set_prior(
    right: np.ndarray | int, wrong: np.ndarray | int, moved_prior: float
) -> np.ndarray:
    """Return the log prior of a set with numbers of inliers `right` and outliers `wrong`."""
    rule = right * math.log1p(-moved_prior) + wrong * math.log(moved_prior)
    upheaval = betaln(1.0 + right, 1.0 + wrong)
    return np.asarray(np.logaddexp(math.log1p(-UPHEAVAL) + rule, math.log(UPHEAVAL) + upheaval))


def moved_share(right: np.ndarray | int, wrong: np.ndarray | int, moved_prior: float) -> np.ndarray:
    """Return the prior probability that another bearing is an outlier, given those numbers."""
    more = log_set_prior(right, wrong + 1, moved_prior)
    return np.asarray(np.exp(more - log_set_prior(right, wrong, moved_prior)))


cached_set_prior, cached_moved_share = lru_cache(log_set_prior), lru_cache(moved_share)
"""Cached for single numbers, since their special functions are slow."""


@dataclass(frozen=True)
class Evidence:
    """Evidence of a set of inliers, and for and against each home bearing."""

    linear: Linear
    whitened: Whitened
    step: np.ndarray
    """(3,): step of home from the linearisation point."""
    information: np.ndarray
    """(3, 3): information on home; its inverse and log determinant are:"""
    covariance: np.ndarray
    log_determinant: float

    @cached_property
    def innovation(self) -> np.ndarray:
        """(q,): innovations, stored minus predicted by everything else [rad] ..."""
        return self._all(self._inliers[0], self._outliers[0])

    @cached_property
    def variance(self) -> np.ndarray:
        """(q,): ... and their variances."""
        return self._all(self._inliers[1], self._outliers[1])

    @cached_property
    def odds(self) -> np.ndarray:
        """(q,): log odds of each to be an inlier, given the rest of the set."""
        if not self.linear.problem.bodies.members.size:
            return log_odds(self.innovation, self.variance, self.others_share)
        prior = self._log_labels(np.eye(1 + self.innovation.size, dtype=bool)[:, 1:])
        gain = prior[1:] - prior[0]
        gain[self.whitened.members] *= -1.0
        return np.asarray(gain + log_odds(self.innovation, self.variance, 0.5))

    @property
    def others_share(self) -> np.ndarray:
        """(q,): prior probability of each to be an outlier, given how many others are."""
        right, wrong = self.whitened.members.size, self.whitened.rest.size
        prior = self.linear.problem.moved_prior
        inlier_share = cached_moved_share(right - 1, wrong, prior) if right else 0.0
        outlier_share = cached_moved_share(right, wrong - 1, prior) if wrong else 0.0
        return self._all(np.full(right, inlier_share), np.full(wrong, outlier_share))

    @property
    def log_evidence(self) -> float:
        """Log evidence for a uniform prior of home, up to a constant common to all sets."""
        whitened, problem = self.whitened, self.linear.problem
        n, wrong = whitened.members.size, whitened.rest.size
        square = float(
            whitened.products[RESIDUAL, RESIDUAL] - self.step @ self.information @ self.step
        )
        if problem.prior is not None:
            offset = problem.prior_offset(self.linear.at)
            square += float(offset @ problem.initial_information @ offset)
        log_density = -0.5 * (square + whitened.log_volume + n * math.log(TWO_PI))
        log_home = 0.5 * (3.0 * math.log(TWO_PI) - self.log_determinant)
        log_prior = float(cached_set_prior(n, wrong, problem.moved_prior))
        if problem.bodies.members.size:
            log_prior = float(self._log_labels(np.zeros((1, n + wrong), bool))[0])
        outliers = float(log_outlier(*self._outliers).sum()) if wrong else 0.0
        return log_density + log_home + log_prior + outliers

    def _log_labels(self, flips: np.ndarray) -> np.ndarray:
        """Return the log prior of sets with bodies, (f,): this one with `flips` (f, q), bool."""
        problem, inside = self.linear.problem, np.zeros(flips.shape[1], bool)
        inside[self.whitened.members] = True
        return problem.bodies.log_labels(inside ^ flips, problem.moved_prior, self._log_moved)

    @cached_property
    def _log_moved(self) -> np.ndarray:
        """(b,): log density of each body that moved, less that of its members as outliers.

        Bearings of one body are off by the same angle, but for its rotation.
        """
        bodies, places = self.linear.problem.bodies, self.linear.problem.landmarks
        (body, each, lead), off, variance = bodies.pairs, self.innovation, self.variance
        apart, away = places[each] - places[lead], places[lead] - self.linear.at[:2]
        turned = (apart**2).sum(axis=1) / np.maximum((away**2).sum(axis=1), 1e-12)
        both = turned + variance[each] + variance[lead]
        density = log_inlier(wrap(off[each] - off[lead]), both)
        density -= log_outlier(off[each], variance[each])
        return np.bincount(body, density, len(bodies.members))

    @cached_property
    def _inliers(self) -> tuple[np.ndarray, np.ndarray]:
        """Innovations (r,) of the set, each given the others, and their variances."""
        jacobian, residual = self.whitened.weighted[:, HOME], self.whitened.weighted[:, RESIDUAL]
        precision = self.whitened.precision - ((jacobian @ self.covariance) * jacobian).sum(axis=1)
        variance = self._with_own_noise(1.0 / np.maximum(precision, 1e-9), self.whitened.members)
        return (residual - jacobian @ self.step) * variance, variance

    @cached_property
    def _outliers(self) -> tuple[np.ndarray, np.ndarray]:
        """Innovations (q - r,) of those outside the set, and their variances."""
        linear, rest, products = self.linear, self.whitened.rest, self.whitened.products[REST]
        # The set corrects the map, and so predicts them for a given home.
        jacobian = linear.by_home[rest] - products[:, HOME]
        innovation = wrap(linear.residual[rest] - products[:, RESIDUAL] - jacobian @ self.step)
        variance = linear.residual_covariance[rest, rest] - products[:, REST].diagonal()
        variance = variance + ((jacobian @ self.covariance) * jacobian).sum(axis=1)
        return innovation, self._with_own_noise(variance, rest)

    def _with_own_noise(self, variance: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Return variances (k,) of some innovations, at least those of the bearings themselves.

        Where the landmarks have a large common error, they are differences of far larger terms.
        """
        return np.asarray(np.maximum(variance, self.linear.problem.sigmas[which] ** 2))

    def _all(self, inliers: np.ndarray, outliers: np.ndarray) -> np.ndarray:
        """Return values of the set (r,) and of the rest (q - r,) in order (q,)."""
        found = np.empty(inliers.size + outliers.size)
        found[self.whitened.members], found[self.whitened.rest] = inliers, outliers
        return found
