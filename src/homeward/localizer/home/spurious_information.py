"""Spurious information on home, and the covariance inflation that takes it out again.

Where home lies on the circle through the landmarks its position is not fixed at all; but the
landmarks as mapped are never quite on the circle, and so seem to fix it. What their errors add to
the information in the mean is taken out again, down to a share of `MIN_INFORMATION_SHARE`.
"""

from __future__ import annotations

import math

import numpy as np

from homeward.localizer.geometry import LEAST_SQUARE
from homeward.localizer.home.linearisation import Linear, inverted
from homeward.localizer.home.problem import POSE_AND_YAW
from homeward.localizer.tunables import MIN_INFORMATION_SHARE


def spurious_covariance(
    linear: Linear, members: np.ndarray, landmarks: np.ndarray, information: np.ndarray
) -> np.ndarray:
    """Return the inflation: the covariance (3, 3) of home beyond the inverse of its information.

    Parameters
    ----------
    linear : Linear
        The home bearings.
    members : ndarray, shape (r,), int
        The set.
    landmarks : ndarray, shape (q, 2)
        Corrected by the set [m].
    information : ndarray, shape (3, 3)
        On home.

    Raises
    ------
    numpy.linalg.LinAlgError
        If home is not fixed.
    """
    whole = information + linear.problem.vague
    left = whole.copy()
    if members.size:
        left[:2, :2] -= _by_chance(information, *_bend(linear, members, landmarks))
    # Both with what is there always: so it is a covariance, where next to nothing is known, too.
    return np.asarray(inverted(left)[0] - inverted(whole)[0])


def _by_chance(information: np.ndarray, spread: float, pseudo: complex) -> np.ndarray:
    """Return how much of the information on home's place, (2, 2), is there by chance.

    In axes in which the information on the place, the heading being unknown, is a unit matrix, the
    shares that are there by chance are the eigenvalues of what bending adds to it, [xx, xy; xy,
    yy], of which `spread` is xx + yy and `pseudo` xx - yy + 2i xy.
    """
    (m, n, along), (_, o, across), (_, _, turn) = information.tolist()
    a = math.sqrt(m - along * along / turn)  # the Cholesky factor: [a, 0; b, c]
    b = (n - along * across / turn) / a
    c = math.sqrt(o - across * across / turn - b * b)
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


def _bend(linear: Linear, members: np.ndarray, landmarks: np.ndarray) -> tuple[float, complex]:
    """Return the information that the landmarks' own errors add by bending bearings.

    In the plane as complex numbers a landmark at z that is off by e adds k conj(e) to the
    derivative of its bearing, with the curvature k = -i / conj(z)^2.
    """
    away = landmarks.view(complex)[members, 0] - complex(*linear.at[:2].tolist())
    spread, pseudo = _own_errors(away, linear.problem.covariance, POSE_AND_YAW // 2 + members)
    square = away * away
    size = np.maximum(np.abs(square), LEAST_SQUARE)
    weight = 1.0 / (linear.residual_covariance[members, members] * size * size)
    turned = -weight * (square / size) ** 2
    return float(weight @ spread), complex(turned @ pseudo.conj())


def _own_errors(
    away: np.ndarray, covariance: np.ndarray, of_set: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the variances xx + yy and xx - yy + 2i xy (r,) of the landmarks' own errors.

    What moves or turns all of them alike moves home with them, and is left out. They are seen from
    home at `away` (r,), complex, and are the numbers `of_set` (r,) of what is known, in pairs.
    """
    centred = away - away.sum() / len(away)
    rigid = np.zeros((3, len(covariance) // 2), complex)
    motions = np.empty((3, len(away)), complex)
    motions[0], motions[1] = 1.0 / math.sqrt(len(away)), 1j / math.sqrt(len(away))
    motions[2] = 1j / max(math.sqrt(np.vdot(centred, centred).real), 1e-6) * centred
    rigid[:, of_set] = motions
    # With B an orthonormal basis of that, the own errors are (I - B B^T) C (I - B B^T).
    basis = rigid.view(float)
    shared = basis @ covariance
    shared -= 0.5 * (shared @ basis.T) @ basis
    without = shared.view(complex)[:, of_set]
    variance, mixed = covariance.diagonal(), covariance.diagonal(1)
    xx, xy, yy = variance[::2][of_set], mixed[::2][of_set], variance[1::2][of_set]
    spread = xx + yy - 2.0 * (motions.conj() * without).sum(axis=0).real
    return spread, xx - yy + 2j * xy - 2.0 * (motions * without).sum(axis=0)
