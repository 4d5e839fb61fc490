"""Variance component estimation of odometry noise (Helmert 1907, Foerstner 1979).

Residuals of motions are smaller than the errors, since poses follow them: the expected sum of their
squares, over the assumed variance, is not the number of motions but their redundancy. That is a
trace, estimated with random signs (Hutchinson 1990).

Part of the redundancy is due to bearing errors, to which the poses give way. Where bearings are
better than assumed (as where their noise is not given) that part is smaller, and odometry would
seem better than it is. So the variance of bearings is a component, too, and weights that part.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from homeward.localizer import kernels
from homeward.localizer.reference.extension import Unknown
from homeward.localizer.reference.factors import cauchy_weights
from homeward.localizer.reference.window import Linearised
from homeward.localizer.tunables import GATE, MAX_INFLATION

CHI_SQUARES = chdtri(3, (np.arange(64) + 0.5) / 64)
"""Quantiles of the squared Mahalanobis distance of a motion."""


class Misfit(NamedTuple):
    """Residuals of motions in a solved map, for shift and turn, each (2, 2).

    In the first row with robust weights; in the second unweighted, but bounded by the gate.
    """

    squares: np.ndarray
    """Sums of squared residuals over the assumed variances."""
    redundancies: np.ndarray
    """Their expectations."""


def misfit(
    given: Linearised, error: np.ndarray, own: np.ndarray, rng: np.random.Generator
) -> Misfit:
    """Compare the residuals of motions in a window at its solution with their expectation.

    `error` (m,) are the residuals of bearings over the standard deviations of single ones, `own`
    (m,) the shares of their own noise in their variances; the rest is from odometry [1]. `rng` is
    the source of the signs.
    """
    motions, clear, steps = given.motions, own >= MAX_INFLATION**-2.0, len(given.motions.error)
    covariance, weight = np.linalg.inv(motions.information), motions.weight[:, None, None]
    root = np.zeros_like(covariance)  # of the information on shift, and on turn
    root[:, :2, :2] = np.linalg.cholesky(np.linalg.inv(covariance[:, :2, :2])).transpose(0, 2, 1)
    root[:, 2, 2] = covariance[:, 2, 2] ** -0.5
    root *= np.sqrt(weight)
    # Errors with random signs, of bearings, shift and turn: the map absorbs a part of them.
    used = clear.size if clear.any() else 0
    drawn = rng.choice([-1.0, 1.0], used + 3 * steps)
    by_bearing, by_motion, signs = np.zeros((clear.size, 3)), root * 0.0, np.zeros((steps, 3, 2))
    by_bearing[clear, 0] = drawn[:used][clear[:used]]
    signs[:, :2, 0], signs[:, 2, 1] = drawn[used:-steps].reshape(-1, 2), drawn[-steps:]
    by_motion[:, :, 1:] = covariance @ (root.transpose(0, 2, 1) @ signs / weight)
    unknown = Unknown(by_bearing, np.zeros_like(given.seen.pose), np.zeros(3), by_motion)
    bearings, absorbed = kernels.extend(given, unknown, with_absorbed=True).absorbed

    overestimated = 1.0 - bearing_variance(error, by_bearing[:, 0], bearings[:, 0])
    free = signs * (signs - root @ absorbed[:, :, 1:])
    by_bearings = own @ bearings[:, 1:] ** 2 / np.maximum(free.sum(axis=(0, 1)), 1e-9)
    free *= 1.0 - overestimated * np.minimum(by_bearings, 1.0)
    square = (root @ motions.error[:, :, None]) ** 2 * signs**2
    squares = np.sum([weight * square, np.minimum(square / weight, GATE**2)], axis=(1, 2))
    redundancies = np.sum([weight * free, free], axis=(1, 2))
    redundancies[0] *= _robust_share(redundancies[1].sum() / motions.error.size)
    return Misfit(squares, redundancies)


def bearing_variance(error: np.ndarray, signs: np.ndarray, absorbed: np.ndarray) -> float:
    """Return the variance of bearings over the assumed one, 1 at most: `BearingNoise` finds more.

    From bearings with random `signs` (m,), of which the map absorbs some part (m,); 0: no part.
    """
    clear = signs != 0.0
    if not clear.any():
        return 1.0
    free = (signs - absorbed)[clear]
    redundancy, own = float(signs[clear] @ free), float(free @ free)
    squares = float(np.minimum(error[clear] ** 2, GATE**2).sum())
    return min(max((squares - (redundancy - own)) / own, 0.0), 1.0)


def _robust_share(redundancy: float) -> float:
    """Return the share of the squares of Gaussian motions that robust weights leave [1]."""
    squares = max(redundancy, 1e-3) * CHI_SQUARES
    weight = cauchy_weights(squares)
    return float((weight**2 * squares).mean() / (weight.mean() * squares.mean()))
