"""Covariances that stay symmetric and positive, the accuracy of a pose, and robust weights.

A variance of zero, such as that of the shift of a robot that only turns, may become slightly
negative when it is computed as a difference. Such rounding is clipped; a larger negative variance
is an error of the computation.

Graduated non-convexity (Blake and Zisserman, 1987; Yang et al., 2020) begins with a convex loss,
since the first guess has large errors, and ends with the robust loss of Geman and McClure, under
which outliers lose their weight.
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import numpy as np

from homeward.geometry.frames import position_sigma

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


OUTSIDE = 1e-3
"""Probability that the position is outside the protection level [1]."""
MAX_SIGMA_M = 0.25
"""Default limit of the standard deviation of a position [m]: half the radius of a small robot."""
RETURN = 0.8
"""A pose that was outside the limit is inside again below this share of it [1]. The standard
deviation falls and grows by a few percent from one frame to the next."""


class PoseAccuracy(NamedTuple):
    """Accuracy of a pose as its covariance states it: numbers, or arrays of one shape."""

    position: Any
    """Standard deviation of the position along its worst direction [m]."""
    heading: Any
    """Standard deviation of the heading [rad]."""
    protection_level: Any
    """Radius around the pose that contains the position with a probability of 99.9 % [m]."""

    @classmethod
    def of(cls, covariance: np.ndarray) -> PoseAccuracy:
        """Return the accuracy of covariances (..., 3, 3) of (x [m], y [m], heading [rad])."""
        largest = position_sigma(covariance)
        square = np.asarray(largest) ** 2
        smallest = covariance[..., 0, 0] + covariance[..., 1, 1] - square
        ratio = np.divide(smallest, square, out=np.zeros_like(square), where=square > 0.0)
        level = largest * np.interp(ratio, *_radii())
        return cls(largest, np.sqrt(np.maximum(covariance[..., 2, 2], 0.0)), level)


@functools.cache
def _radii() -> tuple[np.ndarray, np.ndarray]:
    """Return ratios of variances, and the radius that contains all but `OUTSIDE`.

    The smaller variance over the larger one, and the radius over the larger standard deviation. In
    coordinates in which the Gaussian is round, the probability outside a circle of radius r is the
    mean over all directions of exp(-r^2 / (2 s^2)), where s is the deviation in that direction.
    """
    ratio = np.linspace(0.0, 1.0, 65)
    angle = np.linspace(0.0, math.pi / 2.0, 400, endpoint=False) + math.pi / 1600.0
    variance = np.cos(angle) ** 2 + ratio[:, None] * np.sin(angle) ** 2
    near, far = np.full(ratio.size, 3.0), np.full(ratio.size, 4.0)
    for _ in range(40):
        middle = 0.5 * (near + far)
        outside = np.exp(-0.5 * middle[:, None] ** 2 / variance).mean(axis=1) > OUTSIDE
        near, far = np.where(outside, middle, near), np.where(outside, far, middle)
    return ratio, far


class AccuracyLimit:
    """Whether poses are accurate enough, with hysteresis.

    A pose whose deviation is not larger is accurate enough. After one that is larger, others are so
    only below `RETURN` times the limit, so that a deviation near the limit does not switch a robot
    on and off.

    Parameters
    ----------
    largest_sigma : float, optional
        Limit of the standard deviation of the position along its worst direction [m].
    """

    def __init__(self, largest_sigma: float = MAX_SIGMA_M) -> None:
        self.largest_sigma = largest_sigma
        self._was_exceeded = False

    def is_met(self, sigma: float) -> bool:
        """Return whether the next pose, of this deviation [m], is accurate enough; NaN is not."""
        limit = RETURN * self.largest_sigma if self._was_exceeded else self.largest_sigma
        self._was_exceeded = not sigma <= limit
        return not self._was_exceeded


MAD_TO_SIGMA = 1.4826
"""Standard deviation of Gaussian errors divided by the median of their absolute values [1]."""
GNC_SCHEDULE = 1.0, 0.5, 0.25, 0.1, 0.0, 0.0
"""For each step of graduated non-convexity, the share of the first guess's a-priori error that is
added to the noise [1]."""


def robust_weight(squares: np.ndarray) -> np.ndarray:
    """Return Geman and McClure's weights of squared residuals, divided by their squared scale."""
    return np.asarray((1.0 + squares) ** -2)


def robust_loss(squares: np.ndarray) -> np.ndarray:
    """Return Geman and McClure's losses of squared residuals, divided by their squared scale."""
    return np.asarray(squares / (1.0 + squares))
