"""From matches, most of which may be wrong, to the motion that most of them agree on."""

from __future__ import annotations

import numpy as np

from homeward.vision.camera import unit_vectors
from homeward.vision.epipolar import Motion, Pairs, residuals
from homeward.vision.refine import INLIER, Fit, cost, refine
from homeward.vision.two_point import costs, rows_of, solve

SAMPLES = 800
"""Pairs of matches that are tried."""
CANDIDATES = 12
"""That are looked at closely, each travelled both ways."""
REFINED = 3
"""The best of them."""
APART = 0.1
"""Candidates must differ by this much in theta or alpha [rad]."""


def search(pairs: Pairs, quality: np.ndarray, tilt_sigma: float, seed: int = 0) -> Fit | None:
    """Find the motion between two panoramas.

    Parameters
    ----------
    pairs : Pairs
        All matches.
    quality : ndarray, shape (n,)
        Of each match; small is good: good ones are tried more often.
    tilt_sigma : float
        How far each camera may be tilted from what is known [rad].
    seed : int
        Of the choice of samples.

    Returns
    -------
    Fit or None
        None when there are fewer than three matches or no motion at all fits two of them.
    """
    if len(pairs) < 3:
        return None
    both_ways = [
        Motion(theta + turn, alpha)
        for theta, alpha in _candidates(pairs, quality, tilt_sigma, seed)
        for turn in (0.0, np.pi)
    ]
    loose = pairs.loosened(tilt_sigma)
    best = sorted(both_ways, key=lambda motion: cost(residuals(motion, loose)))[:REFINED]
    fits = [refine(motion, pairs, tilt_sigma) for motion in best]
    return min(fits, key=lambda fit: fit.cost, default=None)


def _candidates(
    pairs: Pairs, quality: np.ndarray, tilt_sigma: float, seed: int
) -> list[tuple[float, float]]:
    """Return the best solutions (theta, alpha) of many samples that differ from each other."""
    rows = rows_of(unit_vectors(*pairs.home.T), unit_vectors(*pairs.now.T))
    first, second = _samples(quality, seed)
    motions = solve(rows[first], rows[second])
    if not len(motions):
        return []
    total = costs(motions, pairs, tilt_sigma, INLIER**2)
    chosen: list[int] = []
    for i in np.argsort(total, kind="stable").tolist():
        if all(_apart(motions[i], motions[j]) for j in chosen):
            chosen.append(i)
        if len(chosen) == CANDIDATES:
            break
    return [(float(a), float(b)) for a, b in motions[chosen]]


def _samples(quality: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw pairs of matches; one of each from the better half."""
    rng, n = np.random.default_rng(seed), quality.size
    order = np.argsort(quality, kind="stable")
    first = order[rng.integers(0, max(2, (n + 1) // 2), SAMPLES)]
    second = rng.integers(0, n, SAMPLES)
    different = first != second
    return first[different], second[different]


def _apart(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two motions differ, whichever way round they are travelled."""
    d_theta, d_alpha = a - b
    return bool(abs(np.sin(d_theta)) > APART or abs(np.sin(d_alpha / 2)) > APART / 2)
