"""Cluster jackknife: the covariance of a motion, from leaving out one window of azimuth at a time.

The inverse of the information assumes independent errors of matches; it was half of the true error.
Errors of features on one object are correlated, most of all when it has moved along the epipolar
line. A sandwich estimate does not detect that, since the fit follows the few. So windows of azimuth
of the width of a large object are left out in turn (MacKinnon, Nielsen and Webb, J. Appl.
Econometrics 2023; overlapping windows: Kuensch, Ann. Statist. 1989), and the motion is fitted
again, starting from the minimum that is best for the remaining matches. If that is another minimum,
the result was uncertain, which no derivative shows. The effect of tilt is added in full.
"""

from __future__ import annotations

import numpy as np

from homeward.geometry.angles import wrap
from homeward.vision.cameras.panoramic import SECTORS, WINDOW, sector_of
from homeward.vision.geometry.epipolar import INLIER, Pairs, residuals
from homeward.vision.geometry.refinement import Fit, irls, prior_information, squares

SHARE = 0.25
"""Weight of the inverse information and of the jackknife's changes: leaving out a window this wide
changes the fit by more than its error."""


def jackknife_covariance(fit: Fit, pairs: Pairs, tilt_sigma: float) -> np.ndarray:
    """Return the covariance (5, 5) of a motion fitted to all matches.

    `tilt_sigma` is the standard deviation of each camera's tilt [rad].
    """
    plain = np.linalg.inv(fit.information + 1e-4 * np.eye(5))  # regular even without information
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
    """Return which matches, at azimuths (n,), remain without each window in turn: (m, n) bool.

    Windows in which none `counts`, (n,) bool, are skipped.
    """
    first = np.arange(SECTORS)[:, None]
    left_out = (sector_of(azimuth) - first) % SECTORS < WINDOW
    return np.asarray(~left_out[(left_out & counts).any(axis=1)])


def _starts(fit: Fit, pairs: Pairs, tilt_sigma: float, left: np.ndarray) -> np.ndarray:
    """Return the minimum, (m, 5), that fits each selection of matches best."""
    motions = np.vstack([fit.motion, fit.others])
    each = np.minimum(squares(residuals(motions, pairs)), INLIER**2)
    total = left @ each.T + np.sum((motions @ prior_information(tilt_sigma)) * motions, axis=1)
    return np.asarray(motions[np.argmin(total, axis=1)])
