"""Gauss-Newton fit of home to a set of inlier home bearings."""

from __future__ import annotations

import numpy as np

from homeward.localizer import kernels
from homeward.localizer.home.estimate import HomeFit
from homeward.localizer.home.problem import HomeProblem
from homeward.localizer.tunables import MAX_FIT_STEPS


def fit(
    problem: HomeProblem, home: np.ndarray, inliers: np.ndarray, steps: int = MAX_FIT_STEPS
) -> HomeFit | None:
    """Fit home (3,) to inlier home bearings (q,); None when they do not determine it.

    At most `steps` Gauss-Newton steps from `home`.
    """
    if np.count_nonzero(inliers) < problem.min_inliers:
        return None
    found = kernels.fit_home(problem.arrays, home, inliers, steps)
    if found is None:
        return None
    linear, solution = found
    now = HomeFit(problem, linear, inliers, solution)
    return now if problem.is_plausible(now.home) else None


def propagated(fit: HomeFit, problem: HomeProblem) -> HomeFit | None:
    """Return a fit after a negligible change of the map, with the old linearisation."""
    problem = problem.under(fit.problem.assumed)
    found = kernels.propagate_home(problem.arrays, fit.linear, fit.problem.mean, fit.inliers)
    if found is None:
        return None
    linear, solution = found
    fitted = fit.fitted or fit.linear
    return HomeFit(problem, linear, fit.inliers, solution, fit.inflation, fitted)


def solved(
    lead: HomeFit, inliers: np.ndarray, inflation: np.ndarray | None = None
) -> HomeFit | None:
    """Solve the problem of another fit, as linearised there, for inliers (q,).

    None when they do not determine home. `inflation` (3, 3) is that of `HomeFit`; evaluated lazily
    unless given.
    """
    solution = kernels.solve_set(lead.problem.arrays, lead.linear, inliers)
    if solution is None:
        return None
    return HomeFit(lead.problem, lead.linear, inliers, solution, inflation, lead.fitted)
