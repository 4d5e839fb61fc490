"""What odometry and sightings say about a chain of poses, linearised: their normal equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from homeward.localizer.chain import NormalEquations
from homeward.localizer.marginal import TRUSTED
from homeward.localizer.odometry import Motion
from homeward.localizer.sightings import NC, SIGMA, bearing_residuals

LEAST_VARIANCE = 1e-8
"""No motion is known better than this [m^2, rad^2]."""


@dataclass(frozen=True)
class Step:
    """The motion between two keyframes."""

    free: np.ndarray
    """(3,): what it would be were the calibration zero."""
    covariance: np.ndarray
    """(3, 3)"""
    by_calibration: np.ndarray
    """(3, 5)"""

    @staticmethod
    def of(motion: Motion, calibration: np.ndarray) -> Step:
        """Return it from a motion that was linearised at a calibration, shape (5,)."""
        free = motion.delta - motion.jacobian @ calibration
        return Step(free, motion.covariance, motion.jacobian)


def add_odometry(
    e: NormalEquations, poses: np.ndarray, calibration: np.ndarray, steps: Sequence[Step]
) -> None:
    """Add the steps between `poses`, shape (w, 3), one fewer than these."""
    if len(poses) < 2:
        return
    a, b = poses[:-1], poses[1:]
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    d = b - a
    local = np.stack([c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1], d[:, 2]], axis=1)
    by_calibration = np.array([step.by_calibration for step in steps])
    error = np.array([step.free for step in steps]) + by_calibration @ calibration - local
    jacobian = np.zeros((len(a), 3, 6 + NC))  # of the expected motion, less the odometry's
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = -c
    jacobian[:, 0, 1], jacobian[:, 1, 0] = -s, s
    jacobian[:, 0, 2], jacobian[:, 1, 2] = local[:, 1], -local[:, 0]
    jacobian[:, 2, 2], jacobian[:, 2, 5] = -1.0, 1.0
    jacobian[:, 0, 3] = jacobian[:, 1, 4] = c
    jacobian[:, 0, 4], jacobian[:, 1, 3] = s, -s
    jacobian[:, :, 6:] = -by_calibration
    covariances = np.array([step.covariance for step in steps])
    information = np.linalg.inv(covariances + LEAST_VARIANCE * np.eye(3))
    weighted = jacobian.transpose(0, 2, 1) @ information
    blocks = weighted @ jacobian
    slopes = (weighted @ error[:, :, None])[:, :, 0]
    e.own[:-1] += blocks[:, :3, :3]
    e.own[1:] += blocks[:, 3:6, 3:6]
    e.next[:] += blocks[:, :3, 3:6]
    e.shared[:-1, :, :NC] += blocks[:, :3, 6:]
    e.shared[1:, :, :NC] += blocks[:, 3:6, 6:]
    e.common[:NC, :NC] += blocks[:, 6:, 6:].sum(axis=0)
    e.slope[:-1] += slopes[:, :3]
    e.slope[1:] += slopes[:, 3:6]
    e.common_slope[:NC] += slopes[:, 6:].sum(axis=0)


def add_sightings(
    e: NormalEquations,
    poses: np.ndarray,
    calibration: np.ndarray,
    positions: np.ndarray,
    sightings: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Add sightings, those with large residuals at less weight.

    Parameters
    ----------
    e : NormalEquations
        Of w poses, and the calibration and n landmarks that they share.
    poses : ndarray, shape (w, 3)
        Of the keyframes.
    calibration : ndarray, shape (5,)
        As it is believed to be.
    positions : ndarray, shape (n, 2)
        Of the landmarks [m].
    sightings : tuple of ndarray
        Which pose (m,) and which landmark (m,) each row of a table (m, COLUMNS) belongs to, and
        the table.
    """
    pose, landmark, rows = sightings
    if not len(rows):
        return
    w, n = len(poses), len(positions)
    residual, jacobian = bearing_residuals(poses[pose], calibration, positions[landmark], rows)
    sigma = rows[:, SIGMA]
    scale = 1.0 / (sigma * np.maximum(np.abs(residual) / (TRUSTED * sigma), 1.0))
    columns = np.concatenate([jacobian, residual[:, None]], axis=1)
    columns *= scale[:, None]
    head, by_landmark = columns[:, : 3 + NC], columns[:, 3 + NC : 5 + NC]

    of_pose = _sum_by(pose, columns[:, :3], np.delete(columns, [3 + NC, 4 + NC], axis=1), w)
    e.own[:] += of_pose[:, :, :3]
    e.shared[:, :, :NC] += of_pose[:, :, 3:-1]
    e.slope[:] += of_pose[:, :, -1]
    e.common[:NC, :NC] += head[:, 3:].T @ head[:, 3:]
    e.common_slope[:NC] += head[:, 3:].T @ columns[:, -1]

    of_landmark = _sum_by(landmark, by_landmark, columns[:, 3:], n)
    cross = of_landmark[:, :, :NC].reshape(2 * n, NC)
    e.common[NC:, :NC] += cross
    e.common[:NC, NC:] += cross.T
    at = np.arange(n)
    landmarks = e.common[NC:, NC:].reshape(n, 2, n, 2)
    landmarks[at, :, at] += of_landmark[:, :, NC:-1]
    e.common_slope[NC:] += of_landmark[:, :, -1].ravel()

    both = _sum_by(pose * n + landmark, columns[:, :3], by_landmark, w * n)
    e.shared[:, :, NC:] += both.reshape(w, n, 3, 2).transpose(0, 2, 1, 3).reshape(w, 3, 2 * n)


def _sum_by(group: np.ndarray, left: np.ndarray, right: np.ndarray, groups: int) -> np.ndarray:
    """Return the sums of outer products of rows (m, i), (m, j) of each group (groups, i, j)."""
    blocks = left[:, :, None] * right[:, None, :]
    size = blocks.shape[1] * blocks.shape[2]
    flat = group[:, None] * size + np.arange(size)
    total = np.bincount(flat.ravel(), blocks.ravel(), groups * size)
    return np.asarray(total.reshape(groups, *blocks.shape[1:]))
