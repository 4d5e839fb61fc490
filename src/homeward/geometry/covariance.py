"""Covariances that stay symmetric and positive, although they are computed with rounding.

A variance of zero, such as that of the shift of a robot that only turns, may become slightly
negative when it is computed as a difference. Such rounding is clipped; a larger negative variance
is an error of the computation.
"""

from __future__ import annotations

import math

import numpy as np

ROUNDING = 1e-12
"""Negative variances are rounding up to this share of the terms that they are computed from [1]:
sums of a few thousand products in double precision stay below it."""


class NotPositiveError(ArithmeticError):
    """A covariance or a variance is negative beyond rounding, or not finite."""


def positive(covariance: np.ndarray, what: str, scale: float = 0.0) -> np.ndarray:
    """Return a covariance (3, 3) symmetric, and with rounding below zero clipped.

    Parameters
    ----------
    covariance : ndarray, shape (3, 3)
        As computed.
    what : str
        Its name in an error message.
    scale : float, optional
        Size of the terms that it was computed from, where it is larger than the result.

    Raises
    ------
    NotPositiveError
        When an eigenvalue is negative beyond rounding, or an entry is not finite.
    """
    covariance = 0.5 * (covariance + covariance.T)
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = covariance.tolist()
    # Pivots of its Cholesky decomposition: for nine numbers, floats are faster than LAPACK.
    if xx > 0.0 and xx + yy + tt < math.inf:
        y_given_x, cross = yy - xy * xy / xx, yt - xy * xt / xx
        if y_given_x > 0.0 and tt - xt * xt / xx - cross * cross / y_given_x > 0.0:
            return np.asarray(covariance)
    if not covariance.any():
        return np.asarray(covariance)
    if not np.isfinite(covariance).all():
        raise NotPositiveError(f"{what} is not finite: {covariance.tolist()}")
    values, vectors = np.linalg.eigh(covariance)
    if values[0] < -ROUNDING * max(scale, float(values[-1])):
        raise NotPositiveError(
            f"{what} has the eigenvalue {values[0]:.3g}, the largest is {values[-1]:.3g}, and its "
            f"terms are up to {scale:.3g}"
        )
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(root @ root.T)  # its diagonal consists of sums of squares


def deviation(variance: float, what: str, scale: float = 0.0) -> float:
    """Return the standard deviation of a variance that was computed as a difference.

    `scale` is the size of the terms of that difference; other arguments and errors as `positive`.
    """
    if variance >= 0.0:
        return math.sqrt(variance)
    return float(deviations(np.array([variance]), what, scale)[0])


def deviations(variances: np.ndarray, what: str, scale: float | np.ndarray = 0.0) -> np.ndarray:
    """Return what `deviation` does, for an array (...) of variances and of scales."""
    if not (variances >= -ROUNDING * np.asarray(scale)).all():  # NaN is none, either
        worst = float(np.min(variances))
        terms = float(np.max(scale))
        raise NotPositiveError(f"{what} is {worst:.3g}, and its terms are up to {terms:.3g}")
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)))
