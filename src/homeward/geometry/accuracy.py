"""Accuracy of a pose by its covariance, and the limit below which a pose is used."""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import numpy as np

from homeward.geometry.frames import position_sigma

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
