"""A chain of poses that share other unknowns: its normal equations, and their solution.

The Hessian is block tridiagonal in the poses and dense in the shared unknowns. It is dissected: the
chain is cut into segments of `SEGMENT` poses, the inner poses of all segments are eliminated at
once in one batched solve, and what remains (the cuts, the newest pose, the shared unknowns) is
small and dense.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SEGMENT = 8
"""Poses of a segment, the cut at its end among them."""


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

    def of_last(self) -> tuple[np.ndarray, np.ndarray]:
        """Eliminate all poses but the last.

        Returns
        -------
        information : ndarray, shape (3 + a, 3 + a)
            Of the last pose and the shared unknowns.
        gradient : ndarray, shape (3 + a,)
            Downhill.
        """
        own, row, slope = self.own[0], self.shared[0], self.slope[0]
        rows, gains, slopes = [], [], []
        for k, following in enumerate(self.next):
            coupled = np.hstack([following, row])
            gain = np.linalg.solve(own, coupled).T
            rows.append(row)
            gains.append(gain[3:])
            slopes.append(slope)
            own = self.own[k + 1] - gain[:3] @ following
            slope = self.slope[k + 1] - gain[:3] @ slope
            row = self.shared[k + 1] - gain[:3] @ row
        common, common_slope = self.common, self.common_slope
        if gains:
            every = np.hstack(gains)
            common = common - every @ np.vstack(rows)
            common_slope = common_slope - every @ np.concatenate(slopes)
        information = np.block([[own, row], [row.T, common]])
        return 0.5 * (information + information.T), np.concatenate([slope, common_slope])


def solve(equations: NormalEquations) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
    w, a = len(equations.own), len(equations.common)
    segments = -(-(w - 1) // SEGMENT)
    padded = _pad(equations, segments * SEGMENT - (w - 1))
    eliminated, couplings = _eliminate_inner(padded, segments)
    hessian, slope = _remainder(padded, segments, eliminated, couplings)

    cuts = 3 * segments
    inverse_part = np.linalg.solve(
        hessian[:cuts, :cuts], np.column_stack([hessian[:cuts, cuts:], slope[:cuts]])
    )
    information = hessian[cuts:, cuts:] - hessian[:cuts, cuts:].T @ inverse_part[:, :-1]
    covariance = np.linalg.inv(0.5 * (information + information.T))
    covariance = 0.5 * (covariance + covariance.T)
    tail = covariance @ (slope[cuts:] - hessian[:cuts, cuts:].T @ inverse_part[:, -1])
    at_cuts = inverse_part[:, -1] - inverse_part[:, :-1] @ tail

    steps = np.empty((segments, SEGMENT, 3))
    steps[:, -1] = at_cuts.reshape(segments, 3)
    left = np.vstack([np.zeros((1, 3)), steps[:-1, -1]]) if segments else np.zeros((0, 3))
    known = np.concatenate([left, steps[:, -1], np.broadcast_to(tail[3:], (segments, a))], axis=1)
    inner = eliminated[:, :, -1] - (eliminated[:, :, :-1] @ known[:, :, None])[:, :, 0]
    steps[:, :-1] = inner.reshape(segments, SEGMENT - 1, 3)
    poses = np.vstack([steps.reshape(-1, 3)[segments * SEGMENT - (w - 1) :], tail[None, :3]])
    return poses, tail[3:], covariance


def marginals(equations: NormalEquations) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
    w = len(equations.own)
    inverse, pulled = np.empty((w, 3, 3)), equations.shared.copy()
    inverse[0] = np.linalg.inv(equations.own[0])
    for k in range(1, w):
        gain = equations.next[k - 1].T @ inverse[k - 1]
        inverse[k] = np.linalg.inv(equations.own[k] - gain @ equations.next[k - 1])
        pulled[k] -= gain @ pulled[k - 1]
    own, lever = np.empty((w, 3, 3)), np.empty_like(pulled)
    own[-1], lever[-1] = inverse[-1], inverse[-1] @ pulled[-1]
    for k in range(w - 2, -1, -1):
        gain = inverse[k] @ equations.next[k]
        own[k] = inverse[k] + gain @ own[k + 1] @ gain.T
        lever[k] = inverse[k] @ pulled[k] - gain @ lever[k + 1]
    flat, shared = lever.reshape(3 * w, -1), equations.shared.reshape(3 * w, -1)
    common = np.linalg.inv(equations.common - shared.T @ flat)
    own += lever @ common @ lever.transpose(0, 2, 1)
    return own, lever, 0.5 * (common + common.T)


def _pad(equations: NormalEquations, number: int) -> NormalEquations:
    """Put poses in front that are tied to nothing, so that all segments are full."""
    if not number:
        return equations
    w, a = len(equations.own), len(equations.common)
    own = np.empty((number + w, 3, 3))
    own[:number], own[number:] = np.eye(3), equations.own
    following = np.zeros((number + w - 1, 3, 3))
    following[number:] = equations.next
    shared = np.zeros((number + w, 3, a))
    shared[number:] = equations.shared
    slope = np.zeros((number + w, 3))
    slope[number:] = equations.slope
    return NormalEquations(own, following, shared, equations.common, slope, equations.common_slope)


def _eliminate_inner(e: NormalEquations, segments: int) -> tuple[np.ndarray, np.ndarray]:
    """Eliminate the inner poses of all segments.

    Returns
    -------
    eliminated, couplings : ndarray, shape (segments, 3 (SEGMENT - 1), 6 + a + 1)
        Couplings to the cut before, the cut after, the shared unknowns, and the slope; and the
        same solved by the inner Hessian.
    """
    inner, a = SEGMENT - 1, len(e.common)
    own = e.own[:-1].reshape(segments, SEGMENT, 3, 3)
    after = e.next.reshape(segments, SEGMENT, 3, 3)
    hessian = np.zeros((segments, inner, 3, inner, 3))
    for i in range(inner):
        hessian[:, i, :, i] = own[:, i]
        if i + 1 < inner:
            hessian[:, i, :, i + 1] = after[:, i]
            hessian[:, i + 1, :, i] = after[:, i].transpose(0, 2, 1)
    couplings = np.zeros((segments, inner, 3, 7 + a))
    couplings[1:, 0, :, :3] = after[:-1, -1].transpose(0, 2, 1)
    couplings[:, -1, :, 3:6] = after[:, inner - 1]
    couplings[:, :, :, 6:-1] = e.shared[:-1].reshape(segments, SEGMENT, 3, a)[:, :inner]
    couplings[:, :, :, -1] = e.slope[:-1].reshape(segments, SEGMENT, 3)[:, :inner]
    flat = couplings.reshape(segments, 3 * inner, 7 + a)
    return np.linalg.solve(hessian.reshape(segments, 3 * inner, 3 * inner), flat), flat


def _remainder(
    e: NormalEquations, segments: int, eliminated: np.ndarray, couplings: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return Hessian and slope of the cuts, the newest pose and the shared unknowns."""
    a, cuts = len(e.common), 3 * segments
    size = cuts + 3 + a
    hessian, slope = np.zeros((size, size)), np.zeros(size)
    hessian[cuts + 3 :, cuts + 3 :] = e.common
    slope[cuts + 3 :] = e.common_slope
    newest = slice(cuts, cuts + 3)
    hessian[newest, newest], slope[newest] = e.own[-1], e.slope[-1]
    hessian[newest, cuts + 3 :] = e.shared[-1]
    hessian[cuts + 3 :, newest] = e.shared[-1].T
    if not segments:
        return hessian, slope
    if len(e.next):
        last = slice(cuts - 3, cuts)
        hessian[last, newest], hessian[newest, last] = e.next[-1], e.next[-1].T
    at = np.arange(segments)
    cut = hessian[:cuts, :cuts].reshape(segments, 3, segments, 3)
    to_shared = hessian[:cuts, cuts + 3 :].reshape(segments, 3, a)
    cut[at, :, at] += e.own[SEGMENT - 1 : -1 : SEGMENT]
    to_shared += e.shared[SEGMENT - 1 : -1 : SEGMENT]
    slope[:cuts] += e.slope[SEGMENT - 1 : -1 : SEGMENT].ravel()

    cut_couplings = couplings[:, :, :6].transpose(0, 2, 1)
    ends = cut_couplings @ eliminated  # (segments, 6, 7 + a)
    cut[at, :, at] -= ends[:, 3:6, 3:6]
    cut[at[:-1], :, at[:-1]] -= ends[1:, :3, :3]
    cut[at[:-1], :, at[1:]] -= ends[1:, :3, 3:6]
    cut[at[1:], :, at[:-1]] -= ends[1:, 3:6, :3]
    to_shared -= ends[:, 3:6, 6:-1]
    to_shared[:-1] -= ends[1:, :3, 6:-1]
    slope[:cuts] -= ends[:, 3:6, -1].ravel()
    slope[: cuts - 3] -= ends[1:, :3, -1].ravel()
    hessian[cuts + 3 :, :cuts] = hessian[:cuts, cuts + 3 :].T

    flat = couplings.reshape(-1, 7 + a)[:, 6:-1]
    shared = flat.T @ eliminated.reshape(-1, 7 + a)[:, 6:]
    hessian[cuts + 3 :, cuts + 3 :] -= shared[:, :-1]
    slope[cuts + 3 :] -= shared[:, -1]
    return hessian, slope
