"""Which features of two panoramas look alike."""

from __future__ import annotations

import numpy as np

RATIO = 0.85
"""The nearest descriptor must be this much nearer than the second (Lowe)."""


def match(a: np.ndarray, b: np.ndarray, ratio: float = RATIO) -> tuple[np.ndarray, np.ndarray]:
    """Match descriptors: each other's nearest, and clearly nearer than the second.

    Parameters
    ----------
    a, b : ndarray of float32, shapes (n, k) and (m, k)
        Unit vectors.
    ratio : float
        Of the distances to the nearest and the second, in both directions.

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
    forth, forth_ratio = _nearest(likeness)
    back, back_ratio = _nearest(likeness.T)
    rows = np.arange(len(a))
    worst = np.maximum(forth_ratio, back_ratio[forth])
    kept = (back[forth] == rows) & (worst < ratio)
    return np.column_stack([rows, forth])[kept], worst[kept]


def _nearest(likeness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the column of each row's greatest value, and the ratio of the two least distances."""
    rows, best = np.arange(len(likeness)), likeness.argmax(axis=1)
    others = likeness.copy()
    others[rows, best] = -np.inf
    nearest, second = likeness[rows, best], others.max(axis=1)
    squared = np.maximum(2.0 - 2.0 * np.stack([second, nearest]), 1e-12)
    return best, np.sqrt(squared[1] / squared[0])
