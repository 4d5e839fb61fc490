"""EKF state: a Gaussian on newest pose, calibration and landmarks, propagated and updated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg import lapack

from homeward.geometry.se2 import MIN_DISTANCE, composition, rotation
from homeward.localizer.motions import HEAD, Motion
from homeward.localizer.tunables import CLOSE, GATE

if TYPE_CHECKING:
    from homeward.localizer.map.gating import Prediction


class View(NamedTuple):
    """Where the camera is at a frame, by the newest state."""

    camera: Motion
    """Motion to the camera from the newest keyframe."""
    pose: np.ndarray
    """(3,): its pose [m, m, rad]."""
    by_head: np.ndarray
    """(3, 12): Jacobian of the pose; see `Marginal.pose_after`."""


@dataclass(frozen=True)
class Marginal:
    """Gaussian on newest pose, calibration and n landmarks."""

    mean: np.ndarray
    """(3 + 9 + 2 n,)"""
    covariance: np.ndarray
    """(3 + 9 + 2 n, 3 + 9 + 2 n)"""

    @cached_property
    def calibration(self) -> np.ndarray:
        """(9,): calibration of odometry and camera."""
        return self.mean[3:HEAD]

    @property
    def calibration_variances(self) -> np.ndarray:
        """(9,): its variances."""
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
        """Return the pose after a motion from the newest one, and its Jacobian (3, 12)."""
        by_calibration, now = motion.jacobian, self.mean[3:HEAD]
        moved = motion.delta - by_calibration @ motion.calibration + by_calibration @ now
        by_head = np.empty((3, HEAD))
        there, by_head[:, :3], by_motion = composition(self.mean[:3], moved)
        np.matmul(by_motion, by_calibration, out=by_head[:, 3:])
        return there, by_head

    def propagate(self, motion: Motion) -> Marginal:
        """EKF prediction: propagate the newest pose by a motion."""
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[:3], by_head = self.pose_after(motion)
        turn = rotation(self.mean[2])
        covariance[:3] = by_head @ self.covariance[:HEAD]
        covariance[:, :3] = covariance[:, :HEAD] @ by_head.T
        covariance[:3, :3] += turn @ motion.covariance @ turn.T
        return Marginal(mean, covariance)

    def update(self, seen: Prediction) -> Marginal:
        """EKF update by sightings, with a redescending M-estimator against large innovations.

        `numpy.linalg.LinAlgError` when the innovation covariance is singular.
        """
        if not seen.residual.size:
            return self
        innovation_covariance = seen.innovation_covariance.copy()
        variance = innovation_covariance.diagonal()
        innovation_covariance.flat[:: len(innovation_covariance) + 1] = np.maximum(
            seen.residual**2 / GATE**2, variance
        )
        _, gain, failed = lapack.dposv(innovation_covariance, seen.correlated)
        if failed:
            raise np.linalg.LinAlgError("the innovation covariance is singular")
        covariance = self.covariance - seen.correlated.T @ gain
        return Marginal(self.mean + seen.residual @ gain, 0.5 * (covariance + covariance.T))

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

    def without_landmark(self, index: int) -> Marginal:
        """Return it without a landmark."""
        keep = np.delete(np.arange(self.mean.size), [HEAD + 2 * index, HEAD + 2 * index + 1])
        return Marginal(self.mean[keep], self.covariance[np.ix_(keep, keep)])
