"""State of the map: a Gaussian on newest pose, calibration and landmarks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from statistics import median

import numpy as np

from homeward.geometry.se2 import MIN_DISTANCE
from homeward.localizer import kernels
from homeward.localizer.motions import HEAD, Motion
from homeward.localizer.reference.factors import cameras
from homeward.localizer.tunables import CLOSE


@dataclass(frozen=True)
class Marginal:
    """Gaussian on newest pose, calibration and n landmarks."""

    mean: np.ndarray
    """(3 + 9 + 2 n,)"""
    covariance: np.ndarray
    """(3 + 9 + 2 n, 3 + 9 + 2 n)"""

    @cached_property
    def calibration(self) -> np.ndarray:
        """(10,): calibration of odometry and camera."""
        return self.mean[3:HEAD]

    @property
    def calibration_variances(self) -> np.ndarray:
        """(10,): its variances."""
        return self.covariance.diagonal()[3:HEAD]

    @cached_property
    def positions(self) -> np.ndarray:
        """(n, 2): positions of the landmarks in the odometry frame [m]."""
        return self.mean[HEAD:].reshape(-1, 2)

    @cached_property
    def distances(self) -> np.ndarray:
        """(n,): distances of the landmarks from the newest pose [m]."""
        return np.asarray(np.hypot(*(self.positions - self.mean[:2]).T))

    @cached_property
    def scale(self) -> float:
        """Median distance of the landmarks, the unit of length of tests [m]; infinite if none.

        At least `MIN_DISTANCE`: the robot may be on a landmark.
        """
        return max(float(median(self.distances.tolist() or [math.inf])), MIN_DISTANCE)

    @property
    def reach(self) -> np.ndarray:
        """(n,): distances, bounded below by `CLOSE` for landmarks next to the robot [m]."""
        return self.distances + CLOSE * self.scale

    def pose_after(self, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Return the pose after a motion from the newest one, and its Jacobian (3, 13)."""
        return cameras(motion.uncalibrated, motion.jacobian, self.mean[:3], self.calibration)

    def propagate(self, motion: Motion) -> Marginal:
        """Return it with the newest pose propagated by a motion."""
        return Marginal(*kernels.propagate(self.mean, self.covariance, motion))

    @staticmethod
    def columns(index: np.ndarray) -> np.ndarray:
        """Return the indices of the coordinates of landmarks (k,) in the state, (k, 2)."""
        return np.asarray(HEAD + 2 * index[:, None] + np.arange(2))

    def places(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions of landmarks (k,), (k, 2) [m], and their covariances, (k, 2, 2)."""
        columns = self.columns(index)
        return self.mean[columns], self.covariance[columns[:, :, None], columns[:, None, :]]

    def with_landmark(self, position: np.ndarray, sigma: float) -> Marginal:
        """Return it with another landmark, at `position` (2,) within `sigma` [m]."""
        size = self.mean.size
        covariance = np.zeros((size + 2, size + 2))
        covariance[:size, :size] = self.covariance
        covariance[size, size] = covariance[size + 1, size + 1] = sigma**2
        return Marginal(np.append(self.mean, position), covariance)

    def reordered(self, order: np.ndarray) -> Marginal:
        """Return it with its unknowns in another order, or only some of them."""
        return Marginal(self.mean[order], self.covariance[np.ix_(order, order)])
