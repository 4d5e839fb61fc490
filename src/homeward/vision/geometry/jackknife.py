"""Cluster jackknife: the covariance of a motion, from leaving out one window of azimuth at a time.

The inverse of the information takes errors of matches for independent; it was half of the true
error. Features of one thing err together, most of all when it has moved along the epipolar line. A
sandwich estimate does not see that, since the fit bends towards the few. So windows of azimuth, as
wide as a thing may be, are left out in turn (MacKinnon, Nielsen and Webb, J. Appl. Econometrics
2023; overlapping windows: Kuensch, Ann. Statist. 1989), and the motion is fitted anew, beginning at
the best, for the rest, of all minima that were found: where these would prefer another minimum, the
answer was not safe, which no derivative tells. What the tilt may do is added in full.
"""

from __future__ import annotations

import numpy as np

from homeward.geometry.angles import wrap
from homeward.vision.cameras.panoramic import SECTORS, WINDOW, sector_of
from homeward.vision.geometry.epipolar import INLIER, Pairs, residuals
from homeward.vision.geometry.refinement import Fit, irls, prior_information, squares

SHARE = 0.25
"""Share of the inverse information, and of the jackknife's changes, that counts: without a window
so wide, the fit changes by more than it errs."""


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
    plain = np.linalg.inv(fit.information + 1e-4 * np.eye(5))  # regular, if nothing is known
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
    """Return which matches, at azimuths (n,), are left as each window in turn is left out.

    Shape (m, n), bool; windows in which none `counts`, (n,) bool, are skipped.
    """
    first = np.arange(SECTORS)[:, None]
    left_out = (sector_of(azimuth) - first) % SECTORS < WINDOW
    return np.asarray(~left_out[(left_out & counts).any(axis=1)])


def _starts(fit: Fit, pairs: Pairs, tilt_sigma: float, left: np.ndarray) -> np.ndarray:
    """Return, (m, 5), the minimum that fits each choice of matches best."""
    motions = np.vstack([fit.motion, fit.others])
    each = np.minimum(squares(residuals(motions, pairs)), INLIER**2)
    total = left @ each.T + np.sum((motions @ prior_information(tilt_sigma)) * motions, axis=1)
    return np.asarray(motions[np.argmin(total, axis=1)])
