"""Numerical rank and null space of a matrix, and intersections of spans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ZERO = 1e-10
"""Scaled singular values below this share of the largest count as zero."""
CLEAR = 1e4
"""Smallest factor between the last singular value counted and the first one not counted."""
SWEEPS = 3
"""Number of alternating scalings of rows and columns."""


@dataclass(frozen=True)
class Rank:
    """The rank of a matrix with n columns."""

    value: int
    singular_values: np.ndarray
    """(n,), of the scaled matrix, relative to the largest, descending."""
    null: np.ndarray
    """(n, n - value), columns that span the null space, in the units of the matrix's columns."""

    @property
    def gap(self) -> float:
        """Ratio of the last singular value counted to the first one not counted."""
        if self.value in (0, self.singular_values.size):
            return np.inf
        kept, dropped = self.singular_values[self.value - 1 : self.value + 1]
        return float(kept / dropped) if dropped > 0 else np.inf

    @property
    def clear(self) -> bool:
        """Whether floats are precise enough for a decision."""
        last = self.singular_values[self.value - 1] if self.value else 1.0
        return bool(self.gap > CLEAR and last > ZERO * CLEAR)


def rank(matrix: np.ndarray, columns: np.ndarray | None = None) -> Rank:
    """Return rank and null space of a matrix (m, n) by its scaled singular values.

    `columns` is the unit of each column. By default rows and columns are scaled alternately until
    all norms are near one, so that units do not matter.
    """
    scale = np.ones(matrix.shape[1]) if columns is None else columns
    scaled = matrix * scale
    if columns is None:
        for _ in range(SWEEPS):
            scaled = scaled / _norms(scaled, axis=1)[:, None]
            by_column = _norms(scaled, axis=0)
            scaled, scale = scaled / by_column, scale / by_column
    n = matrix.shape[1]
    padded = np.vstack([scaled, np.zeros((max(0, n - len(scaled)), n))])
    _, values, directions = np.linalg.svd(padded, full_matrices=False)
    relative = values / max(float(values[0]), 1e-300)
    value = int((relative > ZERO).sum()) if values[0] > 0 else 0
    return Rank(value, relative, scale[:, None] * directions[value:].T)


def _norms(matrix: np.ndarray, axis: int) -> np.ndarray:
    norms = np.linalg.norm(matrix, axis=axis)
    # A row or column of rounding errors must not be scaled up.
    return np.where(norms > ZERO * norms.max(), norms, 1.0)


def common(null: np.ndarray, block: np.ndarray, tolerance: float) -> np.ndarray:
    """Return an orthonormal basis of the intersection of the spans of two orthonormal bases."""
    if not null.size or not block.size:
        return np.zeros((len(null), 0))
    u, cosines, _ = np.linalg.svd(null.T @ block)
    inside = np.sqrt(np.maximum(1 - np.minimum(cosines, 1.0) ** 2, 0.0)) < max(tolerance, 1e-7)
    return np.asarray(null @ u[:, : int(inside.sum())])


def beyond(found: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the directions in the span of `found` that add to the span of `known`."""
    if not found.size or not known.size:
        return found
    _, sizes, v = np.linalg.svd(found - known @ (known.T @ found))
    return np.asarray(found @ v[: sizes.size][sizes > 1e-3].T)


def orthonormal(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the span of independent columns."""
    if not columns.size:
        return np.zeros((len(columns), 0))
    return np.asarray(np.linalg.qr(columns)[0])
