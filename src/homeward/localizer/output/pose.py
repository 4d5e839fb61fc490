"""Pose estimate in the home frame, under each hypothesis and under all of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from homeward.angles import wrap
from homeward.frames import Pose
from homeward.localizer.geometry import composition
from homeward.localizer.home.estimate import HomeFit
from homeward.localizer.home.hypotheses import Hypotheses
from homeward.localizer.home.linearisation import HOME, inverted
from homeward.localizer.output.tails import missing_tails
from homeward.localizer.tunables import INLIER_GATE, OUTLIER_SIGMA

CENTRE_STEPS = 20
AT_REST = 1e-3
"""A shorter step ends the search for the middle [standard deviations]."""


@dataclass(frozen=True)
class PoseEstimate:
    """Pose estimate: the robot in the home frame."""

    pose: Pose
    covariance: np.ndarray
    """(3, 3), of x [m], y [m] and heading [rad]."""

    @staticmethod
    def of(pose: np.ndarray, covariance: np.ndarray) -> PoseEstimate:
        """Return the estimate of a pose (3,) whose heading may not be wrapped."""
        x, y, heading = pose.tolist()
        return PoseEstimate(Pose(x, y, wrap(heading)), covariance)

    def propagate(self, delta: np.ndarray, drift: np.ndarray) -> PoseEstimate:
        """Propagate it by a motion.

        Parameters
        ----------
        delta : ndarray, shape (3,)
            The motion, in the robot's frame before it [m, m, rad].
        drift : ndarray, shape (3, 3)
            Covariance of the motion in that frame.
        """
        after, by_pose, turn = composition(np.array(self.pose), delta)
        covariance = by_pose @ self.covariance @ by_pose.T + turn @ drift @ turn.T
        return PoseEstimate.of(after, covariance)

    def with_more(self, covariance: np.ndarray) -> PoseEstimate:
        """Return it with a further covariance (3, 3)."""
        return PoseEstimate(self.pose, self.covariance + covariance)

    def with_mount(self, mount_covariance: np.ndarray) -> PoseEstimate:
        """Return it with an error (2, 2) of where the camera sat on the robot at home [m^2]."""
        covariance = self.covariance.copy()
        covariance[:2, :2] += mount_covariance
        return PoseEstimate(self.pose, covariance)

    def with_scale(self, sigma: float) -> PoseEstimate:
        """Return it with an error of the map's scale, of which `sigma` [1] is the deviation."""
        out = np.array([self.pose.x, self.pose.y, 0.0])
        return PoseEstimate(self.pose, self.covariance + sigma**2 * out[:, None] * out)


def in_home_frame(fit: HomeFit) -> PoseEstimate:
    """Return the newest keyframe's pose in the home frame, as one hypothesis has it."""
    return PoseEstimate.of(*fit.in_home_frame)


def uncheckable_outliers(fit: HomeFit, checked: np.ndarray) -> np.ndarray | None:
    """Return the covariance (3, 3) of the answer by faults that no home bearing could contradict.

    A bearing that all others together predict too vaguely agrees, right or wrong; so does any of
    three alone. Where there are more, the sets without one of them are hypotheses of their own.
    None where every bearing is `checked` (q,).
    """
    problem, alone = fit.problem, fit.inliers & ~checked
    if problem.prior is not None or not alone.any():
        return None
    by_bearing = fit.inverse[0] @ fit.whitened.weighted[alone[fit.inliers], HOME].T
    share = fit.moved_share(checked)
    moves = math.sqrt(share) * OUTLIER_SIGMA * fit.home_frame_jacobians[0] @ by_bearing
    # Faults are too large for the direction in which they move the pose to be linear.
    place, turn = np.linalg.norm(moves[:2], 2), np.linalg.norm(moves[2])
    return np.diag([place, place, turn]) ** 2


@dataclass(frozen=True)
class OtherHypotheses:
    """What other hypotheses add to the best one's answer."""

    shift: np.ndarray
    """(3,): of the pose."""
    share: float
    """Probability of the best one."""
    covariance: np.ndarray
    """(3, 3): what the others have of the covariance, and how far all are apart."""
    tails: np.ndarray | None = None
    """(3, 3): what must be added for a Gaussian to have their tails; None: nothing."""

    @staticmethod
    def nothing() -> OtherHypotheses:
        """Return what there is without any: nothing."""
        return OtherHypotheses(np.zeros(3), 1.0, np.zeros((3, 3)))


def other_hypotheses(hypotheses: Hypotheses) -> OtherHypotheses:
    """Return what makes the best hypothesis' answer that of all: their middle, their covariance."""
    if len(hypotheses.fits) == 1:
        return OtherHypotheses.nothing()
    weights = hypotheses.weights
    poses, covariances = (
        np.array(p) for p in zip(*(f.in_home_frame for f in hypotheses.fits), strict=True)
    )
    off = poses - poses[0]
    off[:, 2] = wrap(off[:, 2])
    each = weights[:, None, None] * covariances
    middle = centre(off, weights, each.sum(axis=0))
    off -= middle
    others = each[1:].sum(axis=0) + (weights * off.T) @ off
    tails = missing_tails(off, weights, covariances, each[0] + others)
    return OtherHypotheses(middle, float(weights[0]), others, tails)


def combined_estimate(
    best: HomeFit, others: OtherHypotheses, more: np.ndarray | None = None
) -> PoseEstimate:
    """Return the answer of all hypotheses, its covariance with `more` (3, 3) in it."""
    pose, alone = best.in_home_frame
    covariance = others.share * alone + others.covariance
    if more is not None:
        covariance += more
    # A large uncertainty bends round the landmarks: its sagitta is not in a Gaussian.
    (a, b), (_, d) = covariance[:2, :2].tolist()
    largest = 0.5 * (a + d) + math.hypot(0.5 * (a - d), b)
    sagitta = largest / (2.0 * landmark_distance(best, best.home))
    covariance[0, 0] += sagitta**2
    covariance[1, 1] += sagitta**2
    return PoseEstimate.of(pose + others.shift, covariance)


def centre(points: np.ndarray, weights: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the middle of weighted points: the mean of near ones, the median of far ones.

    It minimises the mean of sqrt(d^2 + INLIER_GATE^2), d being the distance in standard deviations
    (Weiszfeld's iteration). Alike hypotheses are averaged, which errs least; and unlike the mean it
    does not follow an improbable one far away.

    Parameters
    ----------
    points : ndarray, shape (k, n)
    weights : ndarray, shape (k,)
        Sum to one.
    covariance : ndarray, shape (n, n)
        Of a point.
    """
    if len(points) == 1:
        return np.asarray(points[0])
    # The middle is one of shares of the points, so products of these tell all distances.
    products, share = points @ inverted(covariance)[0] @ points.T, weights
    squares = products.diagonal() + INLIER_GATE**2
    for _ in range(CENTRE_STEPS):
        towards = products @ share
        pull = weights / np.sqrt(squares - 2.0 * towards + share @ towards)
        step = pull / pull.sum() - share
        share = share + step
        if step @ products @ step < AT_REST**2:
            break
    return np.asarray(share @ points)


def landmark_distance(fit: HomeFit, place: np.ndarray) -> float:
    """Return the median distance of home's landmarks from a place [m]; infinite without any."""
    d = np.concatenate([fit.problem.landmarks, fit.problem.surveyed]) - place[:2]
    squares = sorted((d * d).sum(axis=1).tolist())
    return math.sqrt(squares[len(squares) // 2]) if squares else math.inf
