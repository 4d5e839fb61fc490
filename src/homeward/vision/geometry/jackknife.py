"""How far off a fitted motion may be: what leaving out any one direction would change.

The plain inverse of the information takes the errors of all matches for independent, and was half
of the true error. They are not: features of one thing err together, most of all when the thing has
moved along the epipolar line, and in a bare room few things carry the answer. A sandwich estimate
does not see it, since the fit bends towards the few. The jackknife does: a window of azimuth, as
wide as a thing may be, is left out, all its matches together (MacKinnon, Nielsen and Webb, "Fast
and reliable jackknife and bootstrap methods for cluster-robust inference", J. Appl. Econometrics
2023; with windows that overlap, Kuensch, "The jackknife and the bootstrap for general stationary
observations", Ann. Statist. 1989), and the motion fitted anew, from forgiving to strict, beginning
at that motion, of all that were found, of which the others speak: where they would then believe
another one, the answer was not safe, which no derivative tells. What tilt may do is added in full.
"""

from __future__ import annotations

import numpy as np

from homeward.angles import wrap
from homeward.vision.cameras.panoramic import SECTORS, sector_of
from homeward.vision.geometry.epipolar import Pairs, residuals
from homeward.vision.geometry.refinement import INLIER, Fit, irls, prior_information, squares

WINDOW = 3
"""So many sectors of azimuth at home are left out at once: what stands within 45 degrees may be one
thing."""
SHARE = 0.25
"""What of the plain covariance and of the changes counts. Windows so wide hold a good part of all
that there is: without them the fit changes by more than it errs. Divided by the share of matches
that are more than the motion has parameters: it bends towards them all."""

LARGEST_SIGMA = 100.0
"""[rad]"""


def jackknife_covariance(fit: Fit, pairs: Pairs, tilt_sigma: float) -> np.ndarray:
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
    # Of an angle that nothing is known of, no more than this: it keeps the matrix regular.
    plain = np.linalg.inv(fit.information + np.eye(5) / LARGEST_SIGMA**2)
    by_prior = plain @ prior_information(tilt_sigma) @ plain
    each = leave_windows_out(pairs.home[:, 0], fit.inlier)
    motion = np.array(fit.motion)
    starts = _starts(fit, pairs, tilt_sigma, each)
    change = irls(starts, pairs, tilt_sigma, fit.scale, each) - motion
    change[:, :2] = wrap(change[:, :2])
    n = int(fit.inlier.sum())
    share = SHARE * n / max(n - motion.size, 1)
    return np.asarray(by_prior + share * (plain - by_prior + change.T @ change / WINDOW))


def leave_windows_out(azimuth: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return which matches, at azimuths (n,), are kept as each window in turn is left out.

    Windows in which none `counts`, (n,) bool, are passed over: shape (m, n), bool.
    """
    first = np.arange(SECTORS)[:, None]
    left_out = (sector_of(azimuth) - first) % SECTORS < WINDOW
    return np.asarray(~left_out[(left_out & counts).any(axis=1)])


def _starts(fit: Fit, pairs: Pairs, tilt_sigma: float, kept: np.ndarray) -> np.ndarray:
    """Return, (m, 5), the motion that each choice of matches speaks for."""
    motions = np.vstack([fit.motion, fit.others])
    each = np.minimum(squares(residuals(motions, pairs)), INLIER**2)
    total = kept @ each.T + np.sum((motions @ prior_information(tilt_sigma)) * motions, axis=1)
    return np.asarray(motions[np.argmin(total, axis=1)])
