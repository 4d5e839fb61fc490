"""Labels of items, inlier or outlier: densities of their residuals, and the prior of a set.

An inlier errs by its noise alone. The error of an outlier is unknown (Box and Tiao, 1968): a
landmark may have been pushed a little or carried across the room. So its density is half Gaussian,
half uniform on the circle; adding the variance of the prediction to it is exact.

The share of outliers is unknown, too, and integrated out: as a rule each item is an outlier with a
known probability, but after an upheaval any share is equally probable. So each outlier makes
another one more plausible.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import betaln

from homeward.geometry.angles import TWO_PI
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
    return _or_upheaval(rule, betaln(1.0 + right, 1.0 + wrong))


def moved_share(right: np.ndarray | int, wrong: np.ndarray | int, moved_prior: float) -> np.ndarray:
    """Return the prior probability that another item is an outlier, given those numbers."""
    more = log_set_prior(right, wrong + 1, moved_prior)
    return np.asarray(np.exp(more - log_set_prior(right, wrong, moved_prior)))


def log_labels(
    members: np.ndarray,
    one_body: np.ndarray,
    right: np.ndarray,
    wrong: np.ndarray | float,
    more: np.ndarray,
) -> np.ndarray:
    """Return the log prior of labels, and the gain in density of bodies that moved, (f,).

    As a rule each item has its own probability to be moved; after an upheaval, or at another
    place, any share of them may be. `members` (b, k) and `one_body` (b,) are those of `Bodies`;
    `right` (f, k) are the labels: the items in place; `wrong` (k,), or one for all, is the prior
    probability of each to be moved; `more` (b,) is the log density of a body that moved, less that
    of its members moved independently.
    """
    number, items = right.sum(axis=1), right.shape[1]
    both = np.full((2, items), 0.5)  # by the rule, and after an upheaval
    both[0] = wrong
    stays, moves, of_body = np.log1p(-both), np.log(both), members.T.astype(float)
    rule = moves[0].sum() + right @ (stays[0] - moves[0])
    upheaval = betaln(1.0 + number, 1.0 + items - number)
    if not len(members):
        return _or_upheaval(rule, upheaval)
    size, inside = of_body.sum(axis=0), right @ of_body
    share = both @ of_body / size
    stayed = np.log1p(-share) - stays @ of_body
    moved = np.log(share) - moves @ of_body + more
    as_one = np.where(
        inside == size, stayed[:, None], np.where(inside == 0, moved[:, None], -np.inf)
    )
    as_one = np.logaddexp(np.log1p(-one_body), np.log(one_body) + as_one).sum(axis=2)
    return _or_upheaval(rule + as_one[0], upheaval + as_one[1])


def _or_upheaval(rule: np.ndarray | float, upheaval: np.ndarray | float) -> np.ndarray:
    """Return the log prior as a rule or after an upheaval, given that of each."""
    return np.logaddexp(math.log1p(-UPHEAVAL) + rule, math.log(UPHEAVAL) + upheaval)
