"""Test whether additional unknowns explain the residuals of a solved window.

These change bearings or motions: a landmark walks, the camera was knocked. Their posterior
follows from the last solution by one Gauss-Newton step, with poses, calibration and landmarks
marginalised: if these were assumed known, their errors would be mistaken for the new unknown.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from homeward.localizer.motions import HEAD, NC
from homeward.localizer.reference.factors import sum_by, sum_by_pair
from homeward.localizer.reference.window import Linearised, eliminate


class Unknown(NamedTuple):
    """Additional unknowns of a window of m bearings and w poses: k of them, in blocks of j."""

    by_bearing: np.ndarray
    """(m, j): normalised derivatives of the expected bearings by one block of them, ..."""
    block: np.ndarray
    """(m,), int: ... and the number of that block; -1: the bearing depends on none."""
    prior: np.ndarray
    """(k,): inverse variances around zero; 0: no prior."""
    by_motion: np.ndarray | None = None
    """(w - 1, 3, k): derivatives of the expected motions; None: they depend on none."""


class Extra(NamedTuple):
    """The posterior of k additional unknowns in information form, all others being marginalised."""

    information: np.ndarray
    """(k, k): including their prior."""
    slope: np.ndarray
    """(k,): product of the information and their estimates."""
    shared: np.ndarray
    """(a, k): minus the derivatives of calibration and landmarks by them, which follow."""
    absorbed: tuple[np.ndarray, ...]
    """Changes of bearings (m, k) and motions (w - 1, 3, k) that the others absorb, if asked for."""


def extend(given: Linearised, unknown: Unknown, with_absorbed: bool = False) -> Extra:
    """Return the posterior of additional unknowns of a window in information form.

    `numpy.linalg.LinAlgError` when its normal equations are singular.
    """
    e, seen, motions = given
    w, n, k = len(e.own), (len(e.common) - NC) // 2, unknown.prior.size
    rows = unknown.block >= 0
    by_bearing, block = unknown.by_bearing[rows], unknown.block[rows]
    jacobian, blocks = seen.jacobian[rows], k // by_bearing.shape[1]
    by_pose, by_calibration, by_landmark = np.split(jacobian, [3, HEAD], axis=1)
    poses = sum_by_pair(seen.pose[rows], block, by_pose, by_bearing, w, blocks)
    landmarks = sum_by_pair(seen.landmark[rows], block, by_landmark, by_bearing, n, blocks)
    calibration = sum_by(block, by_calibration, by_bearing, blocks).transpose(1, 0, 2)
    shared = np.concatenate([calibration.reshape(NC, k), landmarks.reshape(2 * n, k)])

    own = block_diag(*sum_by(block, by_bearing, by_bearing, blocks))
    information = np.diag(unknown.prior) + own
    slope = sum_by(block, seen.residual[rows, None], by_bearing, blocks).ravel()
    if unknown.by_motion is not None:
        weighted = motions.weight[:, None, None] * motions.information @ unknown.by_motion
        by_state = motions.jacobian.transpose(0, 2, 1) @ weighted
        poses[:-1] += by_state[:, :3]
        poses[1:] += by_state[:, 3:6]
        shared[:NC] += by_state[:, 6:].sum(axis=0)
        information += np.tensordot(unknown.by_motion, weighted, ((0, 1), (0, 1)))
        slope += np.tensordot(motions.error, weighted)

    pose_steps, steps = eliminate(e).step(poses, shared)
    information -= np.tensordot(poses, pose_steps, ((0, 1), (0, 1))) + shared.T @ steps
    slope -= np.tensordot(e.slope, pose_steps) + e.common_slope @ steps
    if not (np.isfinite(information).all() and np.isfinite(slope).all()):
        raise np.linalg.LinAlgError("no finite information")
    absorbed = _absorbed(given, pose_steps, steps) if with_absorbed else ()
    return Extra(information, slope, steps, absorbed)


def _absorbed(
    given: Linearised, poses: np.ndarray, shared: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the changes of expected bearings and motions by k steps of all unknowns."""
    calibration, places = shared[:NC], shared[NC:].reshape(-1, 2, shared.shape[1])
    by_pose, by_calibration, by_place = np.split(given.seen.jacobian, [3, HEAD], axis=1)
    there = by_place[:, None] @ places[given.seen.landmark]
    moved = by_pose[:, None] @ poses[given.seen.pose] + there
    by_poses, by_shared = np.split(given.motions.jacobian, [6], axis=2)
    both = np.concatenate([poses[:-1], poses[1:]], axis=1)
    return moved[:, 0] + by_calibration @ calibration, by_poses @ both + by_shared @ calibration
