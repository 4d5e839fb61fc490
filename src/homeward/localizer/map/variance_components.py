"""Variance components of odometry: how far its noise is from what is believed (Foerstner 1979).

What the solved map leaves of a motion is smaller than the motion's error by as much as poses
followed it: the expected square of it, over the variance that is believed, is not the number of
motions but their redundancy, a trace, which is estimated with random signs (Hutchinson 1990).
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from homeward.localizer.map import elimination
from homeward.localizer.map.factors import OdometryErrors, cauchy_weights
from homeward.localizer.motion.preintegration import NC
from homeward.localizer.tunables import GATE

CHI_SQUARES = chdtri(3, (np.arange(64) + 0.5) / 64)
"""Quantiles of the squared Mahalanobis error of a motion."""
PARTS = (slice(0, 2), slice(2, 3))
"""Of a motion: the way along and across, and the turn."""


class Misfit(NamedTuple):
    """What a solved map leaves of motions, shift and turn apart, each (2, 2).

    By their weights in the first row; in the second all alike, but for what is absurd.
    """

    squares: np.ndarray
    """Sums of their squares over the variances that are believed."""
    redundancies: np.ndarray
    """What these are expected to be."""


def misfit(
    equations: elimination.NormalEquations, steps: OdometryErrors, rng: np.random.Generator
) -> Misfit:
    """Compare what is left of motions with what is expected to be left.

    Parameters
    ----------
    equations : NormalEquations
        Of w poses and what they share, around the solution.
    steps : OdometryErrors
        The w - 1 motions between them.
    rng : numpy.random.Generator
        For the signs.
    """
    covariance = np.linalg.inv(steps.information)
    squares, redundancies = np.zeros((2, len(PARTS))), np.zeros((2, len(PARTS)))
    weight = steps.weight[:, None, None]
    for i, part in enumerate(PARTS):
        root = np.linalg.cholesky(np.linalg.inv(covariance[:, part, part]))
        root = root.transpose(0, 2, 1) * np.sqrt(weight)
        left = (root @ steps.error[:, part, None]) ** 2
        by_state = root @ steps.jacobian[:, part]
        signs = rng.choice([-1.0, 1.0], left.shape)
        free = signs * (signs - _project(equations, by_state, signs))
        squares[:, i] = (weight * left).sum(), np.minimum(left / weight, GATE**2).sum()
        redundancies[:, i] = (weight * free).sum(), free.sum()
    redundancies[0] *= _kept(redundancies[1].sum() / steps.error.size)
    return Misfit(squares, redundancies)


def _kept(redundancy: float) -> float:
    """Return the share that weights leave of the squares of Gaussian motions, so redundant [1]."""
    left = max(redundancy, 1e-3) * CHI_SQUARES
    weight = cauchy_weights(left)
    return float((weight**2 * left).mean() / (weight.mean() * left.mean()))


def _project(
    equations: elimination.NormalEquations, by_state: np.ndarray, errors: np.ndarray
) -> np.ndarray:
    """Return what the state takes up of errors (k, i, 1) of motions, as (k, i, 1)."""
    pulled = (by_state.transpose(0, 2, 1) @ errors)[:, :, 0]
    slope, common = np.zeros_like(equations.slope), np.zeros_like(equations.common_slope)
    slope[:-1] += pulled[:, :3]
    slope[1:] += pulled[:, 3:6]
    common[:NC] = pulled[:, 6:].sum(axis=0)
    pulling = dataclasses.replace(equations, slope=slope, common_slope=common)
    poses, shared, _ = elimination.solve(pulling)
    step = np.concatenate([poses[:-1], poses[1:], np.tile(shared[:NC], (len(errors), 1))], axis=1)
    return np.asarray(by_state @ step[:, :, None])
