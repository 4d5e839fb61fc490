"""Home by least squares among the mapped landmarks, for a given set of inlier home bearings.

Everything here is Gaussian around one point: the map's marginal (newest pose, camera yaw, the
landmarks that home saw), the home bearings of the chosen set, and a start prior where there is one.
What it says of the home bearings and of the set is in `evidence`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from homeward.angles import wrap
from homeward.localizer.geometry import lever, rotation
from homeward.localizer.home.evidence import Evidence, log_odds, moved_share
from homeward.localizer.home.linearisation import (
    HOME,
    POSE,
    RESIDUAL,
    Linear,
    Whitened,
    expected,
    inverted,
)
from homeward.localizer.home.problem import POSE_AND_YAW, YAW, HomeProblem
from homeward.localizer.home.spurious_information import spurious_covariance
from homeward.localizer.tunables import OUTLIER_SIGMA

BESIDE = 1.0
"""Homes that are so near are the same one [standard deviations]."""
CUT_SHORT = 0.999
"""A longer step was cut short to the longest that is taken at once."""
UNSETTLED = 0.5
"""A last step longer than this says that the fit has not come to rest [standard deviations]."""


@dataclass(frozen=True)
class HomeFit:
    """Gaussian posterior of home, pose and map for one set of inliers, worked out when asked."""

    linear: Linear
    inliers: np.ndarray
    """(q,), bool: the set."""
    step: np.ndarray
    """(3,): from where home was linearised to where it is."""
    of_set: Whitened
    """Its residuals, whitened."""
    information: np.ndarray
    """(3, 3): on home."""
    known_inflation: np.ndarray | None = None
    """(3, 3): `inflation`, of the fit that this one was propagated from."""

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
        """Whether the last step was small against home's own uncertainty, and not cut short."""
        whole = self.problem.length(self.step) < CUT_SHORT
        return bool(whole and self.step @ self.information @ self.step < UNSETTLED**2)

    def is_beside(self, home: np.ndarray) -> bool:
        """Return whether another home (3,) is this one, within its uncertainty."""
        off = self.home - home
        off[2] = wrap(off[2])
        return bool(off @ self.information @ off < BESIDE**2)

    @cached_property
    def known(self) -> np.ndarray:
        """(4 + 2 q,): pose, camera yaw and landmarks, corrected by the home bearings."""
        weighted = np.zeros(self.inliers.size)
        by_home, residual = self.of_set.weighted[:, HOME], self.of_set.weighted[:, RESIDUAL]
        weighted[self.of_set.members] = residual - by_home @ self.step
        return np.asarray(self.problem.mean + weighted @ self.linear.correlated)

    @cached_property
    def pose(self) -> np.ndarray:
        """(3,): newest pose in the odometry frame, corrected."""
        correction = self.of_set.products[POSE, RESIDUAL] - self.by_home @ self.step
        return np.asarray(self.problem.mean[:3] + correction)

    @property
    def landmarks(self) -> np.ndarray:
        """(q, 2): corrected positions [m]."""
        return np.asarray(self.known[POSE_AND_YAW:].reshape(-1, 2))

    @cached_property
    def inverse(self) -> tuple[np.ndarray, float]:
        """(3, 3): inverse of the information on home; and the log of the latter's determinant."""
        return inverted(self.information)

    @cached_property
    def covariance(self) -> np.ndarray:
        """(3, 3): covariance of home."""
        return np.asarray(self.inverse[0] + self.inflation)

    @property
    def by_home(self) -> np.ndarray:
        """(3, 3): minus the derivative of the newest pose by home."""
        return self.of_set.products[POSE, HOME]

    @property
    def pose_covariance(self) -> np.ndarray:
        """(3, 3): covariance of the newest pose, were home known."""
        return np.asarray(self.problem.covariance[:3, :3] - self.of_set.products[POSE, POSE])

    @property
    def home_frame_jacobians(self) -> tuple[np.ndarray, np.ndarray]:
        """(3, 3), (3, 3): of the newest pose in the home frame, by home and by the pose.

        Home moves the pose with it.
        """
        by_pose = rotation(self.home[2]).T
        return -by_pose @ (lever(self.pose - self.home) + self.by_home), by_pose

    @cached_property
    def in_home_frame(self) -> tuple[np.ndarray, np.ndarray]:
        """(3,), (3, 3): newest pose in the home frame, heading not wrapped, and its covariance."""
        by_home, by_pose = self.home_frame_jacobians
        covariance = by_home @ self.covariance @ by_home.T
        covariance += by_pose @ self.pose_covariance @ by_pose.T
        covariance += self._uncounted(by_home)
        return by_pose @ (self.pose - self.home), 0.5 * (covariance + covariance.T)

    def _uncounted(self, by_home: np.ndarray) -> np.ndarray:
        """Return the covariance (3, 3) from landmarks that may walk, beyond what they count for."""
        if self.problem.uncounted is None:
            return np.zeros((3, 3))
        members = self.of_set.members
        each = POSE_AND_YAW + 2 * members[:, None] + np.arange(2)
        by_place = self.linear.by_known[members[:, None], each]
        variance = np.einsum("ki,kij,kj->k", by_place, self.problem.uncounted[members], by_place)
        by_bearing = by_home @ self.inverse[0] @ self.of_set.weighted[:, HOME].T
        return np.asarray(variance * by_bearing @ by_bearing.T)

    @cached_property
    def evidence(self) -> Evidence:
        """What it says of each home bearing and of the set."""
        return Evidence(self.linear, self.of_set, self.step, self.information, *self.inverse)

    @cached_property
    def log_evidence(self) -> float:
        """Log of the evidence of the set, up to a constant that all sets share."""
        problem = self.problem
        before = problem.log_density(self.home) + problem.log_noise_prior
        return self.evidence.log_evidence + before

    @property
    def key(self) -> tuple[float, bytes]:
        """What tells it from others: the noise of home's bearings, and the set."""
        return self.problem.noise_scale, self.inliers.tobytes()

    @property
    def seed(self) -> tuple[np.ndarray, np.ndarray, float]:
        """What it is found again from: home, the set, and the noise of home's bearings."""
        return self.home, self.inliers, self.problem.noise_scale

    @property
    def innovations(self) -> tuple[np.ndarray, np.ndarray]:
        """(q,), (q,): stored minus predicted by everything else [rad], and its variance."""
        return self.evidence.innovation, self.evidence.variance

    @cached_property
    def checked(self) -> np.ndarray:
        """(q,), bool: those of the set that the others predict well enough to contradict them."""
        if self.inliers.sum() <= self.problem.fewest:
            return np.zeros_like(self.inliers)
        return np.asarray(self.inliers & (self.evidence.variance < OUTLIER_SIGMA**2))

    @property
    def odds(self) -> np.ndarray:
        """(q,): log odds of right against wrong, the rest of the set given."""
        return self.evidence.odds

    def odds_of(
        self, places: np.ndarray, covariances: np.ndarray, bearings: np.ndarray, sigmas: np.ndarray
    ) -> np.ndarray:
        """Return the log odds of right against wrong of further home bearings, shape (k,).

        Parameters
        ----------
        places, covariances : ndarray, shape (k, 2), (k, 2, 2)
            Where their landmarks may stand, in the odometry frame [m], [m^2].
        bearings, sigmas : ndarray, shape (k,)
            What home stored, and the standard deviations [rad].
        """
        bearing, by_place, by_home = expected(self.problem, self.home, places, self.known[YAW])
        variance = sigmas**2 + np.einsum("ki,kij,kj->k", by_place, covariances, by_place)
        variance += ((by_home @ self.covariance) * by_home).sum(axis=1)
        return log_odds(wrap(bearings - bearing), variance, self.moved_share(self.inliers))

    def moved_share(self, right: np.ndarray) -> float:
        """Return how probable one more is to be wrong, where these (q,) were shown to be right."""
        wrong = int(np.count_nonzero(~self.inliers))
        return float(moved_share(int(right.sum()), wrong, self.problem.moved_prior))

    @cached_property
    def inflation(self) -> np.ndarray:
        """(3, 3): covariance of home beyond its information; see `spurious_information`."""
        if self.known_inflation is not None:
            return self.known_inflation
        return spurious_covariance(
            self.linear, self.of_set.members, self.landmarks, self.information
        )
