"""Inlier-outlier mixture of a home bearing (Box and Tiao, 1968), given its residual.

A right one is off by its noise alone. By how much a wrong one is off nobody knows: a landmark may
have been pushed a little or carried across the room. So its density is half a Gaussian, half
uniform on the circle; adding the prediction's own variance to it is exact.

How large a share of them is wrong nobody knows either, and it is integrated out: as a rule each is
with a probability that is known, but after an upheaval any share is as probable as any other. So
where many were found wrong, one more is no wonder.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import betaln

from homeward.angles import TWO_PI
from homeward.localizer.tunables import PUSHED, UPHEAVAL

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
    pushed, anywhere = log_inlier(off, variance + PUSHED**2), -math.log(TWO_PI)
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
