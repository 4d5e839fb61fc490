"""The motion between two panoramas, refined robustly, with an honest covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.angles import wrap
from homeward.vision.epipolar import Motion, Pairs, Residuals, residuals

SCALES = (12.0, 6.0, 3.0, 3.0, 3.0, 3.0)
"""Of the robust loss [standard deviations], step by step: from forgiving to strict."""
INLIER = 3.0
"""A match fits within this many standard deviations."""


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


def refine(start: Motion, pairs: Pairs, tilt_sigma: float) -> Fit:
    """Fit a motion to matches by iteratively reweighted least squares.

    Parameters
    ----------
    start : Motion
        Where to begin.
    pairs : Pairs
        All matches, wrong ones among them.
    tilt_sigma : float
        How far each camera may be tilted from what is known [rad].
    """
    prior = prior_information(tilt_sigma)
    x = np.array(start)
    for scale in SCALES:
        found = residuals(Motion(*x), pairs)
        weight = _weight(found, scale)
        weighted = found.jacobian * weight[:, None]
        normal = weighted.T @ found.jacobian + prior
        step = np.linalg.solve(normal + 1e-9 * np.eye(5), weighted.T @ found.value + prior @ x)
        # Where home is near, theta is hardly determined: no wild turns on the way.
        x = x - np.clip(step, -0.3, 0.3)
    x[:2] = wrap(x[:2])
    return _judged(Motion(*x.tolist()), pairs, prior)


def prior_information(tilt_sigma: float) -> np.ndarray:
    """Return the information, (5, 5), that both cameras are upright and at one height."""
    known = 1.0 / (2.0 * tilt_sigma**2)
    return np.diag([0.0, 0.0, known, known, known])


def cost(found: Residuals) -> float:
    """Return the MSAC cost of residuals: their squares, at most `INLIER`^2 each."""
    return float(np.minimum(squares(found), INLIER**2).sum())


def squares(found: Residuals) -> np.ndarray:
    """Return the squared residuals, (n,); infinite for impossible matches."""
    return np.where(found.possible, found.value**2, np.inf)


def _judged(motion: Motion, pairs: Pairs, prior: np.ndarray) -> Fit:
    found = residuals(motion, pairs)
    inlier = squares(found) <= INLIER**2
    root = np.sqrt(_weight(found, SCALES[-1]) * inlier)
    rows = found.jacobian * root[:, None]
    x = np.array(motion)
    return Fit(
        motion=motion,
        inlier=inlier,
        cost=cost(found) + float(x @ prior @ x),
        information=rows.T @ rows + prior,
        rows=rows,
        residuals=found.value * root,
    )


def _weight(found: Residuals, scale: float) -> np.ndarray:
    """Return Geman and McClure's weights; impossible matches do not count."""
    return np.asarray(found.possible / (1.0 + (found.value / scale) ** 2) ** 2)
