"""How far off a fitted motion may be: a sandwich covariance, clustered by direction.

The plain inverse of the information takes the errors of all matches for independent, and was found
to be half of the true error. They are not: several features lie on one thing, feel the same change
of view, light and occlusion, and err together. So the gradients of all matches in one sector are
added before they are squared (Liang and Zeger, "Longitudinal data analysis using generalized
linear models", Biometrika 1986), and few sectors are corrected for as usual.
"""

from __future__ import annotations

import math

import numpy as np

from homeward.vision.refine import Fit

SECTORS = 24
"""Of azimuth at home: matches in one are taken to err together."""
BELIEF = 6.0
"""The plain covariance counts as much as so many sectors: few of them say little of their own."""


def covariance(fit: Fit, azimuth: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Return the covariance of a motion.

    Parameters
    ----------
    fit : Fit
        The motion.
    azimuth : ndarray, shape (n,)
        Of each match at home [rad].
    prior : ndarray, shape (5, 5)
        Information that did not come from the matches.

    Returns
    -------
    ndarray, shape (5, 5)
        Of `Motion`.
    """
    bread = np.linalg.inv(fit.information)
    sector = np.floor((azimuth / (2 * math.pi) + 0.5) * SECTORS).astype(int) % SECTORS
    sums = np.zeros((SECTORS, 5))
    np.add.at(sums, sector, fit.scores)
    sums = sums[np.unique(sector[fit.inlier])]
    groups = len(sums)
    if groups < 2:
        return bread
    clustered = sums.T @ sums * groups / (groups - 1)
    plain = fit.information - prior
    filling = (groups * clustered + BELIEF * plain) / (groups + BELIEF)
    return np.asarray(bread @ (filling + prior) @ bread)
