"""Gauss-Newton fit of home to a set of inlier home bearings."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg.lapack import dposv

from homeward.localizer.home.estimate import HomeFit
from homeward.localizer.home.linearisation import HOME, RESIDUAL, Linear, linearised, whitened
from homeward.localizer.home.problem import HomeProblem

STEPS = 6
"""Most homes come to rest after three or four; one that has not by then wanders."""
SETTLED = 1e-4
"""A step of home smaller than this ends the iteration [of the longest one]."""


def fit(
    problem: HomeProblem, home: np.ndarray, inliers: np.ndarray, steps: int = STEPS
) -> HomeFit | None:
    """Fit home to a set of right home bearings; None when they do not fix it.

    Parameters
    ----------
    problem : HomeProblem
        What is known.
    home : ndarray, shape (3,)
        Where to start.
    inliers : ndarray, shape (q,), bool
        The set.
    steps : int
        Gauss-Newton steps at most.
    """
    if np.count_nonzero(inliers) < problem.fewest:
        return None
    known, now = problem.mean, None
    for _ in range(steps):
        now = solved(linearised(problem, home, known), inliers)
        if now is None or problem.length(now.step) < SETTLED:
            break
        home, known = now.home, now.known
    return now if now is not None and problem.is_near(now.home) else None


def propagated(fit: HomeFit, problem: HomeProblem) -> HomeFit | None:
    """Return a fit after what is known has changed by next to nothing, linearised as before."""
    problem = problem.with_noise(fit.problem.noise_scale)
    return solved(fit.linear.propagated(problem), fit.inliers, fit.inflation)


def solved(
    linear: Linear, inliers: np.ndarray, inflation: np.ndarray | None = None
) -> HomeFit | None:
    """Return home where everything is linear; None when the set does not fix it.

    Parameters
    ----------
    linear : Linear
        The home bearings.
    inliers : ndarray, shape (q,), bool
        The set of right ones.
    inflation : ndarray, shape (3, 3), optional
        See `HomeFit.inflation`; worked out when asked for unless it is known.
    """
    problem, of_set = linear.problem, whitened(linear, inliers)
    if of_set is None:
        return None
    information = problem.before + of_set.products[HOME, HOME]
    slope = of_set.products[HOME, RESIDUAL]
    if problem.prior is not None:
        slope = slope + problem.before @ problem.off_prior(linear.at)
    _, step, failed = dposv(information, slope)
    if failed or not math.isfinite(step @ step):
        return None
    step = step / max(1.0, problem.length(step))
    return HomeFit(linear, inliers, step, of_set, information, inflation)
