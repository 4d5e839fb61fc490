"""Schur complement of a chain of poses with shared unknowns (block-tridiagonal elimination).

The Hessian is block tridiagonal in the poses and dense in the shared unknowns. All poses but the
newest are eliminated at once by a banded Cholesky factor. This leaves the information on the newest
pose and the shared unknowns. The other poses follow by back substitution; or the remaining
information becomes the prior that replaces them (marginalisation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from homeward.localizer.map.state import HEAD

BAND = 6
"""Diagonals of the lower half of the chain's Hessian: a block of three and the next one."""


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations: Hessian and negative gradient of w poses and a shared unknowns."""

    own: np.ndarray
    """(w, 3, 3): diagonal blocks of the poses."""
    next: np.ndarray
    """(w - 1, 3, 3): blocks of each pose (rows) with the next one (columns)."""
    shared: np.ndarray
    """(w, 3, a): blocks of each pose with the shared unknowns."""
    common: np.ndarray
    """(a, a): block of the shared unknowns."""
    slope: np.ndarray
    """(w, 3): negative gradient by the poses ..."""
    common_slope: np.ndarray
    """(a,): ... and by the shared unknowns."""

    @staticmethod
    def zeros(w: int, a: int) -> NormalEquations:
        """Return empty normal equations."""
        return NormalEquations(
            np.zeros((w, 3, 3)),
            np.zeros((max(w - 1, 0), 3, 3)),
            np.zeros((w, 3, a)),
            np.zeros((a, a)),
            np.zeros((w, 3)),
            np.zeros(a),
        )


@dataclass(frozen=True)
class Elimination:
    """Normal equations with all poses but the newest eliminated."""

    factor: np.ndarray
    """(BAND, 3 (w - 1)): banded Cholesky factor of their Hessian."""
    couplings: np.ndarray
    """(3 (w - 1), 3 + a + 1): its inverse times the blocks with the newest pose, with the shared
    unknowns, and the negative gradient."""
    information: np.ndarray
    """(3 + a, 3 + a): information on the newest pose and the shared unknowns."""
    gradient: np.ndarray
    """(3 + a,): their negative gradient."""

    def zero_gradient(self) -> tuple[np.ndarray, np.ndarray]:
        """Return a gradient of zero, shapes (w, 3) and (a,)."""
        return np.zeros((len(self.couplings) // 3 + 1, 3)), np.zeros(len(self.information) - 3)

    def solve(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Solve the normal equations.

        Return the steps of the poses (w, 3) and of the shared unknowns (a,), and the covariance of
        the newest pose and the shared unknowns (3 + a, 3 + a). `numpy.linalg.LinAlgError` when they
        are singular.
        """
        covariance = positive_inverse(self.information)
        tail = covariance @ self.gradient
        poses = _substitute(self, self.couplings[:, -1] - self.couplings[:, :-1] @ tail)
        return np.concatenate([poses, tail[:3]]).reshape(-1, 3), tail[3:], covariance

    def step(self, slope: np.ndarray, common_slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the steps of poses (w, 3) and shared unknowns (a,) for another gradient.

        Or for c of them at once: then of shapes (w, 3, c) and (a, c).

        `numpy.linalg.LinAlgError` when they are singular.
        """
        older, couplings = slope[:-1].reshape(-1, *slope.shape[2:]), self.couplings[:, :-1]
        if older.size:
            older = lapack.dtbtrs(self.factor, older, uplo="L")[0]
        gradient = np.concatenate([slope[-1], common_slope]) - couplings.T @ older
        _, tail, failed = lapack.dposv(self.information, gradient)
        if failed:
            raise np.linalg.LinAlgError("not positive definite")
        poses = _substitute(self, older - couplings @ tail)
        return np.concatenate([poses, tail[:3]]).reshape(slope.shape), tail[3:]


def eliminate(e: NormalEquations) -> Elimination:
    """Eliminate all poses but the newest.

    `numpy.linalg.LinAlgError` when a pose is not determined.
    """
    a, n = len(e.common), 3 * (len(e.own) - 1)
    information = np.empty((3 + a, 3 + a))
    information[:3, :3], information[:3, 3:] = e.own[-1], e.shared[-1]
    information[3:, :3], information[3:, 3:] = e.shared[-1].T, e.common
    gradient = np.concatenate([e.slope[-1], e.common_slope])
    if not n:
        return Elimination(np.empty((BAND, 0)), np.empty((0, 4 + a)), information, gradient)
    factor, failed = lapack.dpbtrf(_banded(e.own[:-1], e.next[:-1]), lower=1, overwrite_ab=1)
    if failed:
        raise np.linalg.LinAlgError("a pose is not determined")
    couplings = np.zeros((4 + a, n)).T  # in columns, as LAPACK has them
    couplings[-3:, :3] = e.next[-1]
    couplings[:, 3:-1], couplings[:, -1] = e.shared[:-1].reshape(n, a), e.slope[:-1].ravel()
    couplings, _ = lapack.dtbtrs(factor, couplings, uplo="L", overwrite_b=1)
    eliminated = couplings[:, :-1].T @ couplings
    information -= eliminated[:, :-1]
    gradient -= eliminated[:, -1]
    return Elimination(factor, couplings, 0.5 * (information + information.T), gradient)


def _banded(own: np.ndarray, following: np.ndarray) -> np.ndarray:
    """Return a chain of blocks in LAPACK's lower band storage, shape (BAND, 3 w)."""
    band = np.zeros((BAND, len(own), 3))
    for column in range(3):
        band[: 3 - column, :, column] = own[:, column:, column].T
        band[3 - column : 6 - column, :-1, column] = following[:, column, :].T
    return band.reshape(BAND, -1)


def _substitute(eliminated: Elimination, whitened: np.ndarray) -> np.ndarray:
    """Return the eliminated poses by back substitution."""
    if not whitened.size:
        return whitened
    return np.asarray(lapack.dtbtrs(eliminated.factor, whitened, uplo="L", trans="T")[0])


def marginals(e: NormalEquations) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the marginal covariances of all poses, for smoothing a whole drive.

    Of each pose (w, 3, 3), minus the derivative of each pose by the shared unknowns (w, 3, a), and
    the covariance of these (a, a). `numpy.linalg.LinAlgError` when a pose is not determined.
    """
    eliminated = eliminate(e)
    newest = np.linalg.inv(eliminated.information[:3, :3])
    by_shared = newest @ eliminated.information[:3, 3:]
    couplings = eliminated.couplings
    gains = _substitute(eliminated, couplings[:, 3:-1] - couplings[:, :3] @ by_shared)
    lever = np.concatenate([gains, by_shared]).reshape(e.shared.shape)
    common = positive_inverse(eliminated.information)[3:, 3:]
    own = _diagonal_of_inverse(e.own, e.next, newest)
    own += lever @ common @ lever.transpose(0, 2, 1)
    # Inverses of nearly singular blocks are no error for LAPACK.
    if not (np.diagonal(own, axis1=1, axis2=2) > 0.0).all():
        raise np.linalg.LinAlgError("a pose is not determined")
    return own, lever, common


def _diagonal_of_inverse(own: np.ndarray, following: np.ndarray, newest: np.ndarray) -> np.ndarray:
    """Return the diagonal blocks of a chain's inverse, the last of which is `newest` (3, 3)."""
    found, gains, passed = own.copy(), np.empty_like(following), np.zeros((3, 3))
    for k, coupling in enumerate(following):
        found[k] = np.linalg.inv(own[k] - passed)  # given all poses after it
        gains[k] = found[k] @ coupling
        passed = coupling.T @ gains[k]
    found[-1] = newest
    for k in range(len(following) - 1, -1, -1):
        found[k] += gains[k] @ found[k + 1] @ gains[k].T
    return found


def positive_inverse(matrix: np.ndarray) -> np.ndarray:
    """Return the inverse of a symmetric positive definite matrix, exactly symmetric.

    `numpy.linalg.LinAlgError` when it is not positive definite.
    """
    _, inverse, failed = lapack.dposv(matrix, np.eye(len(matrix)), overwrite_b=1)
    if failed:
        raise np.linalg.LinAlgError("not positive definite")
    return np.asarray(0.5 * (inverse + inverse.T))


class Prior:
    """Marginalisation prior on oldest pose, calibration and landmarks, around zero.

    A Gaussian in information form (12 + 2 n, 12 + 2 n), with a fixed linearisation point.
    """

    def __init__(self, information: np.ndarray) -> None:
        self._information = information
        self._gradient = np.zeros(len(information))
        self._at = np.zeros(len(information))

    def add_to(self, e: NormalEquations, now: np.ndarray) -> None:
        """Add it to the normal equations around `now`, shape (12 + 2 n,)."""
        information = self._information
        downhill = self._gradient - information @ (now - self._at)
        e.own[0] += information[:3, :3]
        e.shared[0] += information[:3, 3:]
        e.common[:] += information[3:, 3:]
        e.slope[0] += downhill[:3]
        e.common_slope[:] += downhill[3:]

    def add_landmark(self, position: np.ndarray, sigma: float) -> None:
        """Add a landmark with a weak prior, around (2,) with standard deviation `sigma`."""
        size = len(self._gradient)
        grown = np.zeros((size + 2, size + 2))
        grown[:size, :size] = self._information
        grown[size, size] = grown[size + 1, size + 1] = sigma**-2.0
        self._information = grown
        self._gradient = np.append(self._gradient, [0.0, 0.0])
        self._at = np.append(self._at, position)

    def drop_landmark(self, index: int, now: np.ndarray) -> None:
        """Marginalise a landmark, linearised at `now`, shape (12 + 2 n,)."""
        out = HEAD + 2 * index + np.arange(2)
        keep = np.delete(np.arange(now.size), out)
        information = self._information
        gain = np.linalg.solve(information[np.ix_(out, out)], information[np.ix_(out, keep)]).T
        gradient = self._gradient - information @ (now - self._at)
        self._information = information[np.ix_(keep, keep)] - gain @ information[np.ix_(out, keep)]
        self._gradient = gradient[keep] - gain @ gradient[out]
        self._at = now[keep]

    def replace(self, eliminated: Elimination, at: np.ndarray, drift: np.ndarray) -> None:
        """Replace it by an elimination, linearised at `at`.

        The calibration drifts meanwhile by variances (9,): the old one is marginalised, and the new
        one takes its place.
        """
        c = slice(3, HEAD)
        inverse = np.diag(1.0 / (drift + 1e-16))
        information, gradient = eliminated.information, eliminated.gradient
        gain = np.linalg.inv(information[c, c] + inverse)
        by_new = information[:, c] @ gain
        new = information - by_new @ information[c, :]
        new_gradient = gradient - by_new @ gradient[c]
        cross = by_new @ inverse
        new[:, c], new[c, :] = cross, cross.T
        new[c, c] = inverse - inverse @ gain @ inverse
        new_gradient[c] = inverse @ gain @ gradient[c]
        self._information, self._gradient, self._at = 0.5 * (new + new.T), new_gradient, at
