"""Fitting home to a set of right home bearings, by Gauss-Newton."""

from __future__ import annotations

import numpy as np

from homeward.angles import wrap
from homeward.localizer.compiled import address, compiled
from homeward.localizer.home import HomeFit
from homeward.localizer.linear import Linear, linearised
from homeward.localizer.problem import HomeProblem

STEPS = 6
SETTLED = 1e-4
"""A step of home smaller than this ends the iteration [m or rad]."""
LONGEST_STEP_M = 1.0


def fit(
    problem: HomeProblem, home: np.ndarray, right: np.ndarray, steps: int = STEPS
) -> HomeFit | None:
    """Fit home to a set of right home bearings; None when they do not fix it.

    Parameters
    ----------
    problem : HomeProblem
        What is known.
    home : ndarray, shape (3,)
        Where to start.
    right : ndarray, shape (q,), bool
        The set.
    steps : int
        Gauss-Newton steps at most.
    """
    if right.sum() < problem.fewest:
        return None
    known, now = problem.mean, None
    for _ in range(steps):
        now = solved(linearised(problem, home, known), right)
        if now is None or np.abs(now.step).max() < SETTLED:
            break
        home, known = now.home, now.known
    return now if now is not None and problem.is_near(now.home) else None


def carried(fit: HomeFit, problem: HomeProblem) -> HomeFit | None:
    """Return a fit after what is known has changed by next to nothing, linearised as before."""
    return solved(fit.linear.carried(problem), fit.right, fit.doubt)


def solved(linear: Linear, right: np.ndarray, doubt: np.ndarray | None = None) -> HomeFit | None:
    """Return home where everything is linear; None when the set does not fix it.

    Parameters
    ----------
    linear : Linear
        The home bearings.
    right : ndarray, shape (q,), bool
        The set of right ones.
    doubt : ndarray, shape (3, 3), optional
        See `HomeFit.doubt`; worked out when asked for unless it is known.
    """
    problem, q = linear.problem, right.size
    information, slope = problem.vague.copy(), np.zeros(3)
    if problem.prior is not None and problem.prior_information is not None:
        offset = problem.prior - linear.at
        offset[2] = wrap(offset[2])
        information, slope = (
            information + problem.prior_information,
            (problem.prior_information @ offset),
        )
    precision, step, log_volume = np.empty((q, q)), np.empty(3), np.empty(1)
    native = compiled()
    if native is None:
        try:
            _solve(linear, right, information, slope, precision, step, log_volume)
        except np.linalg.LinAlgError:
            return None
    else:
        given = (right.astype(float), linear.spread, linear.by_home, linear.residual)
        found = (information, slope, precision, step, log_volume)
        if native.solve_home(q, *map(address, (*given, *found))):
            return None
    if not np.isfinite(step).all():
        return None
    step *= min(1.0, LONGEST_STEP_M / max(float(np.abs(step).max()), 1e-12))
    return HomeFit(linear, right, step, precision, information, float(log_volume[0]), doubt)


def _solve(
    linear: Linear,
    right: np.ndarray,
    information: np.ndarray,
    slope: np.ndarray,
    precision: np.ndarray,
    step: np.ndarray,
    log_volume: np.ndarray,
) -> None:
    """Fill in precision, step and volume; add to information and slope."""
    of_set = np.ix_(right, right)
    root = np.linalg.cholesky(linear.spread[of_set])
    inverse = np.linalg.inv(root)
    precision[:] = 0.0
    precision[of_set] = inverse.T @ inverse
    log_volume[0] = 2.0 * np.log(root.diagonal()).sum()
    weighted = linear.by_home.T @ precision
    information += weighted @ linear.by_home
    slope += weighted @ linear.residual
    np.linalg.cholesky(information)
    step[:] = np.linalg.solve(information, slope)
