"""Spurious information on home by errors of the map, and the inflation that compensates it.

On the circle through the landmarks, the position of home is unobservable; but mapped landmarks are
never exactly on the circle, and so seem to determine it. The information that their errors add on
average is removed again, down to a share of `MIN_INFORMATION_SHARE`.
"""

from __future__ import annotations

import math

import numpy as np

from homeward.geometry.se2 import MIN_SQUARED_DISTANCE
from homeward.localizer.home.problem import HomeProblem
from homeward.localizer.reference.sets import POSE_AND_YAW, Linear, inverted, position_root
from homeward.localizer.tunables import MIN_INFORMATION_SHARE


def spurious_covariance(
    problem: HomeProblem,
    linear: Linear,
    members: np.ndarray,
    landmarks: np.ndarray,
    information: np.ndarray,
) -> np.ndarray:
    """Return the covariance (3, 3) of home beyond the inverse of its information (3, 3).

    `members` (r,) are the indices of the set, and `landmarks` (q, 2) [m] are corrected by it.
    `numpy.linalg.LinAlgError` if home is not determined.
    """
    whole = information + problem.weak_prior
    reduced = whole.copy()
    if members.size:
        reduced[:2, :2] -= _spurious(
            information, *_by_curvature(problem.covariance, linear, members, landmarks)
        )
    # Both with the weak prior: then the difference is a covariance in any case.
    return np.asarray(inverted(reduced)[0] - inverted(whole)[0])


def _spurious(information: np.ndarray, spread: float, pseudo: complex) -> np.ndarray:
    """Return the spurious part of the information on home's position, (2, 2).

    In axes in which the information on the position, the heading being unknown, is the identity,
    the spurious shares are the eigenvalues of [xx, xy; xy, yy], the information by errors of the
    map, given by `spread`, xx + yy, and `pseudo`, xx - yy + 2i xy.
    """
    factor = position_root(information)
    if factor is None:
        raise np.linalg.LinAlgError("home is not determined")
    a, b, c = factor
    xx, xy, yy = 0.5 * (spread + pseudo.real), 0.5 * pseudo.imag, 0.5 * (spread - pseudo.real)
    xx, xy = xx / (a * a), (xy - b * xx / a) / (a * c)
    yy = (yy - b * (2.0 * c * xy + b * xx)) / (c * c)
    half, apart = 0.5 * (xx - yy), math.hypot(0.5 * (xx - yy), xy)
    shares = 0.5 * (xx + yy) + apart, 0.5 * (xx + yy) - apart
    most, least = (min(share, 1.0 - MIN_INFORMATION_SHARE) for share in shares)
    middle, ratio = 0.5 * (most + least), 0.5 * (most - least) / max(apart, 1e-300)
    kept = np.array([[middle + ratio * half, ratio * xy], [ratio * xy, middle - ratio * half]])
    root = np.array([[a, 0.0], [b, c]])
    return np.asarray(root @ kept @ root.T)


def _by_curvature(
    covariance: np.ndarray, linear: Linear, members: np.ndarray, landmarks: np.ndarray
) -> tuple[float, complex]:
    """Return the information that errors of the landmarks add by the curvature of bearings.

    In the plane as complex numbers a landmark at z with error e adds k conj(e) to the derivative of
    its bearing, with the curvature k = -i / conj(z)^2.
    """
    away = landmarks.view(complex)[members, 0] - complex(*linear.at[:2].tolist())
    spread, pseudo = _own_errors(away, covariance, POSE_AND_YAW // 2 + members)
    square = away * away
    size = np.maximum(np.abs(square), MIN_SQUARED_DISTANCE)
    weight = 1.0 / (linear.residual_covariance[members, members] * size * size)
    turned = -weight * (square / size) ** 2
    return float(weight @ spread), complex(turned @ pseudo.conj())


def _own_errors(
    away: np.ndarray, covariance: np.ndarray, of_set: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the variances xx + yy and xx - yy + 2i xy (r,) of the landmarks' individual errors.

    Errors that translate or rotate all landmarks move home with them, and are projected out.
    Landmarks are at `away` (r,) from home, complex, and have the indices `of_set` (r,) among pairs
    of the state.
    """
    centred = away - away.sum() / len(away)
    rigid = np.zeros((3, len(covariance) // 2), complex)
    motions = np.empty((3, len(away)), complex)
    motions[0], motions[1] = 1.0 / math.sqrt(len(away)), 1j / math.sqrt(len(away))
    motions[2] = 1j / max(math.sqrt(np.vdot(centred, centred).real), 1e-6) * centred
    rigid[:, of_set] = motions
    # With B an orthonormal basis of those, individual errors have (I - B B^T) C (I - B B^T).
    basis = rigid.view(float)
    shared = basis @ covariance
    shared -= 0.5 * (shared @ basis.T) @ basis
    without = shared.view(complex)[:, of_set]
    variance, mixed = covariance.diagonal(), covariance.diagonal(1)
    xx, xy, yy = variance[::2][of_set], mixed[::2][of_set], variance[1::2][of_set]
    spread = xx + yy - 2.0 * (motions.conj() * without).sum(axis=0).real
    return spread, xx - yy + 2j * xy - 2.0 * (motions * without).sum(axis=0)
