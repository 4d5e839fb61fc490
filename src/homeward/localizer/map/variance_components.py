"""Variance components of odometry: how far its noise is from what is believed (Foerstner 1979).

What the solved map leaves of a motion is smaller than the motion's error by as much as poses
followed it: the expected square of it, over the variance that is believed, is not the number of
motions but their redundancy, a trace, which is estimated with random signs (Hutchinson 1990).
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from homeward.localizer.map import elimination
from homeward.localizer.map.factors import OdometryErrors
from homeward.localizer.motion.preintegration import NC

PARTS = (slice(0, 2), slice(2, 3))
"""Of a motion: the way along and across, and the turn."""


class Misfit(NamedTuple):
    """What a solved map leaves of motions, shift and turn apart, each (2,)."""

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
    squares, redundancies = np.zeros(len(PARTS)), np.zeros(len(PARTS))
    for i, part in enumerate(PARTS):
        root = np.linalg.cholesky(np.linalg.inv(covariance[:, part, part]))
        root = root.transpose(0, 2, 1) * np.sqrt(steps.weight)[:, None, None]
        left = root @ steps.error[:, part, None]
        by_state = root @ steps.jacobian[:, part]
        signs = rng.choice([-1.0, 1.0], left.shape)
        fitted = _project(equations, by_state, signs)
        squares[i] = (left**2).sum()
        redundancies[i] = signs.size - (signs * fitted).sum()
    return Misfit(squares, redundancies)


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
