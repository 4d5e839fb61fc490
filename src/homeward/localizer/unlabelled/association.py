"""Association of bearings with predicted bearings, jointly: the least ambiguous pair first.

After each pair, the prediction is conditioned on it (sequential joint compatibility; Neira and
Tardos, 2001). A pair that is not better than its rivals by a margin is held back, with its rivals.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from homeward.geometry.angles import wrap
from homeward.localizer.tunables import ASSOCIATION_GATE, ASSOCIATION_MARGIN, CLEAR_MARGIN


class Forecast(NamedTuple):
    """Predicted bearings of n landmarks."""

    mean: np.ndarray
    """(n,) [rad]"""
    covariance: np.ndarray
    """(n, n): of the predictions alone [rad^2]."""

    def conditioned(self, of: np.ndarray, bearings: np.ndarray, variances: np.ndarray) -> Forecast:
        """Return it after bearings (k,) of the landmarks `of` (k,), with their variances."""
        across = self.covariance[:, of]
        known = across[of] + np.diag(variances)
        gain = np.linalg.solve(known, across.T).T
        mean = self.mean + gain @ wrap(bearings - self.mean[of])
        return Forecast(mean, self.covariance - gain @ across.T)

    def squares(self, bearings: np.ndarray, variances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return squared normalised innovations and their variances, (m, n) each."""
        variance = np.maximum(self.covariance.diagonal(), 0.0) + variances[:, None]
        return wrap(bearings[:, None] - self.mean) ** 2 / variance, variance


class Association(NamedTuple):
    """Landmarks of m bearings."""

    landmark: np.ndarray
    """(m,), int: index of its landmark, -1 for none."""
    is_held: np.ndarray
    """(m,), bool: whether it has several possible landmarks."""
    forecast: Forecast
    """The forecast after these bearings."""


def associate(
    forecast: Forecast,
    bearings: np.ndarray,
    variances: np.ndarray,
    allowed: np.ndarray,
    penalty: np.ndarray | float = 0.0,
) -> Association:
    """Associate bearings (m,) with landmarks; `allowed` (m, n), bool: which pairs may be.

    `penalty` (n,) is twice the negative log probability that a landmark is seen, relative to one
    that was seen just before.
    """
    m = len(allowed)
    landmark, held = np.full(m, -1), np.zeros(m, bool)
    open_pairs = allowed.copy()
    while open_pairs.any():
        cost = _costs(forecast, bearings, variances, open_pairs) + penalty
        best, margins = _best_pairs(cost)
        if not np.isfinite(margins).any() and not (margins == np.inf).any():
            break
        clear = np.flatnonzero(margins > CLEAR_MARGIN)
        if not clear.size:
            row = int(margins.argmax())
            if margins[row] < ASSOCIATION_MARGIN:
                held = np.isfinite(cost).any(axis=1) & (landmark < 0)
                break
            clear = np.array([row])
        elif clear.size > 1 and not _is_compatible(forecast, best, bearings, variances, clear):
            clear = clear[[int(cost[clear, best[clear]].argmin())]]
        landmark[clear] = best[clear]
        forecast = forecast.conditioned(best[clear], bearings[clear], variances[clear])
        open_pairs[clear] = False
        open_pairs[:, best[clear]] = False
    return Association(landmark, held, forecast)


def _costs(
    forecast: Forecast, bearings: np.ndarray, variances: np.ndarray, allowed: np.ndarray
) -> np.ndarray:
    """Return twice the negative log likelihood ratios (m, n), infinite outside the gate."""
    squares, variance = forecast.squares(bearings, variances)
    cost = squares + np.log(variance / variances[:, None])
    cost[(squares > ASSOCIATION_GATE**2) | ~allowed] = np.inf
    return np.asarray(cost)


def _best_pairs(cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the best landmark of each bearing, (m,), and its margin over rivals, (m,).

    A rival is another landmark of the bearing, or another bearing of the landmark. The margin is
    minus infinity where no landmark is possible.
    """
    rows, best = np.arange(len(cost)), cost.argmin(axis=1)
    lowest = cost[rows, best]
    others = cost.copy()
    others[rows, best] = np.inf
    rival = others.min(axis=1)
    own = cost[:, best].T  # of each bearing: the costs of its best landmark
    own[rows, rows] = np.inf
    rival = np.minimum(rival, own.min(axis=1))
    possible = np.isfinite(lowest)
    margins = np.full(len(cost), -np.inf)
    margins[possible] = rival[possible] - lowest[possible]
    return best, margins


def _is_compatible(
    forecast: Forecast,
    best: np.ndarray,
    bearings: np.ndarray,
    variances: np.ndarray,
    rows: np.ndarray,
) -> bool:
    """Return whether several pairs are jointly compatible."""
    of = best[rows]
    if np.unique(of).size < of.size:
        return False
    off = wrap(bearings[rows] - forecast.mean[of])
    covariance = forecast.covariance[np.ix_(of, of)] + np.diag(variances[rows])
    square = float(off @ np.linalg.solve(covariance, off))
    return bool(square < of.size + ASSOCIATION_GATE * np.sqrt(2.0 * of.size))
