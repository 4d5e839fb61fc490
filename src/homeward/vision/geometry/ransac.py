"""RANSAC with MSAC scores (Torr and Zisserman, CVIU 2000), then robust refinement."""

from __future__ import annotations

import numpy as np

from homeward.angles import wrap
from homeward.vision.geometry.epipolar import INLIER, Pairs
from homeward.vision.geometry.refinement import Fit, refine
from homeward.vision.geometry.two_point import coefficients, msac_costs, two_point_motions

SAMPLES = 800
"""So many pairs of matches are drawn."""
CANDIDATES = 12
"""So many of the best are refined, each in both directions of travel. What else the matches may say
is needed for the covariance."""
APART = 0.1
"""Motions are different that differ by this in theta or alpha [rad]."""


def estimate_motion(pairs: Pairs, quality: np.ndarray, tilt_sigma: float) -> Fit | None:
    """Find the motion between two panoramas.

    Parameters
    ----------
    pairs : Pairs
        All matches.
    quality : ndarray, shape (n,)
        Of each match; small is good: good ones are tried more often.
    tilt_sigma : float
        How far each camera may be tilted from what is known [rad].

    Returns
    -------
    Fit or None
        None when there are fewer than three matches or no motion at all fits two of them.
    """
    if len(pairs) < 3:
        return None
    chosen = _candidates(pairs, quality, tilt_sigma)
    if not len(chosen):
        return None
    starts = np.zeros((2, len(chosen), 5))
    starts[..., :2] = chosen, chosen + np.array([np.pi, 0.0])
    # Near home, which way round is told only by places as exactly known as they are.
    return refine(starts.reshape(-1, 5), pairs, tilt_sigma)


def _candidates(pairs: Pairs, quality: np.ndarray, tilt_sigma: float) -> np.ndarray:
    """Return the best solutions, (k, 2), of many samples that differ from each other."""
    rows = coefficients(pairs.home_vectors, pairs.now_vectors)
    first, second = _samples(quality)
    motions = np.concatenate([two_point_motions(rows[first], rows[second]), _turns(pairs, first)])
    total = msac_costs(motions, pairs, tilt_sigma, INLIER**2)
    return _distinct(motions[np.argsort(total, kind="stable")])


def _distinct(motions: np.ndarray) -> np.ndarray:
    """Return the first motions, (k, 2), that differ from all before, whichever way travelled."""
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
    """Return a turn without translation, (k, 2), from each of some matches: the motion at home."""
    some = np.unique(rows)
    alpha = wrap(pairs.home[some, 0] - pairs.now[some, 0])
    return np.column_stack([np.zeros(some.size), alpha])


def _samples(quality: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Draw pairs of matches, the same every time; one of each from the better half."""
    rng, n = np.random.default_rng(0), quality.size
    order = np.argsort(quality, kind="stable")
    first = order[rng.integers(0, max(2, (n + 1) // 2), SAMPLES)]
    second = rng.integers(0, n, SAMPLES)
    different = first != second
    return first[different], second[different]
