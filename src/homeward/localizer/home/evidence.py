"""Model evidence of a set of inliers by Laplace's method, and the odds of each home bearing.

The evidence is the integral over all unknowns, home included, so that sets of
different size compare fairly; for wrong bearings see `outliers`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from homeward.angles import TWO_PI, wrap
from homeward.localizer.compiled import compiled
from homeward.localizer.home.linearisation import Linear
from homeward.localizer.home.outliers import SCALE, UNIFORM_FROM, log_odds, log_outlier


@dataclass(frozen=True)
class Evidence:
    """Evidence of a set of inliers, and of each home bearing for or against it."""

    innovation: np.ndarray
    """(q,): stored minus predicted by everything else [rad] ..."""
    variance: np.ndarray
    """(q,): ... and its variance."""
    odds: np.ndarray
    """(q,): log odds of right against wrong, the rest of the set given."""
    log_evidence: float
    """Log of the evidence of the set, could home be anywhere, up to a constant that all sets share.
    """


def evaluate(
    linear: Linear,
    inliers: np.ndarray,
    step: np.ndarray,
    precision: np.ndarray,
    information: np.ndarray,
    log_volume: float,
) -> Evidence:
    """Evaluate the evidence of a fit; see `HomeFit` for what it takes.

    Raises
    ------
    numpy.linalg.LinAlgError
        If home is not fixed.
    """
    native, problem, q = compiled(), linear.problem, inliers.size
    if native is not None:
        found = innovation, variance, odds, log_evidence = (*np.empty((3, q)), np.empty(1))
        fit = (
            linear.at,
            inliers.astype(float),
            linear.residual_covariance,
            linear.by_home,
            linear.residual,
        )
        given = (information, precision, step)
        arguments = (*given, log_volume, np.empty(4 * q), *found)
        if native.judge_home(problem.in_c, SCALE, UNIFORM_FROM, *fit, *arguments):
            raise np.linalg.LinAlgError("home is not fixed")
        return Evidence(innovation, variance, odds, float(log_evidence[0]))
    innovation, variance = _innovations(linear, inliers, step, precision, information)
    odds = log_odds(innovation, variance, problem.moved_prior)
    n, p = int(inliers.sum()), problem.moved_prior
    offset = problem.off_prior(linear.at)
    square = linear.residual @ precision @ linear.residual - step @ information @ step
    square += offset @ problem.before @ offset
    log_density = -0.5 * (log_volume + n * math.log(TWO_PI))
    log_home = 0.5 * (3.0 * math.log(TWO_PI) - np.linalg.slogdet(information)[1])
    labels = n * math.log(1.0 - p) + (q - n) * math.log(p)
    outlier = log_outlier(innovation, variance)[~inliers].sum()
    log_evidence = -0.5 * square + log_density + log_home + labels + outlier
    return Evidence(innovation, variance, odds, float(log_evidence))


def _innovations(
    linear: Linear,
    inliers: np.ndarray,
    step: np.ndarray,
    precision: np.ndarray,
    information: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return stored minus predicted bearings, and the variances of that."""
    weighted = precision @ (linear.residual - linear.by_home @ step)
    out, home_covariance = ~inliers, np.linalg.inv(information)
    lever = precision @ linear.by_home
    rest = precision.diagonal() - ((lever @ home_covariance) * lever).sum(axis=1)
    rest = np.maximum(rest, 1e-9)
    innovation, variance = weighted / rest, 1.0 / rest
    between, by_home = linear.residual_covariance[out], linear.by_home[out]
    innovation[out] = wrap(linear.residual[out] - by_home @ step - between @ weighted)
    gain = between @ precision
    lever = by_home - gain @ linear.by_home
    variance[out] = (
        linear.residual_covariance.diagonal()[out]
        - (gain * between).sum(axis=1)
        + ((lever @ home_covariance) * lever).sum(axis=1)
    )
    return innovation, variance
