"""Home by least squares among the mapped landmarks, for a given set of inlier home bearings.

Everything is Gaussian around one point: the map's state (newest pose, camera yaw, landmarks that
home saw), the home bearings of the set, and a start prior if there is one. The algebra is in
`homeward.localizer.reference.sets`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.se2 import MIN_DISTANCE, difference, lever, rotation
from homeward.geometry.statistics import positive
from homeward.localizer import kernels
from homeward.localizer.home.problem import Assumption, HomeProblem
from homeward.localizer.home.spurious_information import spurious_covariance
from homeward.localizer.reference.labels import log_odds, moved_share
from homeward.localizer.reference.sets import (
    POSE_AND_YAW,
    YAW,
    Evidence,
    HomeSolution,
    Linear,
    expected,
    posterior,
)
from homeward.localizer.tunables import (
    CLOSE,
    CUT_SHORT,
    MAX_FIT_STEPS,
    MAX_LAST_STEP,
    OUTLIER_SIGMA,
    SAME_HOME,
)


@dataclass(frozen=True)
class HomeFit:
    """Gaussian posterior of home, pose and map for one set of inliers, evaluated lazily."""

    problem: HomeProblem
    """The resection problem, ..."""
    linear: Linear
    """... its linearisation, ..."""
    inliers: np.ndarray
    """(q,), bool: ... the set, ..."""
    solution: HomeSolution
    """... and its solution."""
    known_inflation: np.ndarray | None = None
    """(3, 3): `inflation` of the fit that this one was propagated from, ..."""
    fitted: Linear | None = None
    """... and the linearisation of the last one that was not propagated."""

    @cached_property
    def home(self) -> np.ndarray:
        """(3,): pose of the robot at home, in the odometry frame."""
        return np.asarray(self.linear.at + self.solution.step)

    @property
    def has_changed(self) -> bool:
        """Whether a residual, or its variance, has changed notably since home was fitted."""
        now, then = self.linear, self.fitted or self.linear
        off, variance = now.residual - then.residual, then.residual_covariance.diagonal()
        wider = np.abs(now.residual_covariance.diagonal() - variance)
        return bool(((off**2 > CLOSE**2 * variance) | (wider > CLOSE * variance)).any())

    @cached_property
    def converged(self) -> bool:
        """Whether the last step was small compared with home's uncertainty, and not limited."""
        step, information = self.solution.step, self.solution.information
        whole = self.problem.step_length(step) < CUT_SHORT
        return bool(whole and step @ information @ step < MAX_LAST_STEP**2)

    def is_same_home(self, home: np.ndarray) -> bool:
        """Return whether another home (3,) is the same, within its uncertainty."""
        off = difference(self.home, home)
        return bool(off @ self.solution.information @ off < SAME_HOME**2)

    def landmark_distance(self, place: np.ndarray) -> float:
        """Return the median distance of home's landmarks from a place [m]; infinite without any.

        At least `MIN_DISTANCE`: the place may be that of a landmark.
        """
        marks = self.problem.landmarks
        if self.problem.surveyed.size:
            marks = np.concatenate([marks, self.problem.surveyed])
        dx, dy = (marks - place[:2]).T
        squares = np.sort(dx * dx + dy * dy)
        if not squares.size:
            return math.inf
        return max(math.sqrt(squares[squares.size // 2]), MIN_DISTANCE)

    @cached_property
    def home_distance(self) -> float:
        """Median distance of home's landmarks from home [m]."""
        return self.landmark_distance(self.home)

    @cached_property
    def state(self) -> np.ndarray:
        """(4 + 2 q,): posterior of pose, camera yaw and landmarks."""
        return posterior(self.problem.arrays, self.linear, self.solution)

    @property
    def pose(self) -> np.ndarray:
        """(3,): posterior of the newest pose, in the odometry frame."""
        return self.solution.pose

    @property
    def landmarks(self) -> np.ndarray:
        """(q, 2): posterior of the landmarks' positions [m]."""
        return np.asarray(self.state[POSE_AND_YAW:].reshape(-1, 2))

    @cached_property
    def covariance(self) -> np.ndarray:
        """(3, 3): covariance of home."""
        return np.asarray(self.solution.inverse + self.inflation)

    @cached_property
    def home_frame_jacobians(self) -> tuple[np.ndarray, np.ndarray]:
        """(3, 3), (3, 3): Jacobians of the newest pose in the home frame, by home and by the pose.

        That by home is total: home bearings let the pose follow home.
        """
        by_pose = rotation(float(self.home[2])).T
        return -by_pose @ (lever(self.pose - self.home) + self.solution.pose_by_home), by_pose

    @cached_property
    def in_home_frame(self) -> tuple[np.ndarray, np.ndarray]:
        """(3,), (3, 3): newest pose in the home frame, heading not wrapped, and its covariance."""
        found, before = self.solution, self.problem.covariance[:3, :3]
        by_home, by_pose = self.home_frame_jacobians
        of_home = self.covariance + found.inverse @ found.walk_information @ found.inverse
        covariance = by_home @ of_home @ by_home.T + by_pose @ found.pose_covariance @ by_pose.T
        terms = float((by_home * by_home).sum() * self.covariance.trace() + before.trace())
        covariance = positive(covariance, "the covariance of a pose in the home frame", terms)
        return by_pose @ (self.pose - self.home), covariance

    @cached_property
    def evidence(self) -> Evidence:
        """Evidence of the set, and for and against each home bearing."""
        return kernels.weigh_set(self.problem.arrays, self.linear, self.inliers, self.solution)

    @cached_property
    def log_evidence(self) -> float:
        """Log evidence of the set, up to a constant common to all sets."""
        problem = self.problem
        before = problem.log_density(self.home) + problem.log_assumption_prior
        return self.evidence.log_evidence + before

    @property
    def key(self) -> tuple[Assumption, bytes]:
        """Key: the noise scale of the home bearings, and the set."""
        return self.problem.assumed, self.inliers.tobytes()

    @property
    def seed(self) -> tuple[np.ndarray, np.ndarray, Assumption]:
        """Seed for a search: home, the set, and the noise scale of the home bearings."""
        return self.home, self.inliers, self.problem.assumed

    @property
    def innovations(self) -> tuple[np.ndarray, np.ndarray]:
        """(q,), (q,): innovations of the home bearings by all else [rad], and their variances."""
        return self.evidence.innovation, self.evidence.variance

    @cached_property
    def checked(self) -> np.ndarray:
        """(q,), bool: members of the set that the others predict well enough to contradict."""
        if self.inliers.sum() <= self.problem.min_inliers:
            return np.zeros_like(self.inliers)
        checked = self.inliers & (self.evidence.variance < OUTLIER_SIGMA**2)
        if self.problem.bodies.members.size:  # a body does not check itself
            bodies = self.problem.bodies.members & self.inliers
            others = self.inliers.sum() - bodies.sum(axis=1, keepdims=True)
            checked &= ~(bodies & (others < self.problem.min_inliers)).any(axis=0)
        return np.asarray(checked)

    @property
    def odds(self) -> np.ndarray:
        """(q,): log odds of each to be an inlier, given the rest of the set.

        Two that are exchanged are inliers, or the exchange is wrong.
        """
        return np.where(self.problem.is_exchanged, np.inf, self.evidence.odds)

    def odds_of(
        self,
        places: np.ndarray,
        covariances: np.ndarray,
        bearings: np.ndarray,
        sigmas: np.ndarray,
        offsets: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the log odds of further home bearings to be inliers, shape (k,).

        `places` (k, 2) [m] and `covariances` (k, 2, 2) are of their landmarks in the odometry
        frame, `bearings` and `sigmas` (k,) the stored home bearings and their standard deviations
        [rad], `offsets` (k, 3) as in `HomeProblem`.
        """
        yaw = self.state[YAW]
        bearing, by_place, by_home, _ = expected(self.problem, self.home, places, yaw, offsets)
        variance = sigmas**2 + np.einsum("ki,kij,kj->k", by_place, covariances, by_place)
        variance += ((by_home @ self.covariance) * by_home).sum(axis=1)
        return log_odds(wrap(bearings - bearing), variance, self.moved_share(self.inliers))

    def moved_share(self, right: np.ndarray) -> float:
        """Return the prior probability of another outlier, given the inliers `right` (q,)."""
        wrong = int(np.count_nonzero(~self.inliers))
        return float(moved_share(int(right.sum()), wrong, self.problem.moved_prior))

    @cached_property
    def inflation(self) -> np.ndarray:
        """(3, 3): covariance inflation of home; see `spurious_information`."""
        if self.known_inflation is not None:
            return self.known_inflation
        members, information = self.inliers.nonzero()[0], self.solution.information
        return spurious_covariance(self.problem, self.linear, members, self.landmarks, information)


def fit(
    problem: HomeProblem, home: np.ndarray, inliers: np.ndarray, steps: int = MAX_FIT_STEPS
) -> HomeFit | None:
    """Fit home (3,) to inlier home bearings (q,); None when they do not determine it.

    At most `steps` Gauss-Newton steps from `home`.
    """
    if np.count_nonzero(inliers) < problem.min_inliers:
        return None
    found = kernels.fit_home(problem.arrays, home, inliers, steps)
    if found is None:
        return None
    linear, solution = found
    now = HomeFit(problem, linear, inliers, solution)
    return now if problem.is_plausible(now.home) else None


def propagated(fit: HomeFit, problem: HomeProblem) -> HomeFit | None:
    """Return a fit after a negligible change of the map, with the old linearisation."""
    problem = problem.under(fit.problem.assumed)
    found = kernels.propagate_home(problem.arrays, fit.linear, fit.problem.mean, fit.inliers)
    if found is None:
        return None
    linear, solution = found
    fitted = fit.fitted or fit.linear
    return HomeFit(problem, linear, fit.inliers, solution, fit.inflation, fitted)


def solved(
    lead: HomeFit, inliers: np.ndarray, inflation: np.ndarray | None = None
) -> HomeFit | None:
    """Solve the problem of another fit, as linearised there, for inliers (q,).

    None when they do not determine home. `inflation` (3, 3) is that of `HomeFit`; evaluated lazily
    unless given.
    """
    solution = kernels.solve_set(lead.problem.arrays, lead.linear, inliers)
    if solution is None:
        return None
    return HomeFit(lead.problem, lead.linear, inliers, solution, inflation, lead.fitted)
