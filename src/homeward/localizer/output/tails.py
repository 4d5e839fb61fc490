"""Tails of a mixture: what its covariance lacks, for a Gaussian to be no surer than the mixture.

The second moment says how far off a mixture is in the mean, not how far off it may be: a part of
3 % that lies elsewhere is 5.7 standard deviations of the mixture away, where no Gaussian has 3 %.
So it is widened until `AGREES` deviations hold what they should hold, all but `FALSE_ALARM`, in the
directions of the parts and along the axes (overbounding, as of DeCleene, 2000, for integrity).
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri

from homeward.localizer.tunables import AGREES, FALSE_ALARM

HALVINGS = 8
"""Of the bounds between which a quantile is sought: it is found to 0.5 % of a deviation."""


def missing_tails(
    off: np.ndarray, weights: np.ndarray, covariances: np.ndarray, covariance: np.ndarray
) -> np.ndarray | None:
    """Return what must be added to a mixture's covariance; None where nothing lacks.

    Parameters
    ----------
    off : ndarray, shape (k, n)
        The parts of the mixture, from its middle.
    weights : ndarray, shape (k,)
        Of them; their sum is one.
    covariances : ndarray, shape (k, n, n)
        Of them.
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
    at, sigma = towards @ off.T, np.sqrt(((towards @ covariances) * towards).sum(axis=2)).T
    lacks = _beyond(np.full(len(at), AGREES), at, sigma, weights) > FALSE_ALARM
    if not lacks.any():
        return None
    towards, quantile = towards[lacks], _quantile(at[lacks], sigma[lacks], weights)
    wide = unit.copy()
    for i in np.argsort(-quantile).tolist():
        along = wide @ towards[i]
        variance, needed = float(towards[i] @ along), (quantile[i] / AGREES) ** 2
        if needed > variance:
            wide += (needed - variance) / variance**2 * along[:, None] * along
    return np.asarray(root @ (wide - unit) @ root.T)


def _quantile(at: np.ndarray, sigma: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return how far mixtures on lines (u,) reach, but for `FALSE_ALARM`; see `_beyond`."""
    # One part alone reaches so far; and all together no farther than if each had its share of that.
    alone, share = FALSE_ALARM / weights, 0.5 * FALSE_ALARM / (weights.size * weights)
    near, far = (
        (np.abs(at) - sigma * ndtri(np.minimum(p, 1.0))).max(axis=1) for p in (alone, share)
    )
    for _ in range(HALVINGS):
        middle = 0.5 * (near + far)
        reaches = _beyond(middle, at, sigma, weights) > FALSE_ALARM
        near, far = np.where(reaches, middle, near), np.where(reaches, far, middle)
    return np.asarray(far)


def _beyond(
    limit: np.ndarray, at: np.ndarray, sigma: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Return how much of mixtures on lines lies beyond a limit (u,) to both sides, shape (u,).

    Their parts are Gaussians of `weights` (k,), `at` and with `sigma`, both (u, k).
    """
    both = np.stack([at, -at]) - limit[:, None]
    return np.asarray(ndtr(both / sigma).sum(axis=0) @ weights)
