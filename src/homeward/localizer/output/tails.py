"""Overbounding of a Gaussian mixture (DeCleene, 2000): no lighter tails than the mixture has.

The second moment of a mixture is its mean squared error, not a bound: a component of 3 % that lies
elsewhere is 5.7 standard deviations of the mixture away, where no Gaussian has 3 %. So the
covariance is inflated until `INLIER` deviations contain all but `FALSE_ALARM` of the mixture,
towards each of its components and along the axes.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri

from homeward.geometry.covariance import ROUNDING
from homeward.localizer.tunables import FALSE_ALARM, INLIER, NUM_HALVINGS


def missing_tails(
    off: np.ndarray, weights: np.ndarray, covariances: np.ndarray, covariance: np.ndarray
) -> np.ndarray | None:
    """Return what must be added to a mixture's covariance to bound its tails; None if nothing.

    Parameters
    ----------
    off : ndarray, shape (k, n)
        Means of the components, from the centre of the mixture.
    weights : ndarray, shape (k,)
        Their probabilities; they sum to one.
    covariances : ndarray, shape (k, n, n)
        Of the components.
    covariance : ndarray, shape (n, n)
        Of the mixture: its second moment.

    Raises
    ------
    numpy.linalg.LinAlgError
        When the covariance is not positive definite.
    """
    root, unit = np.linalg.cholesky(covariance), np.eye(len(covariance))
    whiten = np.linalg.solve(root, unit)
    off, covariances = off @ whiten.T, whiten @ covariances @ whiten.T
    away = np.sqrt((off * off).sum(axis=1))
    apart = away > 1.0
    towards = np.concatenate([unit, off[apart] / away[apart, None]])
    # Whitened, the mixture has unit variance: a component's below its rounding may be negative.
    variances = np.maximum(((towards @ covariances) * towards).sum(axis=2), ROUNDING)
    at, sigma = towards @ off.T, np.sqrt(variances).T
    lacks = _beyond(np.full(len(at), INLIER), at, sigma, weights) > FALSE_ALARM
    if not lacks.any():
        return None
    towards, quantile = towards[lacks], _quantile(at[lacks], sigma[lacks], weights)
    wide = unit.copy()
    for i in np.argsort(-quantile).tolist():
        along = wide @ towards[i]
        variance, needed = float(towards[i] @ along), (quantile[i] / INLIER) ** 2
        if needed > variance:
            wide += (needed - variance) / variance**2 * along[:, None] * along
    return np.asarray(root @ (wide - unit) @ root.T)


def _quantile(at: np.ndarray, sigma: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the two-sided `FALSE_ALARM` quantiles of mixtures on a line (u,); see `_beyond`."""
    # Bounds: each component alone, and all of them if each had its share of the probability.
    alone, share = FALSE_ALARM / weights, 0.5 * FALSE_ALARM / (weights.size * weights)
    near, far = (
        (np.abs(at) - sigma * ndtri(np.minimum(p, 1.0))).max(axis=1) for p in (alone, share)
    )
    for _ in range(NUM_HALVINGS):
        middle = 0.5 * (near + far)
        reaches = _beyond(middle, at, sigma, weights) > FALSE_ALARM
        near, far = np.where(reaches, middle, near), np.where(reaches, far, middle)
    return np.asarray(far)


def _beyond(
    limit: np.ndarray, at: np.ndarray, sigma: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Return the probability (u,) of one-dimensional mixtures beyond a limit (u,) to both sides.

    Their components are Gaussians with `weights` (k,), at `at` and with `sigma`, both (u, k).
    """
    both = np.stack([at, -at]) - limit[:, None]
    return np.asarray(ndtr(both / sigma).sum(axis=0) @ weights)
