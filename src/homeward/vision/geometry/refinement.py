"""Motion by iteratively reweighted least squares, with Geman and McClure's loss; its covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from homeward import core
from homeward.geometry.angles import wrap
from homeward.geometry.statistics import GNC_SCHEDULE, robust_loss, robust_weight
from homeward.vision.cameras.panoramic import SECTORS, WINDOW, sector_of
from homeward.vision.geometry.epipolar import (
    INLIER,
    LIMITS,
    Motion,
    Pairs,
    Residuals,
    derivative_noise,
    residuals,
)

SCHEDULE = (*GNC_SCHEDULE, 0.0)
"""Additional error of directions in each iteration, as a share of the tilt's sigma [1]."""
MAX_STEP = 0.3
"""Maximum change of an angle in one iteration [rad]: near home, theta is poorly determined."""
SAME = 0.002
"""Motions whose theta and alpha differ by less are the same [rad]."""
MAX_OTHERS = 5
"""Maximum number of other minima that are kept, those of least loss."""


@dataclass(frozen=True)
class Fit:
    """A motion and its inliers."""

    motion: Motion
    inlier: np.ndarray
    """(n,) bool"""
    information: np.ndarray
    """(5, 5): of the motion, assuming independent errors."""
    parallax: float
    """Squared parallax of the inliers over that from noise: 1 to 3 for two images from the same
    position, since theta fits noise, too."""
    scale: float
    """Of the robust loss [standard deviations]."""
    others: np.ndarray = field(default_factory=lambda: np.empty((0, 5)))
    """(m, 5): other minima, that of least loss first."""


def refine(starts: np.ndarray, pairs: Pairs, tilt_sigma: float, scale: float = INLIER) -> Fit:
    """Fit a motion to all matches from several starts, as `irls`; return the fit of least loss."""
    prior = prior_information(tilt_sigma)
    x = irls(starts, pairs, tilt_sigma, scale)
    found = residuals(x, pairs)
    order = np.argsort(_loss(found, scale) + np.sum((x @ prior) * x, axis=1), kind="stable")
    best = Residuals(*(part[order[0]] for part in found))
    fit = _fit(x[order[0]], pairs, best, prior, scale)
    return replace(fit, others=_distinct(x[order])[1 : 1 + MAX_OTHERS])


def _distinct(motions: np.ndarray) -> np.ndarray:
    """Return the motions, (k, 5), that differ from all before."""
    apart = np.abs(wrap(motions[:, None, :2] - motions[:, :2])).max(axis=2)
    return np.asarray(motions[~np.tril(apart < SAME, -1).any(axis=1)])


def irls(
    starts: np.ndarray,
    pairs: Pairs,
    tilt_sigma: float,
    scale: float,
    counts: np.ndarray | float = 1.0,
) -> np.ndarray:
    """Fit motions, (m, 5), by iteratively reweighted least squares, each from its own start.

    The n pairs contain wrong matches; `counts`, (m, n) or 1, is the weight of each in each fit.
    `tilt_sigma` is the standard deviation of each camera's tilt [rad], `scale` that of the robust
    loss [standard deviations].
    """
    x = np.array(starts, float, order="C")
    if not _irls_compiled(x, pairs, tilt_sigma, scale, counts):
        x = _irls(np.array(starts), pairs, tilt_sigma, scale, counts)
    x[:, :2] = wrap(x[:, :2])
    return x


def _irls(
    x: np.ndarray, pairs: Pairs, tilt_sigma: float, scale: float, counts: np.ndarray | float
) -> np.ndarray:
    """Do the same as `irls` in NumPy."""
    prior = prior_information(tilt_sigma)
    for looseness in SCHEDULE:
        found = residuals(x, pairs, looseness * tilt_sigma)
        weight = _weight(found, scale) * counts
        weighted = (found.jacobian * weight[..., None]).swapaxes(1, 2)
        normal = weighted @ found.jacobian + prior + 1e-9 * np.eye(5)
        gradient = (weighted @ found.value[..., None])[..., 0] + x @ prior
        step = np.linalg.solve(normal, gradient[..., None])[..., 0]
        x = x - np.clip(step, -MAX_STEP, MAX_STEP)
    return x


def _irls_compiled(
    x: np.ndarray, pairs: Pairs, tilt_sigma: float, scale: float, counts: np.ndarray | float
) -> bool:
    """Do the same as `irls` in place, in compiled code; return False without a result."""
    if core.compiled is None:
        return False
    counted = np.zeros((len(x), pairs.columns.shape[1]))
    counted[:, : len(pairs)] = counts
    looseness = np.array(SCHEDULE) * tilt_sigma
    prior = np.diag(prior_information(tilt_sigma)).copy()
    given = (pairs.columns, counted, looseness, prior, scale, MAX_STEP, LIMITS)
    return bool(core.compiled.irls(x, *given))


def prior_information(tilt_sigma: float) -> np.ndarray:
    """Return the information, (5, 5), that both cameras are upright and at the same height."""
    known = 1.0 / (2.0 * tilt_sigma**2)
    return np.diag([0.0, 0.0, known, known, known])


def squares(found: Residuals) -> np.ndarray:
    """Return the squared residuals; infinite for impossible matches."""
    return np.where(found.possible, found.value**2, np.inf)


def _fit(x: np.ndarray, pairs: Pairs, found: Residuals, prior: np.ndarray, scale: float) -> Fit:
    inlier = squares(found) <= INLIER**2
    root = np.sqrt(_weight(found, scale) * inlier)
    by_theta, by_vertical = (
        _beyond_noise(found.jacobian[:, column], noise, root**2)
        for column, noise in zip((0, 4), derivative_noise(Motion(*x), pairs), strict=True)
    )
    # Near home there is no parallax, but noise looks like it, and seems to determine a direction.
    factor = np.ones(5)
    for column, ratio in ((0, by_theta), (4, by_vertical)):
        factor[column] = math.sqrt(max(0.0, 1.0 - 2.0 / max(ratio, 1e-12)))
    rows = found.jacobian * root[:, None] * factor
    return Fit(
        motion=Motion(*x.tolist()),
        inlier=inlier,
        information=rows.T @ rows + prior,
        parallax=by_theta,
        scale=scale,
    )


def _beyond_noise(jacobian: np.ndarray, noise: np.ndarray, weight: np.ndarray) -> float:
    """Return the mean square of a column of the Jacobian over that from noise alone."""
    ratio = np.minimum(jacobian**2 / noise, 100.0)  # a single match is no evidence of parallax
    return float(weight @ ratio) / max(float(weight.sum()), 1e-12)


def _loss(found: Residuals, scale: float) -> np.ndarray:
    """Return the loss of each motion, (m,), that `irls` minimises; 1 for an impossible match."""
    losses = np.where(found.possible, robust_loss((found.value / scale) ** 2), 1.0)
    return np.asarray(scale**2 * losses.sum(axis=-1))


def _weight(found: Residuals, scale: float) -> np.ndarray:
    """Return the robust weights; impossible matches do not count."""
    return np.asarray(found.possible * robust_weight((found.value / scale) ** 2))


SHARE = 0.25
"""Weight of the inverse information and of the jackknife's changes: leaving out a window this wide
changes the fit by more than its error."""


def jackknife_covariance(fit: Fit, pairs: Pairs, tilt_sigma: float) -> np.ndarray:
    """Return the covariance (5, 5) of a motion fitted to all matches, by a cluster jackknife.

    The inverse of the information assumes independent errors of matches; it was half of the true
    error. Errors of features on one object are correlated, most of all when it has moved along the
    epipolar line. A sandwich estimate does not detect that, since the fit follows the few. So
    windows of azimuth of the width of a large object are left out in turn (MacKinnon, Nielsen and
    Webb, J. Appl. Econometrics 2023; overlapping windows: Kuensch, Ann. Statist. 1989), and the
    motion is fitted again, starting from the minimum that is best for the remaining matches. If
    that is another minimum, the result was uncertain, which no derivative shows. The effect of tilt
    is added in full.
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
