"""Inlier-outlier mixture of a home bearing (Box and Tiao, 1968), given its residual.

A right one is off by its noise alone. By how much a wrong one is off nobody knows: a landmark may
have been pushed a little or carried across the room. So its density is half a Gaussian, half
uniform on the circle; adding the prediction's own variance to it is exact.
"""

from __future__ import annotations

import math

import numpy as np

from homeward.angles import TWO_PI
from homeward.localizer.tunables import PUSHED

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


def log_odds(off: np.ndarray, variance: np.ndarray, moved_prior: float) -> np.ndarray:
    """Return the log odds of right against wrong.

    Parameters
    ----------
    off, variance : ndarray
        Stored minus predicted bearing [rad], and the variance of that, were the bearing right.
    moved_prior : float
        Probability that a bearing is wrong, before it was seen.
    """
    prior = math.log1p(-moved_prior) - math.log(moved_prior)
    return np.asarray(prior + log_inlier(off, variance) - log_outlier(off, variance))
