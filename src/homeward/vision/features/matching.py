"""Descriptor matching: mutual nearest neighbours that pass Lowe's ratio test."""

from __future__ import annotations

import numpy as np

RATIO = 0.85
"""Of the distances to the nearest and the second descriptor (Lowe, IJCV 2004)."""

NEVER = -1.0
"""Likeness (cosine) of opposite descriptors: such a pair is excluded."""


def match(
    a: np.ndarray, b: np.ndarray, ratio: float = RATIO, possible: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Match descriptors: each other's nearest, and clearly nearer than the second.

    Parameters
    ----------
    a, b : ndarray of float32, shapes (n, k) and (m, k)
        Unit vectors.
    ratio : float
        Of the distances to the nearest and the second, in both directions.
    possible : ndarray of bool, shape (n, m), optional
        Which may show the same; others are neither the nearest nor the second.

    Returns
    -------
    pairs : ndarray of int, shape (p, 2)
        Rows of `a` and `b`.
    quality : ndarray, shape (p,)
        The larger of the two ratios, in [0, ratio]; small is good.
    """
    if len(a) < 2 or len(b) < 2:
        return np.zeros((0, 2), int), np.zeros(0)
    likeness = a @ b.T
    if possible is not None:
        likeness[~possible] = NEVER
    forth = likeness.argmax(axis=1)
    nearest = likeness[np.arange(len(a)), forth]
    rows = np.flatnonzero((nearest == likeness.max(axis=0)[forth]) & (nearest > NEVER))
    # Of several rows that are the same, the first: the others are then its seconds.
    rows = np.sort(rows[np.unique(forth[rows], return_index=True)[1]])
    nearest, columns = nearest[rows], forth[rows]
    likeness[rows, columns] = NEVER
    second = np.maximum(likeness.max(axis=1)[rows], likeness.max(axis=0)[columns])
    ratios = np.sqrt(_squared_distance(nearest) / _squared_distance(second))
    kept = ratios < ratio
    return np.column_stack([rows, columns])[kept], ratios[kept]


def _squared_distance(likeness: np.ndarray) -> np.ndarray:
    return np.asarray(np.maximum(2.0 - 2.0 * likeness, 1e-12))
