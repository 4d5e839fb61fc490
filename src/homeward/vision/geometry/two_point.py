"""Minimal solver: planar motion from two matches, in closed form; and MSAC scores of motions.

With level cameras at one height, t . (x1 x R x2) is linear in
k = (cos theta, sin theta, cos(alpha - theta), sin(alpha - theta)):

    [x1y x2z, -x1x x2z, -x1z x2y, -x1z x2x] k = 0

Two matches give A x = B y, x and y being the halves of k. With y = M x, M = B^-1 A, and both of
unit length, theta follows from a quadratic equation in x. The sign of x is left to the distances
along the rays, which must be positive.
"""

from __future__ import annotations

import numpy as np

from homeward.angles import wrap
from homeward.vision.geometry.epipolar import Pairs


def coefficients(home: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Return the coefficients of the linear equation in k of each pair of vectors, (..., 4)."""
    return np.stack(
        [
            home[..., 1] * now[..., 2],
            -home[..., 0] * now[..., 2],
            -home[..., 2] * now[..., 1],
            -home[..., 2] * now[..., 0],
        ],
        axis=-1,
    )


def two_point_motions(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the motions that two matches allow.

    Parameters
    ----------
    first, second : ndarray, shape (s, 4)
        Rows of the two matches of each sample, from `coefficients`.

    Returns
    -------
    ndarray, shape (m, 2)
        theta and alpha [rad] of all real solutions, theta in (-pi/2, pi/2]: theta + pi, with the
        same alpha, solves the equations as well.
    """
    a, b, c, d = -first[:, 2], -first[:, 3], -second[:, 2], -second[:, 3]
    determinant = a * d - b * c
    # N = adj(B) A, so that y = N x / det(B), and nothing is divided by it.
    n11, n12 = (d * first[:, i] - b * second[:, i] for i in (0, 1))
    n21, n22 = (a * second[:, i] - c * first[:, i] for i in (0, 1))
    p = (n11**2 + n21**2 - n12**2 - n22**2) / 2
    q = n11 * n12 + n21 * n22
    r = determinant**2 - (n11**2 + n21**2 + n12**2 + n22**2) / 2
    size = np.hypot(p, q)
    real = (np.abs(r) <= size) & (size > 0)
    p, q, r, size, sign = p[real], q[real], r[real], size[real], np.sign(determinant[real])
    n11, n12, n21, n22 = n11[real], n12[real], n21[real], n22[real]
    middle, half = np.arctan2(q, p), np.arccos(r / size)
    theta = np.concatenate([middle + half, middle - half]) / 2
    x1, x2 = np.cos(theta), np.sin(theta)
    n11, n12, n21, n22, sign = (np.tile(v, 2) for v in (n11, n12, n21, n22, sign))
    turn = np.arctan2(sign * (n21 * x1 + n22 * x2), sign * (n11 * x1 + n12 * x2))
    alpha = wrap(turn + theta)
    flipped = np.where(np.cos(theta) < 0, theta + np.pi, theta)
    return np.column_stack([wrap(flipped), alpha])


def msac_costs(motions: np.ndarray, pairs: Pairs, tolerance: float, most: float) -> np.ndarray:
    """Return the MSAC cost (Torr and Zisserman, CVIU 2000) of motions, theta or theta + pi.

    Parameters
    ----------
    motions : ndarray, shape (m, 2)
        theta and alpha [rad].
    pairs : Pairs
        All matches.
    tolerance : float
        Added to the deviation of each elevation [rad]: what tilt may do.
    most : float
        Squared normalised residual of a match that does not fit.

    Returns
    -------
    ndarray, shape (m,)
        Sum over matches of the squared normalised residual, at most `most` each.
    """
    theta, turn = motions[:, 0], motions[:, 1] - motions[:, 0]
    k = np.stack([np.cos(theta), np.sin(theta), np.cos(turn), np.sin(turn)]).astype(np.float32)
    x1, x2 = pairs.home_vectors, pairs.now_vectors
    by_azimuth, by_elevation = pairs.now_tangents
    first, both, second = pairs.spread.T[..., None]
    # The lower Cholesky root.
    along = np.sqrt(first + 1e-12)
    mixed = both / along
    rest = np.sqrt(np.maximum(second - mixed**2, 0.0) + tolerance**2)
    rows = [
        coefficients(x1, x2),
        coefficients(x1, by_azimuth * along + by_elevation * mixed),
        coefficients(x1, by_elevation * rest),
    ]
    value, *slopes = (row.astype(np.float32) @ k for row in rows)
    variance = sum(slope * slope for slope in slopes)
    return np.asarray(np.minimum(value * value / (variance + 1e-16), most).sum(axis=0))
