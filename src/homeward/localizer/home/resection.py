"""Home by resection: the camera's pose from the home bearings of mapped landmarks.

Three bearings to known points determine a pose (unless it is on the circle through them). So poses
are computed from triples of landmarks, and scored by all landmarks under a mixture: a home bearing
is either an inlier, with the landmark's own uncertainty included, or a uniform outlier.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import combinations

import numpy as np

from homeward.geometry.angles import TWO_PI, wrap
from homeward.geometry.se2 import compose, sight
from homeward.localizer.reference.labels import moved_share
from homeward.localizer.tunables import MAX_RANGE, MAX_TRIPLES, OFFSET_STEPS


def poses_from_triples(
    points: np.ndarray, bearings: np.ndarray, offsets: np.ndarray | None = None
) -> np.ndarray:
    """Return the pose from each triple of landmarks (Pierlot and Van Droogenbroeck, 2014, ToTal).

    From landmarks `points` (q, 2) [m] and their bearings (q,) [rad] seen from the unknown pose: the
    finite poses of the camera (k, 3), x [m], y [m], heading [rad]. `offsets` (q, 3) are the poses
    of several cameras in the frame of the first one, whose poses are returned: its bearings are
    predicted from the pose found before.
    """
    triples = _triples(len(bearings))
    with np.errstate(divide="ignore", invalid="ignore"):
        if offsets is None:
            eyes = _from_triples(points, *triples.T, *bearings[triples].T)
        else:
            places, own = points[triples], offsets[triples]
            eyes = _from_triples(points, *triples.T, *(bearings[triples] + own[..., 2]).T)
            for _ in range(OFFSET_STEPS):
                first, each = eyes[:, None], compose(eyes[:, None], own)
                change = sight(first, places).bearing - sight(each, places).bearing
                eyes = _from_triples(points, *triples.T, *(bearings[triples] + change).T)
    reach = MAX_RANGE * np.ptp(points, axis=0).max()
    near = np.abs(eyes[:, :2] - points.mean(axis=0)).max(axis=1) < reach
    return np.asarray(eyes[np.isfinite(eyes).all(axis=1) & near])


def _from_triples(
    points: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    c: np.ndarray,
    to_a: np.ndarray,
    to_b: np.ndarray,
    to_c: np.ndarray,
) -> np.ndarray:
    """Return a pose (k, 3) for each triple of `points`: indices (k,) and bearings (k,) [rad]."""
    cot_ab = 1.0 / np.tan(to_b - to_a)
    cot_bc = 1.0 / np.tan(to_c - to_b)
    cot_ca = (1.0 - cot_ab * cot_bc) / (cot_ab + cot_bc)
    x1, y1 = (points[a] - points[b]).T
    x3, y3 = (points[c] - points[b]).T
    x12, y12 = x1 + cot_ab * y1, y1 - cot_ab * x1
    x23, y23 = x3 - cot_bc * y3, y3 + cot_bc * x3
    x31, y31 = (x3 + x1) + cot_ca * (y3 - y1), (y3 + y1) - cot_ca * (x3 - x1)
    k31 = x1 * x3 + y1 * y3 + cot_ca * (x1 * y3 - x3 * y1)
    determinant = (x12 - x23) * (y23 - y31) - (y12 - y23) * (x23 - x31)
    x = points[b, 0] + k31 * (y12 - y23) / determinant
    y = points[b, 1] + k31 * (x23 - x12) / determinant
    eyes = np.stack([x, y, to_a], axis=1)
    eyes[:, 2] = wrap(sight(eyes, points[a]).bearing)
    return eyes


def innovations_from(
    poses: np.ndarray,
    points: np.ndarray,
    covariances: np.ndarray,
    bearings: np.ndarray,
    offsets: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return innovations (k, q) [rad] of bearings at each pose, and their variance by the map.

    From camera poses (k, 3), landmarks `points` (q, 2) [m] with covariances (q, 2, 2), and bearings
    (q,) [rad]; `offsets` as in `poses_from_triples`.
    """
    eyes = poses[:, None] if offsets is None else compose(poses[:, None], offsets)
    bearing, by_place, _ = sight(eyes, points)
    gx, gy = by_place[..., 0], by_place[..., 1]
    (xx, xy), (_, yy) = covariances.transpose(1, 2, 0)
    return wrap(bearings - bearing), gx * (xx * gx + 2.0 * xy * gy) + yy * gy * gy


def mixture_scores(
    off: np.ndarray, variance: np.ndarray, sigmas: np.ndarray, moved_prior: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the log likelihood of each pose (k,), and its inlier bearings (k, q), bool.

    `off` and `variance` are of `innovations_from`, `sigmas` (q,) of the bearings [rad];
    `moved_prior` is the prior probability that a landmark moved.
    """
    variance, q = variance + sigmas**2, sigmas.size
    exponent = -0.5 * off**2 / variance
    # Underflow would make the exponential many times slower.
    inlier = np.exp(np.maximum(exponent, -700.0)) / np.sqrt(variance)
    inlier *= math.sqrt(TWO_PI)  # against the uniform density
    right = (1.0 - moved_prior) * inlier > moved_prior
    number = np.arange(q + 1)
    share = moved_share(number, q - number, moved_prior)[np.count_nonzero(right, axis=1), None]
    return np.log((1.0 - share) * inlier + share).sum(axis=1), right


@lru_cache(maxsize=64)
def _triples(q: int) -> np.ndarray:
    """Return triples of q indices, shape (k, 3)."""
    if math.comb(q, 3) <= MAX_TRIPLES:
        return np.array(list(combinations(range(q), 3)), int).reshape(-1, 3)
    draw = np.random.default_rng(0)
    return np.argsort(draw.random((MAX_TRIPLES, q)), axis=1)[:, :3]
