"""Home bearings, linearised around a home and a map, and whitening of sets of them.

With S = L L^T the covariance of a set's residuals, L^-1 makes them independent with unit variance.
Everything that depends on them or is correlated with them is whitened once in the same way. Least
squares needs products of these columns only: the information on home, the gain of the newest pose,
and predictions of the other home bearings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotri, dtrtrs

from homeward.geometry.angles import wrap
from homeward.geometry.se2 import compose, lever, sight
from homeward.localizer.home.problem import POSE_AND_YAW, YAW, HomeProblem
from homeward.localizer.tunables import CLOSE

HOME, RESIDUAL, POSE, REST = slice(0, 3), 3, slice(4, 7), slice(7, None)
"""Columns: Jacobian by home, residual, covariance with the newest pose, and with each other."""
IDENTITY = np.eye(3)


@dataclass(frozen=True)
class Linear:
    """Home bearings of a problem, linearised around a home and a map."""

    problem: HomeProblem
    at: np.ndarray
    """(3,): linearisation point of home."""
    by_state: np.ndarray
    """(q, 4 + 2 q): Jacobian of the expected home bearings by pose, yaw and landmarks."""
    cross_covariance: np.ndarray
    """(q, 4 + 2 q): their covariance with these."""
    columns: np.ndarray
    """(q, 7 + q): columns for least squares, a row for each home bearing."""
    fitted: Linear | None = None
    """The linearisation that this one was propagated from, when home was fitted last."""

    @property
    def by_home(self) -> np.ndarray:
        """(q, 3): Jacobian of the expected home bearings by home."""
        return self.columns[:, HOME]

    @property
    def residual(self) -> np.ndarray:
        """(q,): residuals, measured minus expected, at the mean of the map [rad]."""
        return self.columns[:, RESIDUAL]

    @property
    def residual_covariance(self) -> np.ndarray:
        """(q, q): covariance of the residuals given home."""
        return self.columns[:, REST]

    def propagated(self, problem: HomeProblem) -> Linear:
        """Return them at the same linearisation point after a small change of the map."""
        residual = self.residual - self.by_state @ (problem.mean - self.problem.mean)
        fitted = self.fitted or self
        return _linear(problem, self.at, residual, self.by_state, self.by_home, fitted)

    @property
    def has_changed(self) -> bool:
        """Whether a residual, or its variance, has changed notably since home was fitted."""
        then = self.fitted or self
        off, variance = self.residual - then.residual, then.residual_covariance.diagonal()
        wider = np.abs(self.residual_covariance.diagonal() - variance)
        return bool(((off**2 > CLOSE**2 * variance) | (wider > CLOSE * variance)).any())


def linearised(problem: HomeProblem, home: np.ndarray, state: np.ndarray) -> Linear:
    """Linearise the home bearings around `home` (3,) and pose, yaw, landmarks (4 + 2 q,)."""
    bearing, by_place, by_home, by_yaw = expected(
        problem, home, state[POSE_AND_YAW:].reshape(-1, 2), state[YAW], problem.offsets
    )
    by_state = np.zeros((bearing.size, state.size))
    if problem.same_camera:
        by_state[:, YAW] = by_yaw
    # Each is of one landmark: two elements of a row, one row down and two to the right.
    diagonal = by_state.ravel()[POSE_AND_YAW:]
    diagonal[:: state.size + 2], diagonal[1 :: state.size + 2] = by_place[:, 0], by_place[:, 1]
    residual = wrap(problem.bearings - bearing) + by_state @ (state - problem.mean)
    return _linear(problem, home, residual, by_state, by_home)


def expected(
    problem: HomeProblem,
    home: np.ndarray,
    places: np.ndarray,
    camera_yaw: float,
    offsets: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | float]:
    """Return the bearings (k,) of places (k, 2) from `home` (3,), and their Jacobians.

    The latter are by the place, (k, 2), by home, (k, 3), and by the camera's yaw; `camera_yaw`
    [rad] is its correction, if home's camera is the same, and `offsets` (k, 3) are as in
    `HomeProblem`.
    """
    eye = compose(home, problem.mount)
    if problem.same_camera:
        eye[2] += camera_yaw
    eyes = eye if offsets is None else compose(eye[None], offsets)
    bearing, by_place, _ = sight(eyes, places)
    by_eye = np.full((len(places), 3), -1.0)
    np.negative(by_place, out=by_eye[:, :2])
    if offsets is None:
        return bearing, by_place, by_eye @ lever(eye - home), -1.0
    by_first = (by_eye[:, None] @ lever(eyes - eye))[:, 0]
    return bearing, by_place, by_first @ lever(eye - home), by_first[:, 2]


def _linear(
    problem: HomeProblem,
    home: np.ndarray,
    residual: np.ndarray,
    by_state: np.ndarray,
    by_home: np.ndarray,
    fitted: Linear | None = None,
) -> Linear:
    """Return the linearisation with the covariances that follow from it."""
    q, cross_covariance = residual.size, by_state @ problem.covariance
    columns = np.empty((q, REST.start + q))
    columns[:, HOME], columns[:, RESIDUAL] = by_home, residual
    columns[:, POSE] = cross_covariance[:, :3]
    columns[:, REST] = cross_covariance @ by_state.T
    columns.ravel()[REST.start :: REST.start + q + 1] += problem.sigmas**2
    return Linear(problem, home, by_state, cross_covariance, columns, fitted)


@dataclass(frozen=True)
class Whitened:
    """Whitened set of r home bearings out of q."""

    members: np.ndarray
    """(r,), int: members of the set."""
    rest: np.ndarray
    """(q - r,), int: the others."""
    root: np.ndarray
    """(r, r): lower Cholesky factor of the covariance of the set's residuals; upper part undefined.
    """
    columns: np.ndarray
    """(r, 7 + q - r): whitened Jacobian, residual and covariances."""
    products: np.ndarray
    """(7 + q - r, 7 + q - r): products of the columns with each other."""

    @property
    def log_volume(self) -> float:
        """Log determinant of the covariance of the set's residuals."""
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
        root = self.root  # LAPACK accepts no empty matrix
        return np.asarray(dpotri(root, lower=1)[0].diagonal() if root.size else np.zeros(0))


def whitened(linear: Linear, inliers: np.ndarray) -> Whitened | None:
    """Whiten a set of inliers (q,), bool; None when its covariance is not positive definite."""
    members, rest, across, asked = _columns_of(inliers.tobytes())
    rows = linear.columns.take(members, axis=0)
    root, failed = dpotrf(rows.take(across, axis=1).T, lower=1, clean=0, overwrite_a=1)
    if failed:
        return None
    columns = rows.take(asked, axis=1)
    if members.size:
        columns = dtrtrs(root, columns, lower=1)[0]
    return Whitened(members, rest, root, columns, columns.T @ columns)


@lru_cache(maxsize=64)
def _columns_of(inliers: bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the set, the others, and the indices of their covariance and columns in a row."""
    of_set = np.frombuffer(inliers, bool)
    members, rest = of_set.nonzero()[0], (~of_set).nonzero()[0]
    asked = np.concatenate([np.arange(REST.start), REST.start + rest])
    return members, rest, REST.start + members, asked


def inverted(information: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the inverse of the information (3, 3) on home, and the latter's log determinant.

    `numpy.linalg.LinAlgError` if home is not determined.
    """
    root, inverse, failed = dposv(information, IDENTITY)
    if failed:
        raise np.linalg.LinAlgError("home is not determined")
    return inverse, 2.0 * math.log(math.prod(root.diagonal().tolist()))
