"""Robust least squares: graduated non-convexity, and sparse problems of many unknowns.

Graduated non-convexity (Blake and Zisserman, 1987; Yang et al., 2020) begins with a loss that is
convex, since all errors are expected to be large, and ends with the robust one: Geman and
McClure's, by which outliers lose their weight.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

GNC_SCHEDULE = 1.0, 0.5, 0.25, 0.1, 0.0, 0.0
"""Graduated non-convexity: by step, the share of its error a priori that the first guess is
expected to have in addition to the noise [1]."""


def robust_weight(squares: np.ndarray) -> np.ndarray:
    """Return Geman and McClure's weights of squared residuals, each over its scale squared."""
    return np.asarray((1.0 + squares) ** -2)


def robust_loss(squares: np.ndarray) -> np.ndarray:
    """Return Geman and McClure's losses of squared residuals, each over its scale squared."""
    return np.asarray(squares / (1.0 + squares))


class LeastSquares:
    """Linearised problem of a number of unknowns, to which rows are added."""

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
        """Add m rows.

        Parameters
        ----------
        residuals : ndarray, shape (m,)
            Measured minus expected.
        weights : ndarray, shape (m,)
            One over their standard deviations.
        *terms : (columns, slopes), each (m,) or one for all
            Unknowns, and the derivative of what is expected by each.
        """
        rows = self._count + np.arange(residuals.size)
        self._residuals.append(residuals * weights)
        for columns, slopes in terms:
            self._entries.append((rows, np.broadcast_to(columns, rows.shape), slopes * weights))
        self._count += residuals.size

    def solve(self, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the step (n,) of all unknowns, and the covariance (k, k) of those `wanted`."""
        rows, columns, slopes = (np.concatenate(e) for e in zip(*self._entries, strict=True))
        jacobian = csc_array((slopes, (rows, columns)), shape=(self._count, self._unknowns))
        information = splu(csc_array(jacobian.T @ jacobian))
        unit = np.zeros((self._unknowns, wanted.size))
        unit[wanted, np.arange(wanted.size)] = 1.0
        step = information.solve(jacobian.T @ np.concatenate(self._residuals))
        return np.asarray(step), np.asarray(information.solve(unit)[wanted])
