"""The motion between two panoramas, refined robustly, with an honest covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.angles import wrap
from homeward.vision.epipolar import Motion, Pairs, Residuals, derivative_noise, residuals

SCALES = (12.0, 6.0, 3.0, 3.0, 3.0, 3.0)
"""Of the robust loss [standard deviations], step by step: from forgiving to strict."""
INLIER = 3.0
"""A match fits within this many standard deviations."""

MOST_RATIO = 100.0
"""A single match with much parallax does not speak for all."""


@dataclass(frozen=True)
class Fit:
    """A motion, and what supports it."""

    motion: Motion
    inlier: np.ndarray
    """(n,) bool"""
    cost: float
    """MSAC cost over all matches, prior included."""
    information: np.ndarray
    """(5, 5): of the motion, were all errors independent and as large as assumed."""
    rows: np.ndarray
    """(n, 5): Jacobian of each match's residual, times the root of its weight."""
    residuals: np.ndarray
    """(n,): normalised residuals, times the root of their weights."""


def refine(starts: np.ndarray, pairs: Pairs, tilt_sigma: float) -> Fit:
    """Fit a motion to matches by iteratively reweighted least squares, from several starts.

    Parameters
    ----------
    starts : ndarray, shape (m, 5)
        Motions to begin from, all at once.
    pairs : Pairs
        All matches, wrong ones among them.
    tilt_sigma : float
        How far each camera may be tilted from what is known [rad].

    Returns
    -------
    Fit
        The one of least cost.
    """
    prior = prior_information(tilt_sigma)
    x = np.array(starts)
    for scale in SCALES:
        found = residuals(x, pairs)
        weighted = (found.jacobian * _weight(found, scale)[..., None]).swapaxes(1, 2)
        normal = weighted @ found.jacobian + prior + 1e-9 * np.eye(5)
        gradient = (weighted @ found.value[..., None])[..., 0] + x @ prior
        step = np.linalg.solve(normal, gradient[..., None])[..., 0]
        # Where home is near, theta is hardly determined: no wild turns on the way.
        x = x - np.clip(step, -0.3, 0.3)
    x[:, :2] = wrap(x[:, :2])
    found = residuals(x, pairs)
    total = cost(found) + np.sum((x @ prior) * x, axis=1)
    best = int(np.argmin(total))
    return _judged(
        x[best], pairs, Residuals(*(part[best] for part in found)), float(total[best]), prior
    )


def prior_information(tilt_sigma: float) -> np.ndarray:
    """Return the information, (5, 5), that both cameras are upright and at one height."""
    known = 1.0 / (2.0 * tilt_sigma**2)
    return np.diag([0.0, 0.0, known, known, known])


def cost(found: Residuals) -> np.ndarray:
    """Return the MSAC cost of each motion, (m,): squared residuals, at most `INLIER`^2 each."""
    return np.asarray(np.minimum(squares(found), INLIER**2).sum(axis=-1))


def squares(found: Residuals) -> np.ndarray:
    """Return the squared residuals; infinite for impossible matches."""
    return np.where(found.possible, found.value**2, np.inf)


def _judged(x: np.ndarray, pairs: Pairs, found: Residuals, total: float, prior: np.ndarray) -> Fit:
    inlier = squares(found) <= INLIER**2
    root = np.sqrt(_weight(found, SCALES[-1]) * inlier)
    rows = found.jacobian * root[:, None] * _beyond_noise(x, pairs, found.jacobian, root**2)
    return Fit(
        motion=Motion(*x.tolist()),
        inlier=inlier,
        cost=total,
        information=rows.T @ rows + prior,
        rows=rows,
        residuals=found.value * root,
    )


def _beyond_noise(
    x: np.ndarray, pairs: Pairs, jacobian: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """Return the factor, (5,), for each column of the Jacobian that leaves out what noise made.

    Near home there is no parallax, but noise looks like it, and seems to tell a direction.
    """
    factor = np.ones(5)
    for column, noise in zip((0, 4), derivative_noise(Motion(*x), pairs), strict=True):
        ratio = np.minimum(jacobian[:, column] ** 2 / noise, MOST_RATIO)
        mean = float(weight @ ratio) / max(float(weight.sum()), 1e-12)
        # About one for mere noise, and somewhat more since theta is where noise fits best.
        factor[column] = np.sqrt(max(0.0, 1.0 - 2.0 / max(mean, 1e-12)))
    return factor


def _weight(found: Residuals, scale: float) -> np.ndarray:
    """Return Geman and McClure's weights; impossible matches do not count."""
    return np.asarray(found.possible / (1.0 + (found.value / scale) ** 2) ** 2)
