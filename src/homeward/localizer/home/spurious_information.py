"""Spurious information on home, and the covariance inflation that takes it out again.

Where home lies on the circle through the landmarks its position is not fixed at all; but the
landmarks as mapped are never quite on the circle, and so seem to fix it. What their errors add to
the information in the mean is taken out again, down to a share of `LEAST_SHARE`.
"""

from __future__ import annotations

import numpy as np

from homeward.localizer.compiled import compiled
from homeward.localizer.home.linearisation import Linear
from homeward.localizer.home.problem import POSE_AND_YAW

LEAST_SHARE = 0.002
"""So much of the information on home is left at least when errors of the map are taken out [1]."""


def spurious_covariance(
    linear: Linear, inliers: np.ndarray, known: np.ndarray, information: np.ndarray
) -> np.ndarray:
    """Return the inflation: the covariance (3, 3) of home beyond the inverse of its information.

    Parameters
    ----------
    linear : Linear
        The home bearings.
    inliers : ndarray, shape (q,), bool
        The set.
    known : ndarray, shape (4 + 2 q,)
        What is known, corrected by the set.
    information : ndarray, shape (3, 3)
        On home.

    Raises
    ------
    numpy.linalg.LinAlgError
        If home is not fixed.
    """
    native, problem, q = compiled(), linear.problem, inliers.size
    if native is not None:
        found = np.empty((3, 3))
        of_set = (linear.at, inliers.astype(float), known, linear.residual_covariance)
        arguments = (information, problem.vague, np.empty(14 * q), found)
        if native.doubt_home(problem.in_c, 1.0 - LEAST_SHARE, *of_set, *arguments):
            raise np.linalg.LinAlgError("home is not fixed")
        return found
    whole = information + problem.vague
    left = whole.copy()
    left[:2, :2] -= _by_chance(information, _bend(linear, inliers, known))
    # Both with what is there always: so it is a covariance, where next to nothing is known, too.
    return np.asarray(np.linalg.inv(left) - np.linalg.inv(whole))


def _by_chance(information: np.ndarray, bend: np.ndarray) -> np.ndarray:
    """Return how much of the information on home's place, (2, 2), is there by chance.

    In axes in which the information on the place, the heading being unknown, is a unit matrix, the
    shares that are there by chance are the eigenvalues of `bend`.
    """
    by_heading = information[:2, 2]
    place = information[:2, :2] - np.outer(by_heading, by_heading) / information[2, 2]
    root = np.linalg.cholesky(place)
    inverse = np.linalg.inv(root)
    shares, axes = np.linalg.eigh(inverse @ bend @ inverse.T)
    kept = root @ axes
    return np.asarray((kept * np.minimum(shares, 1.0 - LEAST_SHARE)) @ kept.T)


def _bend(linear: Linear, inliers: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the information (2, 2) that the landmarks' own errors add by bending bearings."""
    d = known[POSE_AND_YAW:].reshape(-1, 2)[inliers] - linear.at[:2]
    square = np.maximum((d**2).sum(axis=1), 1e-4)
    a, b = 2.0 * d[:, 0] * d[:, 1] / square**2, (d[:, 1] ** 2 - d[:, 0] ** 2) / square**2
    curvature = np.array([[a, b], [b, -a]]).transpose(2, 0, 1)
    of_set = np.repeat(np.concatenate([np.zeros(POSE_AND_YAW // 2, bool), inliers]), 2)
    errors = _own_errors(d, linear.problem.covariance[of_set][:, of_set])
    weighed = errors / linear.residual_covariance.diagonal()[inliers, None, None]
    return np.asarray((curvature @ weighed @ curvature).sum(axis=0))


def _own_errors(d: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the covariances (r, 2, 2) of landmarks seen from home at `d` (r, 2).

    What moves or turns all of them alike moves home with them, and is left out.
    """
    rigid = np.zeros((len(d), 2, 3))
    rigid[:, 0, 0] = rigid[:, 1, 1] = 1.0
    rigid[:, 0, 2], rigid[:, 1, 2] = -d[:, 1], d[:, 0]
    basis = np.linalg.qr(rigid.reshape(-1, 3))[0]
    own = np.eye(len(basis)) - basis @ basis.T
    each = np.arange(len(d))
    errors = (own @ covariance @ own).reshape(len(d), 2, len(d), 2)
    return np.asarray(errors[each, :, each])
