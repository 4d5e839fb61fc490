"""Sparse linear least squares."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu


class LeastSquares:
    """A linearised problem with a number of `unknowns`, to which rows are added."""

    def __init__(self, unknowns: int) -> None:
        self._unknowns, self._count = unknowns, 0
        self._residuals: list[np.ndarray] = []
        self._entries: list[tuple[np.ndarray, ...]] = []

    def add(
        self,
        residuals: np.ndarray,
        weights: np.ndarray,
        *terms: tuple[np.ndarray | int, np.ndarray | float],
    ) -> None:
        """Add m rows: residuals, measured minus expected, and the inverse of their sigmas.

        Each term has columns and slopes, (m,) or one for all: unknowns, and the derivatives of the
        expected values with respect to them.
        """
        rows = self._count + np.arange(residuals.size)
        self._residuals.append(residuals * weights)
        for columns, slopes in terms:
            self._entries.append((rows, np.broadcast_to(columns, rows.shape), slopes * weights))
        self._count += residuals.size

    def solve(self, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the step (n,) of all unknowns, and the covariance (k, k) of those in `wanted`."""
        rows, columns, slopes = (np.concatenate(e) for e in zip(*self._entries, strict=True))
        jacobian = csc_array((slopes, (rows, columns)), shape=(self._count, self._unknowns))
        information = splu(csc_array(jacobian.T @ jacobian))
        unit = np.zeros((self._unknowns, wanted.size))
        unit[wanted, np.arange(wanted.size)] = 1.0
        step = information.solve(jacobian.T @ np.concatenate(self._residuals))
        return np.asarray(step), np.asarray(information.solve(unit)[wanted])
