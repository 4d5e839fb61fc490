"""Filter state: one Gaussian on the newest pose and the map, propagated and updated (EKF)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from statistics import median

import numpy as np
from scipy.linalg import lapack

from homeward.localizer.geometry import composition, rotation
from homeward.localizer.map.sightings import bearing_residuals
from homeward.localizer.motion.preintegration import NC, Motion
from homeward.localizer.tunables import GATE, SAME_PLACE

HEAD = 3 + NC
"""The Gaussian begins with the newest pose and the calibration."""


@dataclass(frozen=True)
class Prediction:
    """Sightings from the newest pose against what a `Marginal` says of them."""

    residual: np.ndarray
    """(m,): measured minus expected [rad]."""
    jacobian: np.ndarray
    """(m, 13): of the expected bearings, as of `bearing_residuals`."""
    correlated: np.ndarray
    """(m, 3 + 8 + 2 n): covariance of the expected bearings with everything."""
    innovation_covariance: np.ndarray
    """(m, m): covariance of the residuals."""

    def only(self, keep: np.ndarray) -> Prediction:
        """Return some of them, marked in `keep`, shape (m,), bool."""
        (kept,) = keep.nonzero()
        if kept.size == keep.size:
            return self
        return Prediction(
            self.residual[kept],
            self.jacobian[kept],
            self.correlated[kept],
            self.innovation_covariance.take(kept, axis=0).take(kept, axis=1),
        )

    def widened(self, variances: np.ndarray) -> Prediction:
        """Return it with so much more variance in each bearing, shape (m,) [rad^2]."""
        covariance = self.innovation_covariance.copy()
        covariance.flat[:: len(covariance) + 1] += variances
        return Prediction(self.residual, self.jacobian, self.correlated, covariance)


@dataclass(frozen=True)
class Marginal:
    """The Gaussian on the newest pose, the calibration and the landmarks."""

    mean: np.ndarray
    """(3 + 8 + 2 n,)"""
    covariance: np.ndarray
    """(3 + 8 + 2 n, 3 + 8 + 2 n)"""

    @property
    def calibration(self) -> np.ndarray:
        """Of odometry and camera, shape (8,)."""
        return self.mean[3:HEAD]

    @property
    def calibration_variances(self) -> np.ndarray:
        """(8,): of each part of the calibration."""
        return self.covariance.diagonal()[3:HEAD]

    @property
    def positions(self) -> np.ndarray:
        """(n, 2), of the landmarks in the odometry frame [m]."""
        return self.mean[HEAD:].reshape(-1, 2)

    @cached_property
    def distances(self) -> np.ndarray:
        """(n,), of the landmarks from the newest pose [m]."""
        return np.asarray(np.hypot(*(self.positions - self.mean[:2]).T))

    @cached_property
    def scale(self) -> float:
        """Median distance of the landmarks [m]: what is small is small against it; or infinite."""
        return float(median(self.distances.tolist() or [math.inf]))

    @property
    def reach(self) -> np.ndarray:
        """(n,): distances, bounded below by `SAME_PLACE` for landmarks next to the robot [m]."""
        return self.distances + SAME_PLACE * self.scale

    def after(self, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Return the pose after a motion from the newest one, and its Jacobian (3, 11)."""
        moved = motion.uncalibrated + motion.jacobian @ self.calibration
        by_head = np.empty((3, HEAD))
        there, by_head[:, :3], by_motion = composition(self.mean[:3], moved)
        np.matmul(by_motion, motion.jacobian, out=by_head[:, 3:])
        return there, by_head

    def propagate(self, motion: Motion) -> Marginal:
        """Propagate: move the newest pose on by a motion."""
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[:3], by_head = self.after(motion)
        turn = rotation(self.mean[2])
        covariance[:3] = by_head @ self.covariance[:HEAD]
        covariance[:, :3] = covariance[:, :HEAD] @ by_head.T
        covariance[:3, :3] += turn @ motion.covariance @ turn.T
        return Marginal(mean, covariance)

    def predict_bearings(
        self,
        bearings: np.ndarray,
        sigmas: np.ndarray,
        cameras: tuple[np.ndarray, np.ndarray],
        index: np.ndarray,
    ) -> Prediction:
        """Predict bearings from the newest pose: innovations and their covariance.

        Parameters
        ----------
        bearings, sigmas : ndarray, shape (m,)
            Measured from the camera's axis, and their standard deviations [rad].
        cameras : tuple of ndarray, shapes (m, 3) and (m, 3, 11), or (3,) and (3, 11)
            The camera's poses by that of the newest keyframe; see `Frames.eyes`, `after`.
        index : ndarray, shape (m,), int
            Which landmarks were seen.
        """
        at = HEAD + 2 * index
        residual, jacobian = bearing_residuals(bearings, *cameras, self.positions[index])
        head, gx, gy = jacobian[:, :HEAD], jacobian[:, HEAD, None], jacobian[:, HEAD + 1, None]
        p = self.covariance
        by_x, by_y = p.take(at, axis=0), p.take(at + 1, axis=0)
        correlated = head @ p[:HEAD] + gx * by_x + gy * by_y
        innovation_covariance = correlated[:, :HEAD] @ head.T
        innovation_covariance += correlated.take(at, axis=1) * gx.T
        innovation_covariance += correlated.take(at + 1, axis=1) * gy.T
        innovation_covariance.flat[:: len(bearings) + 1] += sigmas**2
        return Prediction(residual, jacobian, correlated, innovation_covariance)

    def update(self, seen: Prediction) -> Marginal:
        """Update: return it corrected by sightings, those far off at less weight.

        Raises
        ------
        numpy.linalg.LinAlgError
            When `seen` has no spread.
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
            raise np.linalg.LinAlgError("the sightings have no spread")
        covariance = self.covariance - seen.correlated.T @ gain
        return Marginal(self.mean + seen.residual @ gain, 0.5 * (covariance + covariance.T))

    @staticmethod
    def columns(index: np.ndarray) -> np.ndarray:
        """Return where the coordinates of landmarks (k,) are in the state, (k, 2)."""
        return np.asarray(HEAD + 2 * index[:, None] + np.arange(2))

    def places(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where landmarks (k,) stand, (k, 2) [m], and the covariances of that, (k, 2, 2)."""
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
