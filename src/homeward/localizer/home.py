"""Home among the mapped landmarks, for a given set of right home bearings: fit and evidence.

Everything here is Gaussian around one point: the map's marginal (newest pose, camera yaw, the
landmarks that home saw), the home bearings of the chosen set, and a start prior where there is one.
The evidence of a set is the integral over all unknowns, home included (Laplace), so that sets of
different size compare fairly; a wrong bearing is uniform on the circle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from homeward.angles import TWO_PI, wrap

STEPS = 6
SETTLED = 1e-4
"""A step of home smaller than this ends the iteration [m or rad]."""
LONGEST_STEP_M = 1.0
UNSETTLED = 0.5
"""A last step longer than this says that the fit has not come to rest [standard deviations]."""
LEAST_SHARE = 0.002
"""So much of the information on home is left at least when errors of the map are taken out [1]."""
HEAD = 4
"""The unknowns begin with the newest pose (3) and the camera's yaw (1)."""
UNIFORM_FROM = 2.0
"""A predicted bearing with a larger standard deviation is taken as uniform [rad]."""


@dataclass(frozen=True)
class HomeProblem:
    """What is known when home is to be found; q landmarks that home saw are mapped."""

    mean: np.ndarray
    """(4 + 2 q,): newest pose, camera yaw, landmarks, in the odometry frame."""
    covariance: np.ndarray
    """(4 + 2 q, 4 + 2 q)"""
    bearings: np.ndarray
    """(q,): what home stored, from the camera's axis [rad]."""
    sigmas: np.ndarray
    """(q,) [rad]"""
    mount: np.ndarray
    """(3,): pose of the camera on the robot, at home."""
    same_camera: bool
    """Whether the camera's unknown yaw is the drive's."""
    moved_prior: float
    prior: np.ndarray | None = None
    """(3,): home's pose in the odometry frame, from the start prior."""
    prior_information: np.ndarray | None = None
    """(3, 3)"""

    @property
    def landmarks(self) -> np.ndarray:
        """Positions of the landmarks [m], shape (q, 2)."""
        return self.mean[HEAD:].reshape(-1, 2)

    @property
    def fewest(self) -> int:
        """Home bearings that fix home."""
        return 3 if self.prior is None else 0


@dataclass(frozen=True)
class HomeFit:
    """Home for one set of right home bearings."""

    home: np.ndarray
    """(3,): pose of the robot at home, in the odometry frame."""
    right: np.ndarray
    """(q,), bool: the set."""
    evidence: float
    """Log of it, up to a constant that all sets share."""
    pose: np.ndarray
    """(3,): newest pose in the odometry frame, corrected by the home bearings."""
    covariance: np.ndarray
    """(6, 6), of home and newest pose."""
    landmarks: np.ndarray
    """(q, 2): corrected positions [m]."""
    innovation: np.ndarray
    """(q,): stored minus predicted by everything but itself [rad]."""
    variance: np.ndarray
    """(q,), of the innovations [rad^2]."""
    settled: bool
    """Whether the last step was small against home's own uncertainty."""
    odds: np.ndarray
    """(q,): log odds of right against wrong, the rest of the set given."""


def fit(
    problem: HomeProblem, home: np.ndarray, right: np.ndarray, steps: int = STEPS
) -> HomeFit | None:
    """Fit home to a set of right home bearings; None when they do not fix it.

    Parameters
    ----------
    problem : HomeProblem
        What is known.
    home : ndarray, shape (3,)
        Where to start.
    right : ndarray, shape (q,), bool
        The set.
    steps : int
        Gauss-Newton steps at most.
    """
    if right.sum() < problem.fewest:
        return None
    home, known = home.copy(), problem.mean
    information = (
        np.zeros((3, 3)) if problem.prior_information is None else problem.prior_information
    )
    for step in range(steps):
        rho, by_known, by_home = _linearise(problem, home, known)
        correlated = problem.covariance @ by_known.T
        v = by_known @ correlated + np.diag(problem.sigmas**2)
        try:
            inverse = np.linalg.inv(v[np.ix_(right, right)])
            a = by_home[right].T @ inverse @ by_home[right] + information
            spread = np.linalg.inv(a)
        except np.linalg.LinAlgError:
            return None
        offset = np.zeros(3) if problem.prior is None else problem.prior - home
        offset[2] = wrap(offset[2])
        b = by_home[right].T @ (inverse @ rho[right]) + information @ offset
        dh = spread @ b
        dh = dh * min(1.0, LONGEST_STEP_M / max(float(np.abs(dh).max()), 1e-12))
        weighted = inverse @ (rho[right] - by_home[right] @ dh)
        if step == steps - 1 or (step and np.abs(dh).max() < SETTLED):
            break
        known = problem.mean + correlated[:, right] @ weighted
        home = home + dh
    if not (np.isfinite(spread).all() and (np.diag(spread) > 0).all()):
        return None
    evidence = _evidence(problem, right, rho, offset, b, spread, inverse, information)
    innovation, variance = _leave_one_out(right, rho, v, by_home, dh, inverse, spread, weighted)
    spread = np.linalg.inv(_without_chance(problem, home, known, right, v, a))
    known = problem.mean + correlated[:, right] @ weighted
    gain = correlated[:3, right] @ inverse
    by_pose = gain @ by_home[right]
    pose_cov = problem.covariance[:3, :3] - gain @ correlated[:3, right].T
    pose_cov = pose_cov + by_pose @ spread @ by_pose.T
    cross = -spread @ by_pose.T
    joint = np.block([[spread, cross], [cross.T, pose_cov]])
    return HomeFit(
        home=home + dh,
        right=right,
        evidence=evidence,
        pose=known[:3],
        covariance=0.5 * (joint + joint.T),
        landmarks=known[HEAD:].reshape(-1, 2),
        innovation=innovation,
        variance=variance,
        settled=bool(dh @ a @ dh < UNSETTLED**2),
        odds=_log_density(innovation, variance)
        + math.log((1.0 - problem.moved_prior) / problem.moved_prior * TWO_PI),
    )


def _linearise(
    problem: HomeProblem, home: np.ndarray, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return residuals as of the mean of the map, and Jacobians by what is known and by home."""
    q = problem.bearings.size
    c, s = math.cos(home[2]), math.sin(home[2])
    mx, my, yaw = problem.mount
    ox, oy = c * mx - s * my, s * mx + c * my
    points = known[HEAD:].reshape(-1, 2)
    dx, dy = points[:, 0] - home[0] - ox, points[:, 1] - home[1] - oy
    square = np.maximum(dx * dx + dy * dy, 1e-4)
    gx, gy = -dy / square, dx / square
    unknown_yaw = known[3] if problem.same_camera else 0.0
    residual = wrap(problem.bearings - np.arctan2(dy, dx) + home[2] + yaw + unknown_yaw)
    by_home = np.stack([-gx, -gy, gx * oy - gy * ox - 1.0], axis=1)
    by_known = np.zeros((q, problem.mean.size))
    if problem.same_camera:
        by_known[:, 3] = -1.0
    rows = np.arange(q)
    by_known[rows, HEAD + 2 * rows], by_known[rows, HEAD + 1 + 2 * rows] = gx, gy
    return residual + by_known @ (known - problem.mean), by_known, by_home


def _without_chance(
    problem: HomeProblem,
    home: np.ndarray,
    known: np.ndarray,
    right: np.ndarray,
    v: np.ndarray,
    information: np.ndarray,
) -> np.ndarray:
    """Return the information on home, less what errors of the landmarks seem to tell.

    Where home lies on the circle through the landmarks its position is not fixed at all; but the
    landmarks as mapped are never quite on the circle, and so seem to fix it. What their errors add
    to the information in the mean is taken out, down to a share of `LEAST_SHARE`.
    """
    d = known[HEAD:].reshape(-1, 2)[right] - home[:2]
    square = np.maximum((d**2).sum(axis=1), 1e-4)
    a, b = 2.0 * d[:, 0] * d[:, 1] / square**2, (d[:, 1] ** 2 - d[:, 0] ** 2) / square**2
    curvature = np.stack([np.stack([a, b], 1), np.stack([b, -a], 1)], 1)
    q = right.size
    blocks = problem.covariance[HEAD:, HEAD:].reshape(q, 2, q, 2)
    covariances = blocks[np.arange(q), :, np.arange(q)][right]
    chance = np.zeros((3, 3))
    weights = 1.0 / np.diag(v)[right]
    chance[:2, :2] = np.einsum("i,ijk,ikl,iml->jm", weights, curvature, covariances, curvature)
    root = np.linalg.cholesky(information)
    inverse = np.linalg.inv(root)
    shares, axes = np.linalg.eigh(inverse @ chance @ inverse.T)
    kept = root @ axes
    return np.asarray((kept * np.maximum(1.0 - shares, LEAST_SHARE)) @ kept.T)


def _evidence(
    problem: HomeProblem,
    right: np.ndarray,
    rho: np.ndarray,
    offset: np.ndarray,
    b: np.ndarray,
    spread: np.ndarray,
    inverse: np.ndarray,
    information: np.ndarray,
) -> float:
    """Return the log evidence of the set."""
    n, q = int(right.sum()), right.size
    square = rho[right] @ inverse @ rho[right] + offset @ information @ offset - b @ spread @ b
    log_density = 0.5 * (np.linalg.slogdet(inverse)[1] - n * math.log(TWO_PI))
    log_volume = 0.5 * (np.linalg.slogdet(spread)[1] + 3.0 * math.log(TWO_PI))
    p = problem.moved_prior
    labels = n * math.log(1.0 - p) + (q - n) * math.log(p / TWO_PI)
    return float(-0.5 * square + log_density + log_volume + labels)


def _leave_one_out(
    right: np.ndarray,
    rho: np.ndarray,
    v: np.ndarray,
    by_home: np.ndarray,
    dh: np.ndarray,
    inverse: np.ndarray,
    spread: np.ndarray,
    weighted: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return each home bearing's innovation against all the others of the set, and its variance."""
    innovation, variance = np.zeros(right.size), np.zeros(right.size)
    lever = inverse @ by_home[right]
    rest = np.diag(inverse) - np.einsum("ij,jk,ik->i", lever, spread, lever)
    rest = np.maximum(rest, 1e-9)
    innovation[right], variance[right] = weighted / rest, 1.0 / rest
    out = ~right
    if out.any():
        gain = v[np.ix_(out, right)] @ inverse
        innovation[out] = wrap(
            rho[out] - by_home[out] @ dh - gain @ (rho[right] - by_home[right] @ dh)
        )
        lever = by_home[out] - gain @ by_home[right]
        variance[out] = (
            np.diag(v)[out]
            - np.einsum("ij,ij->i", gain, v[np.ix_(out, right)])
            + np.einsum("ij,jk,ik->i", lever, spread, lever)
        )
    return innovation, variance


def _log_density(innovation: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the log density of innovations; uniform where nothing can be predicted."""
    variance = np.maximum(variance, 1e-12)
    normal = -0.5 * innovation**2 / variance - 0.5 * np.log(TWO_PI * variance)
    return np.where(variance > UNIFORM_FROM**2, -math.log(TWO_PI), normal)
