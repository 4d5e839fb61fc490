"""Descriptor matching: mutual nearest neighbours that pass Lowe's ratio test."""

from __future__ import annotations

import numpy as np

RATIO = 0.85
"""Maximum ratio of the distances to the nearest and the second descriptor (Lowe, IJCV 2004)."""
EXCLUDED = -1.0
"""Cosine of opposite descriptors: excludes a pair."""


def match(
    a: np.ndarray, b: np.ndarray, ratio: float = RATIO, possible: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Match descriptors: mutual nearest neighbours, clearly nearer than the second.

    Parameters
    ----------
    a, b : ndarray of float32, shapes (n, k) and (m, k)
        Unit vectors.
    ratio : float
        Maximum ratio of the distances to the nearest and the second, in both directions.
    possible : ndarray of bool, shape (n, m), optional
        Pairs that may show the same; others are neither the nearest nor the second.

    Returns
    -------
    pairs : ndarray of int, shape (p, 2)
        Rows of `a` and `b`.
    quality : ndarray, shape (p,)
        The larger of the two ratios, in [0, ratio]; smaller is better.
    """
    if len(a) < 2 or len(b) < 2:
        return np.zeros((0, 2), int), np.zeros(0)
    cosine = a @ b.T
    if possible is not None:
        cosine[~possible] = EXCLUDED
    forth = cosine.argmax(axis=1)
    nearest = cosine[np.arange(len(a)), forth]
    rows = np.flatnonzero((nearest == cosine.max(axis=0)[forth]) & (nearest > EXCLUDED))
    # Of several identical rows, the first; the others are then the second nearest.
    rows = np.sort(rows[np.unique(forth[rows], return_index=True)[1]])
    nearest, columns = nearest[rows], forth[rows]
    cosine[rows, columns] = EXCLUDED
    second = np.maximum(cosine.max(axis=1)[rows], cosine.max(axis=0)[columns])
    ratios = np.sqrt(_squared_distance(nearest) / _squared_distance(second))
    kept = ratios < ratio
    return np.column_stack([rows, columns])[kept], ratios[kept]


def _squared_distance(cosine: np.ndarray) -> np.ndarray:
    return np.asarray(np.maximum(2.0 - 2.0 * cosine, 1e-12))
