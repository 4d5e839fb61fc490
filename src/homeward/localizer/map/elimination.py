"""Block-tridiagonal elimination (Schur complement) of a chain of poses with shared unknowns.

The Hessian is block tridiagonal in the poses and dense in the shared unknowns. The poses are
eliminated one after the other, oldest first, which leaves what is known of the newest pose and the
shared unknowns; the others follow by substitution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.localizer.compiled import compiled


@dataclass(frozen=True)
class NormalEquations:
    """Hessian and downhill gradient of w poses and a shared unknowns."""

    own: np.ndarray
    """(w, 3, 3): of each pose with itself."""
    next: np.ndarray
    """(w - 1, 3, 3): of each pose (rows) with the next one (columns)."""
    shared: np.ndarray
    """(w, 3, a): of each pose with the shared unknowns."""
    common: np.ndarray
    """(a, a): of the shared unknowns."""
    slope: np.ndarray
    """(w, 3)"""
    common_slope: np.ndarray
    """(a,)"""

    @staticmethod
    def zeros(w: int, a: int) -> NormalEquations:
        """Return equations that say nothing yet."""
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
    """Normal equations of which all poses but the newest are eliminated."""

    inverse: np.ndarray
    """(w - 1, 3, 3): covariance of each pose, were all that comes after it known."""
    gains: np.ndarray
    """(w - 1, 3, 3 + a + 1): it times the couplings to the next pose, to the shared unknowns, and
    the slope."""
    information: np.ndarray
    """(3 + a, 3 + a): on the newest pose and the shared unknowns."""
    gradient: np.ndarray
    """(3 + a,): downhill."""


def eliminate(e: NormalEquations) -> Elimination:
    """Eliminate all poses but the newest.

    Raises
    ------
    numpy.linalg.LinAlgError
        When one is not fixed.
    """
    w, a = len(e.own), len(e.common)
    own, slope, rows = e.own.copy(), e.slope.copy(), e.shared.copy()
    inverse, gains = np.empty((w - 1, 3, 3)), np.empty((w - 1, 3, 4 + a))
    native = compiled()
    if native is None:
        _eliminate(own, e.next, rows, slope, inverse, gains)
    elif native.eliminate(w, a, own, e.next, rows, slope, inverse, gains):
        raise np.linalg.LinAlgError("a pose is not fixed")
    flat = rows[:-1].reshape(-1, a).T
    eliminated = flat @ gains[:, :, 3:].reshape(-1, a + 1)
    information = np.empty((3 + a, 3 + a))
    information[:3, :3], information[:3, 3:], information[3:, :3] = own[-1], rows[-1], rows[-1].T
    information[3:, 3:] = e.common - eliminated[:, :-1]
    gradient = np.concatenate([slope[-1], e.common_slope - eliminated[:, -1]])
    return Elimination(inverse, gains, 0.5 * (information + information.T), gradient)


def _eliminate(
    own: np.ndarray,
    following: np.ndarray,
    rows: np.ndarray,
    slope: np.ndarray,
    inverse: np.ndarray,
    gains: np.ndarray,
) -> None:
    """Eliminate pose after pose: `own`, `rows` and `slope` become what they are at its turn."""
    for k, coupling in enumerate(following):
        inverse[k] = np.linalg.inv(own[k])
        gains[k, :, :3] = inverse[k] @ coupling
        gains[k, :, 3:-1] = inverse[k] @ rows[k]
        gains[k, :, -1] = inverse[k] @ slope[k]
        passed = coupling.T @ gains[k]
        own[k + 1] -= passed[:, :3]
        rows[k + 1] -= passed[:, 3:-1]
        slope[k + 1] -= passed[:, -1]


def solve(e: NormalEquations) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve the normal equations.

    Returns
    -------
    poses : ndarray, shape (w, 3)
        Step of the poses.
    common : ndarray, shape (a,)
        Step of the shared unknowns.
    covariance : ndarray, shape (3 + a, 3 + a)
        Of the newest pose and the shared unknowns.

    Raises
    ------
    numpy.linalg.LinAlgError
        When they are singular.
    """
    left = eliminate(e)
    covariance = np.linalg.inv(left.information)
    covariance = 0.5 * (covariance + covariance.T)
    tail = covariance @ left.gradient
    return _substitute(left.gains, tail), tail[3:], covariance


def _substitute(gains: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """Return the steps of the poses, (w, 3), from that of the newest and what they share."""
    poses = np.empty((len(gains) + 1, 3))
    poses[-1] = tail[:3]
    native = compiled()
    if native is not None:
        native.substitute(len(poses), tail.size - 3, gains, tail, poses)
        return poses
    poses[:-1] = gains[:, :, -1] - gains[:, :, 3:-1] @ tail[3:]
    for k in range(len(gains) - 1, -1, -1):
        poses[k] -= gains[k, :, :3] @ poses[k + 1]
    return poses


def marginals(e: NormalEquations) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the covariances of all poses, one after the other (for the whole of a drive).

    Returns
    -------
    own : ndarray, shape (w, 3, 3)
        Of each pose.
    lever : ndarray, shape (w, 3, a)
        Minus the derivative of each pose by the shared unknowns.
    common : ndarray, shape (a, a)
        Covariance of the shared unknowns.
    """
    left = eliminate(e)
    own, lever = np.empty_like(e.own), np.empty_like(e.shared)
    own[-1] = np.linalg.inv(left.information[:3, :3])
    lever[-1] = own[-1] @ left.information[:3, 3:]
    for k in range(len(own) - 2, -1, -1):
        gain = left.gains[k, :, :3]
        own[k] = left.inverse[k] + gain @ own[k + 1] @ gain.T
        lever[k] = left.gains[k, :, 3:-1] - gain @ lever[k + 1]
    common = np.linalg.inv(left.information)[3:, 3:]
    own += lever @ common @ lever.transpose(0, 2, 1)
    return own, lever, 0.5 * (common + common.T)
