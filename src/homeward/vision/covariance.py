"""How far off a fitted motion may be: what leaving out any one direction would change.

The plain inverse of the information takes the errors of all matches for independent, and was half
of the true error. They are not: features of one thing err together, most of all when the thing has
moved along the epipolar line, and in a bare room few things carry the answer. A sandwich estimate
does not see it, since the fit bends towards the few. The jackknife does: each sector of azimuth is
left out in turn, all its matches together (MacKinnon, Nielsen and Webb, "Fast and reliable
jackknife and bootstrap methods for cluster-robust inference", J. Appl. Econometrics 2023). The
plain covariance is added, for where there are few sectors the jackknife alone may be small by
chance.
"""

from __future__ import annotations

import math

import numpy as np

from homeward.vision.refine import Fit

SECTORS = 24
"""Of azimuth at home: matches in one are taken to err together."""

LARGEST_SIGMA = 100.0
"""[rad]"""


def covariance(fit: Fit, azimuth: np.ndarray) -> np.ndarray:
    """Return the covariance of a motion.

    Parameters
    ----------
    fit : Fit
        The motion.
    azimuth : ndarray, shape (n,)
        Of each match at home [rad].

    Returns
    -------
    ndarray, shape (5, 5)
        Of `Motion`.
    """
    sector = np.floor((azimuth / (2 * math.pi) + 0.5) * SECTORS).astype(int) % SECTORS
    groups = np.unique(sector[fit.inlier])
    # Of an angle that nothing is known of, no more than this: it keeps the matrix regular.
    information = fit.information + np.eye(5) / LARGEST_SIGMA**2
    total = np.linalg.inv(information)
    for group in groups:
        rows = fit.rows[sector == group]
        gradient = rows.T @ fit.residuals[sector == group]
        # Of the fit without this sector, to first order.
        change = np.linalg.solve(information - rows.T @ rows, gradient)
        total = total + np.outer(change, change) * (1 - 1 / groups.size)
    return np.asarray(total)
