"""The window: its solution by Gauss-Newton, and marginals.

All poses but the newest are eliminated at once by a banded Cholesky factor (Schur complement). This
leaves the information on the newest pose and the shared unknowns; the other poses follow by back
substitution.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from homeward.geometry.se2 import MIN_DISTANCE
from homeward.geometry.statistics import ROUNDING
from homeward.localizer.motions import CAMERA_X, NC
from homeward.localizer.reference.factors import (
    NormalEquations,
    OdometryErrors,
    SightedFrom,
    WeighedSightings,
    add_odometry,
    add_sightings,
    odometry_errors,
    weighed,
)
from homeward.localizer.tunables import (
    CLOSE,
    LINEAR,
    MAX_SOLVE_STEPS,
    NEGLIGIBLE_CALIBRATION,
    SOLVE_CONVERGED,
)

BAND = 6
"""Diagonals of the lower half of the chain's Hessian: a block of three and the next one."""


class Window(NamedTuple):
    """All knowledge of w poses, the calibration and n landmarks; a = 10 + 2 n."""

    poses: np.ndarray
    """(w, 3): the present estimate of the poses, ..."""
    shared: np.ndarray
    """(a,): ... and of calibration and landmarks."""
    steps: np.ndarray
    """(w - 1, STEP): motions between the poses."""
    seen: SightedFrom
    """Bearings."""
    information: np.ndarray
    """(3 + a, 3 + a): the prior on oldest pose, calibration and landmarks: information, ..."""
    gradient: np.ndarray
    """(3 + a,): ... negative gradient at its linearisation point, ..."""
    at: np.ndarray
    """(3 + a,): ... and that point."""
    weights: np.ndarray
    """(10,): a prior on the calibration: inverse variances, ..."""
    means: np.ndarray
    """(10,): ... and means."""
    is_one_sided: np.ndarray
    """(10,), bool: which of the calibration cannot be negative, and ..."""
    is_bounded: np.ndarray
    """(10,), bool: ... which are kept at zero, since they would be negative without that."""


AddMore = Callable[[NormalEquations, np.ndarray, np.ndarray], None]
"""Adds more factors to normal equations, at poses (w, 3) and shared unknowns (a,)."""


class Linearised(NamedTuple):
    """A window at its estimate: normal equations, and the factors of which they are the sum."""

    equations: NormalEquations
    """All of them, with priors, survey and ranges."""
    seen: WeighedSightings
    """Bearings."""
    motions: OdometryErrors
    """Motions between the poses."""


class Solution(NamedTuple):
    """The window after Gauss-Newton steps."""

    poses: np.ndarray
    """(w, 3)"""
    shared: np.ndarray
    """(a,)"""
    covariance: np.ndarray
    """(3 + a, 3 + a): of the newest pose and the shared unknowns."""
    is_bounded: np.ndarray
    """(10,), bool: as in `Window`, by this solution."""
    has_converged: bool
    """Whether the last step was small, and changed no bound."""


def solve(window: Window, add_more: AddMore | None = None) -> Solution:
    """Solve the window by Gauss-Newton.

    `numpy.linalg.LinAlgError` when the normal equations are singular.
    """
    has_converged = False
    for _ in range(MAX_SOLVE_STEPS):
        step, common, covariance = eliminate(linearised(window, add_more).equations).solve()
        if not (np.isfinite(step).all() and np.isfinite(covariance).all()):
            raise np.linalg.LinAlgError("a step is not finite")
        if not (covariance.diagonal() > 0.0).all():
            raise np.linalg.LinAlgError("a variance is not positive")
        window, size = _moved(window, step, common)
        before, now = window.is_bounded, _bounded(window)
        window = window._replace(is_bounded=now)
        has_converged = size < SOLVE_CONVERGED and bool((now == before).all())
        if has_converged:
            break
    return Solution(window.poses, window.shared, covariance, window.is_bounded, has_converged)


def linearised(window: Window, add_more: AddMore | None = None) -> Linearised:
    """Return the normal equations and the factors of a window at its estimate."""
    poses, shared, calibration = window.poses, window.shared, window.shared[:NC]
    motions = odometry_errors(poses, calibration, window.steps)
    seen = weighed(window.seen, poses, shared)
    e = NormalEquations.zeros(len(poses), len(shared))
    add_prior(e, window)
    add_odometry(e, motions)
    add_sightings(e, seen)
    at, kept = np.arange(NC), window.is_bounded.nonzero()[0]
    e.common[at, at] += window.weights
    e.common_slope[at] -= window.weights * (calibration - window.means)
    e.common[kept, kept] += NEGLIGIBLE_CALIBRATION**-2.0
    e.common_slope[kept] -= NEGLIGIBLE_CALIBRATION**-2.0 * calibration[kept]
    if add_more is not None:
        add_more(e, poses, shared)
    return Linearised(e, seen, motions)


def add_prior(e: NormalEquations, window: Window) -> None:
    """Add the prior of a window to normal equations."""
    now = np.concatenate([window.poses[0], window.shared])
    downhill = window.gradient - window.information @ (now - window.at)
    e.own[0] += window.information[:3, :3]
    e.shared[0] += window.information[:3, 3:]
    e.common[:] += window.information[3:, 3:]
    e.slope[0] += downhill[:3]
    e.common_slope[:] += downhill[3:]


def _moved(window: Window, poses: np.ndarray, common: np.ndarray) -> tuple[Window, float]:
    """Return the window after a step, limited to the linear range, and the step's full size."""
    landmarks, eye = window.shared[NC:].reshape(-1, 2), window.poses[-1, :2]
    distances = np.hypot(*(landmarks - eye).T)
    scale = max(float(np.median(distances)), MIN_DISTANCE) if len(landmarks) else math.inf
    reach = distances + CLOSE * scale
    turn = float(np.abs(poses[:, 2]).max())
    share = float((np.hypot(*common[NC:].reshape(-1, 2).T) / reach).max(initial=0.0))
    shift = max(np.abs(poses[:, :2]).max(), np.abs(common[CAMERA_X:NC]).max())
    size = max(turn, share, shift / scale, np.abs(common[:CAMERA_X]).max())
    limited = 1.0 / max(1.0, max(turn, share) / LINEAR)
    moved = window.poses + limited * poses, window.shared + limited * common
    return window._replace(poses=moved[0], shared=moved[1]), float(size)


def _bounded(window: Window) -> np.ndarray:
    """Return which unknowns are kept at zero (an active set), (10,) bool.

    An unknown that nothing observes is zero but for rounding, whose sign must not decide: one is
    kept at zero from a notable negative value on, until it is not negative even then.
    """
    limit = np.where(window.is_bounded, -ROUNDING, -NEGLIGIBLE_CALIBRATION)
    return np.asarray(window.is_one_sided & (window.shared[:NC] < limit))


class Conditional(NamedTuple):
    """Gaussian of k unknowns given m others."""

    mean: np.ndarray
    """(k,): minus the linearisation point, where the others are at it."""
    by_rest: np.ndarray
    """(k, m): Jacobian by the others."""
    covariance: np.ndarray
    """(k, k)"""


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

    def oldest(self) -> Conditional:
        """Return the conditional of the oldest pose on the newest one and the shared unknowns."""
        size = len(self.gradient)
        if not self.couplings.size:  # the newest is the oldest
            return Conditional(np.zeros(3), np.eye(3, size), np.zeros((3, 3)))
        steps = _substitute(self, self.couplings)[:3]
        root = lapack.dtbtrs(self.factor, np.eye(len(self.couplings), 3), uplo="L")[0]
        return Conditional(steps[:, -1], -steps[:, :-1], root.T @ root)

    def step(self, slope: np.ndarray, common_slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the steps of poses (w, 3, c) and shared unknowns (a, c) for c other gradients.

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
