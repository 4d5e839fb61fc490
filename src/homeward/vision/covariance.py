"""How far off a fitted motion may be: what leaving out any one direction would change.

The plain inverse of the information takes the errors of all matches for independent, and was half
of the true error. They are not: features of one thing err together, most of all when the thing has
moved along the epipolar line, and in a bare room few things carry the answer. A sandwich estimate
does not see it, since the fit bends towards the few. The jackknife does: each sector of azimuth is
left out in turn, all its matches together (MacKinnon, Nielsen and Webb, "Fast and reliable
jackknife and bootstrap methods for cluster-robust inference", J. Appl. Econometrics 2023), and the
motion fitted anew, from forgiving to strict: where another set of matches would then be believed,
the answer was not safe, which no derivative tells. Some of the plain covariance is added, for where
there are few sectors the jackknife alone may be small by chance.
"""

from __future__ import annotations

import math

import numpy as np

from homeward.angles import wrap
from homeward.vision.epipolar import Pairs
from homeward.vision.refine import Fit, descend

SECTORS = 24
"""Of azimuth at home: matches in one are taken to err together."""

PLAIN = 0.25
"""What of the plain covariance is added: the sigmas of matches allow for the bad ones (edges of
near things), and most are half as far off."""

LARGEST_SIGMA = 100.0
"""[rad]"""


def covariance(fit: Fit, pairs: Pairs, tilt_sigma: float) -> np.ndarray:
    """Return the covariance of a motion.

    Parameters
    ----------
    fit : Fit
        The motion.
    pairs : Pairs
        All matches.
    tilt_sigma : float
        How far each camera may be tilted from what is known [rad].

    Returns
    -------
    ndarray, shape (5, 5)
        Of `Motion`.
    """
    azimuth = pairs.home[:, 0]
    sector = np.floor((azimuth / (2 * math.pi) + 0.5) * SECTORS).astype(int) % SECTORS
    groups = np.unique(sector[fit.inlier])
    # Of an angle that nothing is known of, no more than this: it keeps the matrix regular.
    plain = np.linalg.inv(fit.information + np.eye(5) / LARGEST_SIGMA**2)
    motion = np.array(fit.motion)
    starts = np.tile(motion, (groups.size, 1))
    kept = sector != groups[:, None]
    change = descend(starts, pairs, tilt_sigma, kept) - motion
    change[:, :2] = wrap(change[:, :2])
    return np.asarray(PLAIN * plain + change.T @ change * (1 - 1 / groups.size))
