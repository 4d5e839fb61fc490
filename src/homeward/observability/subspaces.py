"""Spans of columns: what two have in common, and what one adds to another."""

from __future__ import annotations

import numpy as np


def common(null: np.ndarray, block: np.ndarray, tolerance: float) -> np.ndarray:
    """Return an orthonormal basis of what two orthonormal bases span in common."""
    if not null.size or not block.size:
        return np.zeros((len(null), 0))
    u, cosines, _ = np.linalg.svd(null.T @ block)
    inside = np.sqrt(np.maximum(1 - np.minimum(cosines, 1.0) ** 2, 0.0)) < max(tolerance, 1e-7)
    return np.asarray(null @ u[:, : int(inside.sum())])


def beyond(found: np.ndarray, told: np.ndarray) -> np.ndarray:
    """Return those directions in the span of `found` that add to the span of `told`."""
    if not found.size or not told.size:
        return found
    _, sizes, v = np.linalg.svd(found - told @ (told.T @ found))
    return np.asarray(found @ v[: sizes.size][sizes > 1e-3].T)


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the span of independent columns."""
    if not columns.size:
        return np.zeros((len(columns), 0))
    return np.asarray(np.linalg.qr(columns)[0])
