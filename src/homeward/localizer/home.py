"""Home among the mapped landmarks, for a given set of right home bearings: fit and evidence.

Everything here is Gaussian around one point: the map's marginal (newest pose, camera yaw, the
landmarks that home saw), the home bearings of the chosen set, and a start prior where there is one.
The evidence of a set is the integral over all unknowns, home included (Laplace), so that sets of
different size compare fairly; for wrong bearings see `faults`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from homeward.angles import TWO_PI, wrap
from homeward.localizer.compiled import address, compiled
from homeward.localizer.faults import log_odds, log_wrong
from homeward.localizer.linear import Linear, linearised
from homeward.localizer.problem import HEAD, HomeProblem

UNSETTLED = 0.5
"""A last step longer than this says that the fit has not come to rest [standard deviations]."""
LEAST_SHARE = 0.002
"""So much of the information on home is left at least when errors of the map are taken out [1]."""


@dataclass(frozen=True)
class HomeFit:
    """Home for one set of right home bearings; what follows from it is worked out when asked."""

    linear: Linear
    right: np.ndarray
    """(q,), bool: the set."""
    step: np.ndarray
    """(3,): from where home was linearised to where it is."""
    precision: np.ndarray
    """(q, q): inverse of the spread of the set; zero outside of it."""
    information: np.ndarray
    """(3, 3): on home."""
    log_volume: float
    """Log of the determinant of the spread of the set."""
    known_doubt: np.ndarray | None = None
    """(3, 3): see `doubt`; from the fit that this one was carried on from."""

    @property
    def problem(self) -> HomeProblem:
        """What is known."""
        return self.linear.problem

    @cached_property
    def home(self) -> np.ndarray:
        """(3,): pose of the robot at home, in the odometry frame."""
        return np.asarray(self.linear.at + self.step)

    @cached_property
    def settled(self) -> bool:
        """Whether the last step was small against home's own uncertainty."""
        return bool(self.step @ self.information @ self.step < UNSETTLED**2)

    @cached_property
    def known(self) -> np.ndarray:
        """(4 + 2 q,): pose, camera yaw and landmarks, corrected by the home bearings."""
        return np.asarray(self.problem.mean + self._weighted @ self.linear.correlated)

    @property
    def pose(self) -> np.ndarray:
        """(3,): newest pose in the odometry frame, corrected."""
        return np.asarray(self.known[:3])

    @property
    def landmarks(self) -> np.ndarray:
        """(q, 2): corrected positions [m]."""
        return np.asarray(self.known[HEAD:].reshape(-1, 2))

    @cached_property
    def spread(self) -> np.ndarray:
        """(3, 3): covariance of home."""
        return np.asarray(np.linalg.inv(self.information) + self.doubt)

    @cached_property
    def by_home(self) -> np.ndarray:
        """(3, 3): minus the derivative of the newest pose by home."""
        return np.asarray(self._gain @ self.linear.by_home)

    @cached_property
    def pose_spread(self) -> np.ndarray:
        """(3, 3): covariance of the newest pose, were home known."""
        with_pose = self.linear.correlated[:, :3]
        return np.asarray(self.problem.covariance[:3, :3] - self._gain @ with_pose)

    @cached_property
    def covariance(self) -> np.ndarray:
        """(6, 6), of home and newest pose."""
        together = -self.spread @ self.by_home.T
        pose = self.pose_spread - self.by_home @ together
        joint = np.block([[self.spread, together], [together.T, pose]])
        return np.asarray(0.5 * (joint + joint.T))

    @cached_property
    def _gain(self) -> np.ndarray:
        """(3, q): of the residuals, on the newest pose."""
        return np.asarray(self.linear.correlated[:, :3].T @ self.precision)

    @cached_property
    def evidence(self) -> float:
        """Log of the evidence of the set, up to a constant that all sets share."""
        problem, n, q = self.problem, int(self.right.sum()), self.right.size
        residual = self.linear.residual
        square = residual @ self.precision @ residual - self.step @ self.information @ self.step
        if problem.prior is not None:
            offset = self._off_prior()
            square += offset @ problem.prior_information @ offset
        log_density = -0.5 * (self.log_volume + n * math.log(TWO_PI))
        log_volume = 0.5 * (3.0 * math.log(TWO_PI) - np.linalg.slogdet(self.information)[1])
        p = problem.moved_prior
        labels = n * math.log(1.0 - p) + (q - n) * math.log(p)
        wrong = log_wrong(*self.innovations)[~self.right].sum()
        return float(-0.5 * square + log_density + log_volume + labels + wrong)

    @cached_property
    def innovations(self) -> tuple[np.ndarray, np.ndarray]:
        """(q,), (q,): stored minus predicted by everything else [rad], and its variance."""
        linear, out, q = self.linear, ~self.right, self.right.size
        native = compiled()
        if native is not None:
            innovation, variance = np.empty(q), np.empty(q)
            given = (self.right.astype(float), linear.spread, self.precision, linear.by_home)
            told = (linear.residual, self.information, self.step, np.empty(4 * q))
            if native.innovate(q, *map(address, (*given, *told, innovation, variance))):
                raise np.linalg.LinAlgError("home is not fixed")
            return innovation, variance
        spread = np.linalg.inv(self.information)
        lever = self.precision @ linear.by_home
        rest = self.precision.diagonal() - ((lever @ spread) * lever).sum(axis=1)
        rest = np.maximum(rest, 1e-9)
        innovation, variance = self._weighted / rest, 1.0 / rest
        if out.any():
            between, by_home = linear.spread[out], linear.by_home[out]
            innovation[out] = wrap(
                linear.residual[out] - by_home @ self.step - between @ self._weighted
            )
            gain = between @ self.precision
            lever = by_home - gain @ linear.by_home
            variance[out] = (
                linear.spread.diagonal()[out]
                - (gain * between).sum(axis=1)
                + ((lever @ spread) * lever).sum(axis=1)
            )
        return innovation, variance

    @cached_property
    def odds(self) -> np.ndarray:
        """(q,): log odds of right against wrong, the rest of the set given."""
        return log_odds(*self.innovations, self.problem.moved_prior)

    def odds_of(
        self, places: np.ndarray, covariances: np.ndarray, bearing: float, sigma: float
    ) -> np.ndarray:
        """Return the log odds of right against wrong of one more home bearing, shape (k,).

        Parameters
        ----------
        places, covariances : ndarray, shape (k, 2), (k, 2, 2)
            Where its landmark may stand, in the odometry frame [m], [m^2].
        bearing, sigma : float
            What home stored, and its standard deviation [rad].
        """
        size = HEAD + places.size
        there = replace(
            self.problem,
            mean=np.concatenate([self.known[:HEAD], places.ravel()]),
            covariance=np.zeros((size, size)),
            bearings=np.full(len(places), bearing),
            sigmas=np.full(len(places), sigma),
        )
        seen = linearised(there, self.home, there.mean)
        by_place, by_home = -seen.by_home[:, :2], seen.by_home
        variance = sigma**2 + np.einsum("ki,kij,kj->k", by_place, covariances, by_place)
        variance += ((by_home @ self.spread) * by_home).sum(axis=1)
        return log_odds(seen.residual, variance, self.problem.moved_prior)

    @cached_property
    def _weighted(self) -> np.ndarray:
        """Return the residuals of the set after the step, times their precision (q,)."""
        left = self.linear.residual - self.linear.by_home @ self.step
        return np.asarray(self.precision @ left)

    def _off_prior(self) -> np.ndarray:
        """Return how far the start prior's home is from where home was linearised, (3,)."""
        offset = np.zeros(3) if self.problem.prior is None else self.problem.prior - self.linear.at
        offset[2] = wrap(offset[2])
        return offset

    @cached_property
    def doubt(self) -> np.ndarray:
        """(3, 3): covariance of home beyond what the information on it says.

        Where home lies on the circle through the landmarks its position is not fixed at all; but
        the landmarks as mapped are never quite on the circle, and so seem to fix it. What their
        errors add to the information in the mean is taken out, down to a share of `LEAST_SHARE`.
        """
        if self.known_doubt is not None:
            return self.known_doubt
        d = self.landmarks[self.right] - self.linear.at[:2]
        square = np.maximum((d**2).sum(axis=1), 1e-4)
        a, b = 2.0 * d[:, 0] * d[:, 1] / square**2, (d[:, 1] ** 2 - d[:, 0] ** 2) / square**2
        curvature = np.array([[a, b], [b, -a]]).transpose(2, 0, 1)
        errors = self._own_errors(d) / self.linear.spread.diagonal()[self.right, None, None]
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
