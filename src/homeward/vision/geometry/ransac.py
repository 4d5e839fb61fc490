"""RANSAC with MSAC scores (Torr and Zisserman, CVIU 2000), then robust refinement.

The minimal solver takes two matches. With level cameras at one height, t . (x1 x R x2) is linear in
k = (cos theta, sin theta, cos(alpha - theta), sin(alpha - theta)):

    [x1y x2z, -x1x x2z, -x1z x2y, -x1z x2x] k = 0

Two matches give A x = B y, x and y being the halves of k. With y = M x, M = B^-1 A, and both of
unit length, theta follows from a quadratic equation in x. The sign of x follows from the distances
along the rays, which must be positive.
"""

from __future__ import annotations

import numpy as np

from homeward.geometry.angles import wrap
from homeward.vision.geometry.epipolar import INLIER, Pairs
from homeward.vision.geometry.refinement import Fit, refine

SAMPLES = 800
"""Number of pairs of matches that are drawn."""
CANDIDATES = 12
"""Number of best motions that are refined, each in both directions of travel. The covariance needs
the other minima, too."""
APART = 0.1
"""Minimum difference in theta or alpha between two candidates [rad]."""


def estimate_motion(pairs: Pairs, quality: np.ndarray, tilt_sigma: float) -> Fit | None:
    """Find the motion between two panoramas from all matches.

    Matches of smaller `quality` (n,) are better, and drawn more often; `tilt_sigma` is as for
    `irls`. None if there are fewer than three matches, or no motion fits two of them.
    """
    if len(pairs) < 3:
        return None
    chosen = _candidates(pairs, quality, tilt_sigma)
    if not len(chosen):
        return None
    starts = np.zeros((2, len(chosen), 5))
    starts[..., :2] = chosen, chosen + np.array([np.pi, 0.0])
    # Near home, only exact positions distinguish the two directions of travel.
    return refine(starts.reshape(-1, 5), pairs, tilt_sigma)


def _candidates(pairs: Pairs, quality: np.ndarray, tilt_sigma: float) -> np.ndarray:
    """Return the best distinct solutions, (k, 2), of many samples."""
    rows = coefficients(pairs.home_vectors, pairs.now_vectors)
    first, second = _samples(quality)
    motions = np.concatenate([two_point_motions(rows[first], rows[second]), _turns(pairs, first)])
    total = msac_costs(motions, pairs, tilt_sigma, INLIER**2)
    return _distinct(motions[np.argsort(total, kind="stable")])


def _distinct(motions: np.ndarray) -> np.ndarray:
    """Return the first motions, (k, 2), that differ from all before, in any direction of travel."""
    free = np.ones(len(motions), bool)
    chosen: list[int] = []
    way, turned = np.exp(1j * motions.T)
    while len(chosen) < CANDIDATES and free.any():
        i = int(free.argmax())
        chosen.append(i)
        apart = np.abs((way * way[i].conj()).imag) > APART
        free &= apart | ((turned * turned[i].conj()).real < 1 - APART**2 / 2)
    return motions[chosen]


def _turns(pairs: Pairs, rows: np.ndarray) -> np.ndarray:
    """Return a rotation without translation, (k, 2), from some matches: the motion at home."""
    some = np.unique(rows)
    alpha = wrap(pairs.home[some, 0] - pairs.now[some, 0])
    return np.column_stack([np.zeros(some.size), alpha])


def _samples(quality: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Draw pairs of matches with a fixed seed; the first is from the better half."""
    rng, n = np.random.default_rng(0), quality.size
    order = np.argsort(quality, kind="stable")
    first = order[rng.integers(0, max(2, (n + 1) // 2), SAMPLES)]
    second = rng.integers(0, n, SAMPLES)
    different = first != second
    return first[different], second[different]


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
    """Return the motions, theta and alpha (m, 2) [rad], that are consistent with two matches.

    `first` and `second` (s, 4) are the `coefficients` of both matches of each sample. Of each real
    solution, theta is in (-pi/2, pi/2]: theta + pi, with the same alpha, is one as well.
    """
    a, b, c, d = -first[:, 2], -first[:, 3], -second[:, 2], -second[:, 3]
    determinant = a * d - b * c
    # N = adj(B) A, so that y = N x / det(B), without a division by det(B).
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


def msac_costs(
    motions: np.ndarray, pairs: Pairs, tilt_sigma: float, max_square: float
) -> np.ndarray:
    """Return the MSAC cost, (m,), of motions, for theta or theta + pi.

    It is the sum over matches of the squared normalised residual, at most `max_square` each.
    Motions are theta and alpha, (m, 2) [rad]; `tilt_sigma` is that of each elevation [rad].
    """
    theta, turn = motions[:, 0], motions[:, 1] - motions[:, 0]
    k = np.stack([np.cos(theta), np.sin(theta), np.cos(turn), np.sin(turn)]).astype(np.float32)
    x1, x2 = pairs.home_vectors, pairs.now_vectors
    by_azimuth, by_elevation = pairs.now_tangents
    first, both, second = pairs.covariance.T[..., None]
    # Lower Cholesky root.
    along = np.sqrt(first + 1e-12)
    mixed = both / along
    rest = np.sqrt(np.maximum(second - mixed**2, 0.0) + tilt_sigma**2)
    rows = [
        coefficients(x1, x2),
        coefficients(x1, by_azimuth * along + by_elevation * mixed),
        coefficients(x1, by_elevation * rest),
    ]
    value, *slopes = (row.astype(np.float32) @ k for row in rows)
    variance = sum(slope * slope for slope in slopes)
    return np.asarray(np.minimum(value * value / (variance + 1e-16), max_square).sum(axis=0))
