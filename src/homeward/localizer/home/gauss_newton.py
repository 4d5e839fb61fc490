"""Gauss-Newton fit of home to a set of inlier home bearings."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg.lapack import dposv

from homeward.localizer.home.estimate import HomeFit
from homeward.localizer.home.linearisation import HOME, RESIDUAL, Linear, linearised, whitened
from homeward.localizer.home.problem import HomeProblem
from homeward.localizer.home.spurious_information import position_root
from homeward.localizer.tunables import FIT_CONVERGED, MAX_FIT_STEPS


def fit(
    problem: HomeProblem, home: np.ndarray, inliers: np.ndarray, steps: int = MAX_FIT_STEPS
) -> HomeFit | None:
    """Fit home (3,) to inlier home bearings (q,); None when they do not determine it.

    At most `steps` Gauss-Newton steps from `home`.
    """
    if np.count_nonzero(inliers) < problem.min_inliers:
        return None
    state, now = problem.mean, None
    for _ in range(steps):
        now = solved(linearised(problem, home, state), inliers)
        if now is None or problem.step_length(now.step) < FIT_CONVERGED:
            break
        home, state = now.home, now.state
    return now if now is not None and problem.is_plausible(now.home) else None


def propagated(fit: HomeFit, problem: HomeProblem) -> HomeFit | None:
    """Return a fit after a negligible change of the map, with the old linearisation."""
    problem = problem.under(fit.problem.assumed)
    return solved(fit.linear.propagated(problem), fit.inliers, fit.inflation)


def solved(
    linear: Linear, inliers: np.ndarray, inflation: np.ndarray | None = None
) -> HomeFit | None:
    """Solve the linearised problem for inliers (q,); None when they do not determine home.

    `inflation` (3, 3) is that of `HomeFit`; evaluated lazily unless given.
    """
    problem, of_set = linear.problem, whitened(linear, inliers)
    if of_set is None:
        return None
    information = problem.initial_information + of_set.products[HOME, HOME]
    slope = of_set.products[HOME, RESIDUAL]
    if problem.prior is not None:
        slope = slope + problem.initial_information @ problem.prior_offset(linear.at)
    _, step, failed = dposv(information, slope)
    if failed or not math.isfinite(step @ step) or position_root(information) is None:
        return None
    step = step / max(1.0, problem.step_length(step))
    return HomeFit(linear, inliers, step, of_set, information, inflation)
