"""Home among the mapped landmarks, for a given set of right home bearings: fit and evidence.

Everything here is Gaussian around one point: the map's marginal (newest pose, camera yaw, the
landmarks that home saw), the home bearings of the chosen set, and a start prior where there is one.
The evidence of a set is the integral over all unknowns, home included (Laplace), so that sets of
different size compare fairly; a wrong bearing is uniform on the circle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from homeward.angles import TWO_PI, wrap
from homeward.localizer.problem import HEAD, HomeProblem, linearise

STEPS = 6
SETTLED = 1e-4
"""A step of home smaller than this ends the iteration [m or rad]."""
LONGEST_STEP_M = 1.0
UNSETTLED = 0.5
"""A last step longer than this says that the fit has not come to rest [standard deviations]."""
LEAST_SHARE = 0.002
"""So much of the information on home is left at least when errors of the map are taken out [1]."""
UNIFORM_FROM = 2.0
"""A predicted bearing with a larger standard deviation is taken as uniform [rad]."""


@dataclass(frozen=True)
class HomeFit:
    """Home for one set of right home bearings; what follows from it is worked out when asked."""

    problem: HomeProblem
    right: np.ndarray
    """(q,), bool: the set."""
    at: np.ndarray
    """(3,): where home was linearised ..."""
    step: np.ndarray
    """(3,): ... and the last step from there."""
    residual: np.ndarray
    """(q,): of the home bearings, the map at its mean [rad]."""
    by_known: np.ndarray
    """(q, 4 + 2 q): Jacobian of the expected home bearings by what is known ..."""
    by_home: np.ndarray
    """(q, 3): ... and by home."""
    correlated: np.ndarray
    """(4 + 2 q, q): covariance of what is known with the expected home bearings."""
    spread: np.ndarray
    """(q, q): of the home bearings, were home known."""
    precision: np.ndarray
    """(r, r): inverse of it, of the set."""
    information: np.ndarray
    """(3, 3): on home."""
    doubt: np.ndarray | None = None
    """(3, 3): see `_doubt`; from the fit that this one was carried on from."""

    @cached_property
    def home(self) -> np.ndarray:
        """(3,): pose of the robot at home, in the odometry frame."""
        return np.asarray(self.at + self.step)

    @cached_property
    def settled(self) -> bool:
        """Whether the last step was small against home's own uncertainty."""
        return bool(self.step @ self.information @ self.step < UNSETTLED**2)

    @cached_property
    def known(self) -> np.ndarray:
        """(4 + 2 q,): pose, camera yaw and landmarks, corrected by the home bearings."""
        return np.asarray(self.problem.mean + self.correlated[:, self.right] @ self._weighted)

    @property
    def pose(self) -> np.ndarray:
        """(3,): newest pose in the odometry frame, corrected."""
        return np.asarray(self.known[:3])

    @property
    def landmarks(self) -> np.ndarray:
        """(q, 2): corrected positions [m]."""
        return np.asarray(self.known[HEAD:].reshape(-1, 2))

    @cached_property
    def covariance(self) -> np.ndarray:
        """(6, 6), of home and newest pose."""
        spread = np.linalg.inv(self.information) + self._doubt
        gain = self.correlated[:3, self.right] @ self.precision
        by_pose = gain @ self.by_home[self.right]
        own = self.problem.covariance[:3, :3] - gain @ self.correlated[:3, self.right].T
        joint = np.empty((6, 6))
        joint[:3, :3], joint[3:, 3:] = spread, own + by_pose @ spread @ by_pose.T
        joint[:3, 3:] = -spread @ by_pose.T
        joint[3:, :3] = joint[:3, 3:].T
        return np.asarray(0.5 * (joint + joint.T))

    @cached_property
    def evidence(self) -> float:
        """Log of the evidence of the set, up to a constant that all sets share."""
        problem, n, q = self.problem, int(self.right.sum()), self.right.size
        residual = self.residual[self.right]
        square = residual @ self.precision @ residual - self.step @ self.information @ self.step
        if problem.prior is not None:
            offset = self._off_prior()
            square += offset @ problem.prior_information @ offset
        log_density = 0.5 * (np.linalg.slogdet(self.precision)[1] - n * math.log(TWO_PI))
        log_volume = 0.5 * (3.0 * math.log(TWO_PI) - np.linalg.slogdet(self.information)[1])
        p = problem.moved_prior
        labels = n * math.log(1.0 - p) + (q - n) * math.log(p / TWO_PI)
        return float(-0.5 * square + log_density + log_volume + labels)

    @cached_property
    def innovations(self) -> tuple[np.ndarray, np.ndarray]:
        """(q,), (q,): stored minus predicted by everything else [rad], and its variance."""
        right, out = self.right, ~self.right
        innovation, variance = np.zeros(right.size), np.zeros(right.size)
        spread = np.linalg.inv(self.information)
        lever = self.precision @ self.by_home[right]
        rest = np.diag(self.precision) - ((lever @ spread) * lever).sum(axis=1)
        rest = np.maximum(rest, 1e-9)
        innovation[right], variance[right] = self._weighted / rest, 1.0 / rest
        if out.any():
            between = self.spread[np.ix_(out, right)]
            gain = between @ self.precision
            innovation[out] = wrap(
                self.residual[out] - self.by_home[out] @ self.step - between @ self._weighted
            )
            lever = self.by_home[out] - gain @ self.by_home[right]
            variance[out] = (
                np.diag(self.spread)[out]
                - (gain * between).sum(axis=1)
                + ((lever @ spread) * lever).sum(axis=1)
            )
        return innovation, variance

    @cached_property
    def odds(self) -> np.ndarray:
        """(q,): log odds of right against wrong, the rest of the set given."""
        p = self.problem.moved_prior
        return _log_density(*self.innovations) + math.log((1.0 - p) / p * TWO_PI)

    def odds_of(
        self, position: np.ndarray, covariance: np.ndarray, bearing: float, sigma: float
    ) -> float:
        """Return the log odds of right against wrong of one more home bearing.

        Parameters
        ----------
        position, covariance : ndarray, shape (2,), (2, 2)
            Of its landmark, in the odometry frame [m], [m^2].
        bearing, sigma : float
            What home stored, and its standard deviation [rad].
        """
        one = replace(
            self.problem,
            mean=np.concatenate([self.known[:HEAD], position]),
            covariance=np.zeros((HEAD + 2, HEAD + 2)),
            bearings=np.array([bearing]),
        )
        residual, _, by_home = linearise(one, self.home, one.mean)
        by_landmark = -by_home[0, :2]
        variance = sigma**2 + by_landmark @ covariance @ by_landmark
        variance += by_home[0] @ self.covariance[:3, :3] @ by_home[0]
        p = self.problem.moved_prior
        return float(
            _log_density(residual, np.array([variance]))[0] + math.log((1.0 - p) / p * TWO_PI)
        )

    @cached_property
    def _weighted(self) -> np.ndarray:
        """Return the residuals of the set after the step, times their precision."""
        right = self.right
        left = self.residual[right] - self.by_home[right] @ self.step
        return np.asarray(self.precision @ left)

    def _off_prior(self) -> np.ndarray:
        """Return how far the start prior's home is from where home was linearised, (3,)."""
        offset = np.zeros(3) if self.problem.prior is None else self.problem.prior - self.at
        offset[2] = wrap(offset[2])
        return offset

    def carried(self, problem: HomeProblem) -> HomeFit | None:
        """Return the fit after what is known has changed by next to nothing, linearised as here."""
        residual = self.residual - self.by_known @ (problem.mean - self.problem.mean)
        try:
            now = _solved(problem, self.right, self.at, residual, self.by_known, self.by_home)
        except np.linalg.LinAlgError:
            return None
        return replace(now, doubt=self._doubt)

    @cached_property
    def _doubt(self) -> np.ndarray:
        """Covariance of home beyond what the information on it says.

        Where home lies on the circle through the landmarks its position is not fixed at all; but
        the landmarks as mapped are never quite on the circle, and so seem to fix it. What their
        errors add to the information in the mean is taken out, down to a share of `LEAST_SHARE`.
        """
        if self.doubt is not None:
            return self.doubt
        d = self.landmarks[self.right] - self.at[:2]
        square = np.maximum((d**2).sum(axis=1), 1e-4)
        a, b = 2.0 * d[:, 0] * d[:, 1] / square**2, (d[:, 1] ** 2 - d[:, 0] ** 2) / square**2
        curvature = np.array([[a, b], [b, -a]]).transpose(2, 0, 1)
        errors = self._own_errors(d) / np.diag(self.spread)[self.right, None, None]
        chance = np.zeros((3, 3))
        chance[:2, :2] = (curvature @ errors @ curvature).sum(axis=0)
        root = np.linalg.cholesky(self.information)
        inverse = np.linalg.inv(root)
        shares, axes = np.linalg.eigh(inverse @ chance @ inverse.T)
        kept = root @ axes
        left = (kept * np.maximum(1.0 - shares, LEAST_SHARE)) @ kept.T + self.problem.vague
        return np.asarray(np.linalg.inv(left) - inverse.T @ inverse)

    def _own_errors(self, d: np.ndarray) -> np.ndarray:
        """Return the covariances (r, 2, 2) of landmarks seen from home at `d` (r, 2).

        What moves or turns all of them alike moves home with them, and is left out.
        """
        rigid = np.zeros((len(d), 2, 3))
        rigid[:, 0, 0] = rigid[:, 1, 1] = 1.0
        rigid[:, 0, 2], rigid[:, 1, 2] = -d[:, 1], d[:, 0]
        basis = np.linalg.qr(rigid.reshape(-1, 3))[0]
        own = np.eye(len(basis)) - basis @ basis.T
        of_set = np.repeat(np.concatenate([np.zeros(HEAD // 2, bool), self.right]), 2)
        errors = own @ self.problem.covariance[of_set][:, of_set] @ own
        each = np.arange(len(d))
        return np.asarray(errors.reshape(len(d), 2, len(d), 2)[each, :, each])


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
    known = problem.mean
    for _ in range(steps):
        try:
            now = _step(problem, home, known, right)
        except np.linalg.LinAlgError:
            return None
        if np.abs(now.step).max() < SETTLED:
            break
        home, known = now.home, now.known
    fixed = np.isfinite(now.step).all() and np.isfinite(now.information).all()
    fixed = fixed and (np.linalg.eigvalsh(now.information) > 0).all()
    return now if fixed and problem.is_near(now.home) else None


def _step(problem: HomeProblem, home: np.ndarray, known: np.ndarray, right: np.ndarray) -> HomeFit:
    """Return the fit after one Gauss-Newton step from `home` (3,) and what is known (4 + 2 q,)."""
    residual, by_known, by_home = linearise(problem, home, known)
    return _solved(problem, right, home, residual, by_known, by_home)


def _solved(
    problem: HomeProblem,
    right: np.ndarray,
    home: np.ndarray,
    residual: np.ndarray,
    by_known: np.ndarray,
    by_home: np.ndarray,
) -> HomeFit:
    """Return the fit to residuals (q,) of home bearings, linear around `home` (3,)."""
    correlated = problem.covariance @ by_known.T
    spread = by_known @ correlated
    spread.flat[:: right.size + 1] += problem.sigmas**2
    precision = np.linalg.inv(spread[right][:, right])
    weighted = by_home[right].T @ precision
    information, slope = weighted @ by_home[right] + problem.vague, weighted @ residual[right]
    if problem.prior is not None:
        offset = problem.prior - home
        offset[2] = wrap(offset[2])
        information = information + problem.prior_information
        slope = slope + problem.prior_information @ offset
    step = np.linalg.solve(information, slope)
    step *= min(1.0, LONGEST_STEP_M / max(float(np.abs(step).max()), 1e-12))
    return HomeFit(
        problem,
        right,
        home,
        step,
        residual,
        by_known,
        by_home,
        correlated,
        spread,
        precision,
        information,
    )


def _log_density(innovation: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Return the log density of innovations; uniform where nothing can be predicted."""
    variance = np.maximum(variance, 1e-12)
    normal = -0.5 * innovation**2 / variance - 0.5 * np.log(TWO_PI * variance)
    return np.where(variance > UNIFORM_FROM**2, -math.log(TWO_PI), normal)
