"""Gauss-Newton fit of home to a set of inlier home bearings."""

from __future__ import annotations

import numpy as np

from homeward.localizer.compiled import compiled
from homeward.localizer.home.estimate import HomeFit
from homeward.localizer.home.linearisation import Linear, linearised
from homeward.localizer.home.problem import HomeProblem

STEPS = 6
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
    if inliers.sum() < problem.fewest:
        return None
    now = _iterated(problem, home, inliers, steps)
    return now if now is not None and problem.is_near(now.home) else None


def _iterated(
    problem: HomeProblem, home: np.ndarray, inliers: np.ndarray, steps: int
) -> HomeFit | None:
    """Return where the iteration ends; None when the set does not fix home."""
    native, q, size = compiled(), inliers.size, problem.mean.size
    if native is None:
        known, now = problem.mean, None
        for _ in range(steps):
            now = solved(linearised(problem, home, known), inliers)
            if now is None or problem.length(now.step) < SETTLED:
                break
            home, known = now.home, now.known
        return now
    at, room = home.astype(float), (np.empty(size), np.empty(q))
    linear = Linear.room(problem, at)
    arrays = (
        linear.residual,
        linear.by_place,
        linear.by_home,
        linear.correlated,
        linear.residual_covariance,
    )
    found = information, precision, step, log_volume = _room(q)
    given = (inliers.astype(float), at, *room, *arrays, *found)
    if native.fit_home(problem.in_c, steps, SETTLED, *given):
        return None
    return HomeFit(linear, inliers, step, precision, information, float(log_volume[0]))


def propagated(fit: HomeFit, problem: HomeProblem) -> HomeFit | None:
    """Return a fit after what is known has changed by next to nothing, linearised as before."""
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
    problem, native = linear.problem, compiled()
    found = information, precision, step, log_volume = _room(inliers.size)
    if native is None:
        try:
            _solve(linear, inliers, *found)
        except np.linalg.LinAlgError:
            return None
    else:
        given = (
            linear.at,
            inliers.astype(float),
            linear.residual_covariance,
            linear.by_home,
            linear.residual,
        )
        if native.solve_home(problem.in_c, *given, *found):
            return None
    return HomeFit(linear, inliers, step, precision, information, float(log_volume[0]), inflation)


def _room(q: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return room for information on home, precision and step, and the log volume."""
    return np.empty((3, 3)), np.empty((q, q)), np.empty(3), np.empty(1)


def _solve(
    linear: Linear,
    inliers: np.ndarray,
    information: np.ndarray,
    precision: np.ndarray,
    step: np.ndarray,
    log_volume: np.ndarray,
) -> None:
    """Fill in what `solved` needs."""
    problem, of_set = linear.problem, np.ix_(inliers, inliers)
    root = np.linalg.cholesky(linear.residual_covariance[of_set])
    inverse = np.linalg.inv(root)
    precision[:] = 0.0
    precision[of_set] = inverse.T @ inverse
    log_volume[0] = 2.0 * np.log(root.diagonal()).sum()
    weighted = linear.by_home.T @ precision
    information[:] = problem.before + weighted @ linear.by_home
    slope = problem.before @ problem.off_prior(linear.at) + weighted @ linear.residual
    np.linalg.cholesky(information)
    step[:] = np.linalg.solve(information, slope)
    if not np.isfinite(step).all():
        raise np.linalg.LinAlgError("home is not finite")
    step /= max(1.0, problem.length(step))
