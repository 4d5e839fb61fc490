"""Whitened residuals of a set of inliers: all that least squares asks for, as dot products.

With S = L L^T the covariance of the residuals, L^-1 makes them independent and of unit variance.
What depends on them, or is correlated with them, is whitened likewise, once; the products of these
columns are the information on home, the gain of the newest pose, and what predicts the others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotri, dtrtrs

from homeward.localizer.home.linearisation import RESIDUAL, REST, Linear

IDENTITY = np.eye(3)


@dataclass(frozen=True)
class Whitened:
    """A set of r home bearings out of q, whitened."""

    members: np.ndarray
    """(r,), int: the set."""
    rest: np.ndarray
    """(q - r,), int: the others."""
    root: np.ndarray
    """(r, r): lower Cholesky factor of the covariance of the set's residuals; nothing above."""
    columns: np.ndarray
    """(r, 7 + q - r): whitened Jacobian, residual and correlations."""
    products: np.ndarray
    """(7 + q - r, 7 + q - r): of the columns with each other."""

    @property
    def log_volume(self) -> float:
        """Log of the determinant of the covariance of the set's residuals."""
        return 2.0 * sum(map(math.log, self.root.diagonal().tolist()))

    @cached_property
    def weighted(self) -> np.ndarray:
        """(r, 4): Jacobian by home and residual, times the inverse of that covariance."""
        columns = self.columns[:, : RESIDUAL + 1]
        return np.asarray(
            dtrtrs(self.root, columns, lower=1, trans=1)[0] if columns.size else columns
        )

    @property
    def precision(self) -> np.ndarray:
        """(r,): diagonal of the inverse of that covariance."""
        root = self.root  # LAPACK knows no empty one
        return np.asarray(dpotri(root, lower=1)[0].diagonal() if root.size else np.zeros(0))


def whitened(linear: Linear, inliers: np.ndarray) -> Whitened | None:
    """Whiten a set of inliers (q,), bool; None when its covariance is not positive definite."""
    members, rest, across, asked = _places(inliers.tobytes())
    rows = linear.columns.take(members, axis=0)
    root, failed = dpotrf(rows.take(across, axis=1).T, lower=1, clean=0, overwrite_a=1)
    if failed:
        return None
    columns = rows.take(asked, axis=1)
    if members.size:
        columns = dtrtrs(root, columns, lower=1)[0]
    return Whitened(members, rest, root, columns, columns.T @ columns)


@lru_cache(maxsize=64)
def _places(inliers: bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the set and the others, and where in a row their covariance and what is asked are."""
    of_set = np.frombuffer(inliers, bool)
    members, rest = of_set.nonzero()[0], (~of_set).nonzero()[0]
    asked = np.concatenate([np.arange(REST.start), REST.start + rest])
    return members, rest, REST.start + members, asked


def inverted(information: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the inverse of information (3, 3) on home, and the log of the latter's determinant.

    Raises
    ------
    numpy.linalg.LinAlgError
        If home is not fixed.
    """
    root, inverse, failed = dposv(information, IDENTITY)
    if failed:
        raise np.linalg.LinAlgError("home is not fixed")
    return inverse, 2.0 * math.log(math.prod(root.diagonal().tolist()))
