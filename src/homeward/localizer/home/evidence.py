"""Model evidence of a set of inliers by Laplace's method, and the odds of each home bearing.

The evidence is the integral over all unknowns, home included, so that sets of different size
compare fairly.

A right bearing is off by its noise alone. By how much a wrong one is off nobody knows (Box and
Tiao, 1968): a landmark may have been pushed a little or carried across the room. So its density is
half a Gaussian, half uniform on the circle; adding the prediction's own variance to it is exact.

How large a share of them is wrong nobody knows either, and it is integrated out: as a rule each is
with a probability that is known, but after an upheaval any share is as probable as any other. So
where many were found wrong, one more is no wonder.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.special import betaln

from homeward.angles import TWO_PI, wrap
from homeward.localizer.home.linearisation import HOME, RESIDUAL, REST, Linear, Whitened
from homeward.localizer.tunables import OUTLIER_SIGMA, UPHEAVAL

UNIFORM_FROM = math.sqrt(TWO_PI)
"""A bearing predicted with a larger standard deviation may be anywhere on the circle: there, no
Gaussian is denser than the uniform density [rad]."""


def log_inlier(off: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the log density of being `off` [rad], of right bearings predicted with `variance`."""
    variance = np.maximum(variance, 1e-12)
    normal = -0.5 * off**2 / variance - 0.5 * np.log(TWO_PI * variance)
    return np.where(variance > UNIFORM_FROM**2, -math.log(TWO_PI), normal)


def log_outlier(off: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the log density of being `off` [rad], of wrong ones predicted with `variance`."""
    pushed, anywhere = log_inlier(off, variance + OUTLIER_SIGMA**2), -math.log(TWO_PI)
    return np.asarray(np.logaddexp(pushed, anywhere) - math.log(2.0))


def log_odds(off: np.ndarray, variance: np.ndarray, share: np.ndarray | float) -> np.ndarray:
    """Return the log odds of right against wrong.

    Parameters
    ----------
    off, variance : ndarray
        Stored minus predicted bearing [rad], and the variance of that, were the bearing right.
    share : ndarray or float
        Probability that a bearing is wrong, before it was seen.
    """
    prior = np.log1p(-share) - np.log(share)
    return np.asarray(prior + log_inlier(off, variance) - log_outlier(off, variance))


def log_labels(right: np.ndarray | int, wrong: np.ndarray | int, moved_prior: float) -> np.ndarray:
    """Return the log probability that just so many, and just these, are right and wrong."""
    rule = right * math.log1p(-moved_prior) + wrong * math.log(moved_prior)
    upheaval = betaln(1.0 + right, 1.0 + wrong)
    return np.asarray(np.logaddexp(math.log1p(-UPHEAVAL) + rule, math.log(UPHEAVAL) + upheaval))


def moved_share(right: np.ndarray | int, wrong: np.ndarray | int, moved_prior: float) -> np.ndarray:
    """Return how probable it is that another one is wrong, of so many right and wrong ones."""
    more = log_labels(right, wrong + 1, moved_prior)
    return np.asarray(np.exp(more - log_labels(right, wrong, moved_prior)))


labels_of, share_of = lru_cache(log_labels), lru_cache(moved_share)
"""Of numbers that come again and again; their special functions take long."""


@dataclass(frozen=True)
class Evidence:
    """Evidence of a set of inliers, and of each home bearing for or against it."""

    linear: Linear
    of_set: Whitened
    step: np.ndarray
    """(3,): from where home was linearised to where it is."""
    information: np.ndarray
    """(3, 3): on home, and of that:"""
    covariance: np.ndarray
    log_determinant: float

    @cached_property
    def innovation(self) -> np.ndarray:
        """(q,): stored minus predicted by everything else [rad] ..."""
        return self._all(self._inliers[0], self._outliers[0])

    @cached_property
    def variance(self) -> np.ndarray:
        """(q,): ... and its variance."""
        return self._all(self._inliers[1], self._outliers[1])

    @cached_property
    def odds(self) -> np.ndarray:
        """(q,): log odds of right against wrong, the rest of the set given."""
        return log_odds(self.innovation, self.variance, self.others_share)

    @property
    def others_share(self) -> np.ndarray:
        """(q,): how probable each is to be wrong by how many of the others are."""
        right, wrong = self.of_set.members.size, self.of_set.rest.size
        prior = self.linear.problem.moved_prior
        of_set = share_of(right - 1, wrong, prior) if right else 0.0
        of_rest = share_of(right, wrong - 1, prior) if wrong else 0.0
        return self._all(np.full(right, of_set), np.full(wrong, of_rest))

    @property
    def log_evidence(self) -> float:
        """Log of the evidence, could home be anywhere, up to a constant that all sets share."""
        of_set, problem = self.of_set, self.linear.problem
        n, wrong = of_set.members.size, of_set.rest.size
        square = float(
            of_set.products[RESIDUAL, RESIDUAL] - self.step @ self.information @ self.step
        )
        if problem.prior is not None:
            offset = problem.off_prior(self.linear.at)
            square += float(offset @ problem.before @ offset)
        log_density = -0.5 * (square + of_set.log_volume + n * math.log(TWO_PI))
        log_home = 0.5 * (3.0 * math.log(TWO_PI) - self.log_determinant)
        labels = float(labels_of(n, wrong, problem.moved_prior))
        outliers = float(log_outlier(*self._outliers).sum()) if wrong else 0.0
        return log_density + log_home + labels + outliers

    @cached_property
    def _inliers(self) -> tuple[np.ndarray, np.ndarray]:
        """Innovations (r,) of the set, each by the others of it, and their variances."""
        jacobian, residual = self.of_set.weighted[:, HOME], self.of_set.weighted[:, RESIDUAL]
        left = self.of_set.precision - ((jacobian @ self.covariance) * jacobian).sum(axis=1)
        variance = 1.0 / np.maximum(left, 1e-9)
        return (residual - jacobian @ self.step) * variance, variance

    @cached_property
    def _outliers(self) -> tuple[np.ndarray, np.ndarray]:
        """Innovations (q - r,) of those outside of the set, and their variances."""
        linear, rest, products = self.linear, self.of_set.rest, self.of_set.products[REST]
        # What the set says of the map is what it says of them, were home known.
        jacobian = linear.by_home[rest] - products[:, HOME]
        innovation = wrap(linear.residual[rest] - products[:, RESIDUAL] - jacobian @ self.step)
        variance = linear.residual_covariance[rest, rest] - products[:, REST].diagonal()
        return innovation, variance + ((jacobian @ self.covariance) * jacobian).sum(axis=1)

    def _all(self, inliers: np.ndarray, outliers: np.ndarray) -> np.ndarray:
        """Return values of the set (r,) and of the rest (q - r,), in their places (q,)."""
        found = np.empty(inliers.size + outliers.size)
        found[self.of_set.members], found[self.of_set.rest] = inliers, outliers
        return found
