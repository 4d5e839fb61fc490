"""Pose estimate in the home frame, for each hypothesis and for the mixture with its tails."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtr, ndtri

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.geometry.se2 import composition, difference
from homeward.geometry.statistics import ROUNDING
from homeward.localizer.home.estimate import HomeFit
from homeward.localizer.home.hypotheses import Hypotheses
from homeward.localizer.reference.sets import HOME, inverted
from homeward.localizer.tunables import (
    CENTRE_CONVERGED,
    FALSE_ALARM,
    INLIER,
    MAX_CENTRE_STEPS,
    NUM_HALVINGS,
    OUTLIER_SIGMA,
)


@dataclass(frozen=True)
class PoseEstimate:
    """Pose of the robot in the home frame, with covariance."""

    pose: Pose
    covariance: np.ndarray
    """(3, 3): of x [m], y [m] and heading [rad]."""

    @staticmethod
    def of(pose: np.ndarray, covariance: np.ndarray) -> PoseEstimate:
        """Return the estimate of a pose (3,) whose heading may not be wrapped."""
        x, y, heading = pose.tolist()
        return PoseEstimate(Pose(x, y, wrap(heading)), covariance)

    def after(
        self,
        moved: tuple[np.ndarray, np.ndarray] | None,
        more: CommonErrors,
        inflation: np.ndarray | None = None,
    ) -> tuple[PoseEstimate, np.ndarray]:
        """Return the estimate after a motion, with the errors common to all hypotheses.

        An `inflation` is returned separately, (3, 3): also after the motion.

        Parameters
        ----------
        moved : tuple of ndarray, shapes (3,) and (3, 3), or None
            The motion and its covariance, in the robot's frame before it [m, m, rad]; None: none.
        more : CommonErrors
            The errors.
        inflation : ndarray, shape (3, 3), optional
            Covariance that is to be added before the motion; None: nothing.
        """
        x, y, heading = self.pose
        covariance = self.covariance.copy()
        inflated = np.zeros((3, 3)) if inflation is None else inflation
        if moved is not None:
            after, by_pose, turn = composition(np.array(self.pose), moved[0])
            covariance = by_pose @ covariance @ by_pose.T + turn @ moved[1] @ turn.T
            if inflation is not None:
                inflated = by_pose @ inflation @ by_pose.T
            x, y, heading = after.tolist()
            heading = wrap(heading)
        if more.assumed_mount.any():
            c, s, same = math.cos(heading), math.sin(heading), float(more.same_camera)
            turned = np.array([[c - same, -s], [s, c - same]])
            covariance[:2, :2] += turned @ more.assumed_mount @ turned.T
        covariance[:2, :2] += more.mount
        out = np.array([x, y, 0.0])
        covariance += more.scale_sigma**2 * out[:, None] * out
        return PoseEstimate(Pose(x, y, heading), covariance), inflated


@dataclass
class CommonErrors:
    """Errors of a pose in the home frame that all hypotheses have in common."""

    mount: np.ndarray = field(default_factory=lambda: np.zeros((2, 2)))
    """(2, 2): covariance of the camera's x and y on the robot at home [m^2] ..."""
    assumed_mount: np.ndarray = field(default_factory=lambda: np.zeros((2, 2)))
    """(2, 2): ... and where these are assumed, not estimated [m^2]. The pose is then that of the
    camera, less its offset as home saw it."""
    same_camera: bool = True
    """Whether the camera sits now as it did at home."""
    scale_sigma: float = 0.0
    """Standard deviation of the map's scale [1]."""
    covariance_scale: float = 1.0
    """Factor of published covariances, for errors that no model contains [1]."""


def uncheckable_outliers(fit: HomeFit, checked: np.ndarray) -> np.ndarray | None:
    """Return the covariance (3, 3) of the pose by outliers that no home bearing can reveal.

    A bearing that all others together predict too vaguely agrees in any case; so do any three by
    themselves. If there are more, the sets without one of them are hypotheses of their own. None
    where every bearing is `checked` (q,).
    """
    problem, alone = fit.problem, fit.inliers & ~checked
    if problem.prior is not None or not alone.any():
        return None
    by_bearing = fit.solution.inverse @ fit.solution.weighted[alone, HOME].T
    share = fit.moved_share(checked)
    moves = math.sqrt(share) * OUTLIER_SIGMA * fit.home_frame_jacobians[0] @ by_bearing
    # Outliers are too large to take the direction in which they move the pose as linear.
    place, turn = np.linalg.norm(moves[:2], 2), np.linalg.norm(moves[2])
    return np.diag([place, place, turn]) ** 2


@dataclass(frozen=True)
class OtherHypotheses:
    """Contribution of the other hypotheses to the estimate of the best one."""

    shift: np.ndarray
    """(3,): shift of the pose."""
    share: float
    """Probability of the best hypothesis."""
    covariance: np.ndarray
    """(3, 3): covariance of the others, and of the spread between all."""
    tails: np.ndarray | None = None
    """(3, 3): inflation that bounds their tails; None: not needed."""

    @staticmethod
    def nothing() -> OtherHypotheses:
        """Return the contribution of none."""
        return OtherHypotheses(np.zeros(3), 1.0, np.zeros((3, 3)))


def other_hypotheses(hypotheses: Hypotheses) -> OtherHypotheses:
    """Return the contribution that makes the best hypothesis' estimate that of the mixture."""
    if len(hypotheses.fits) == 1:
        return OtherHypotheses.nothing()
    weights = hypotheses.weights
    poses, covariances = (
        np.array(p) for p in zip(*(f.in_home_frame for f in hypotheses.fits), strict=True)
    )
    off = difference(poses, poses[0])
    each = weights[:, None, None] * covariances
    middle = centre(off, weights, each.sum(axis=0))
    off -= middle
    others = each[1:].sum(axis=0) + (weights * off.T) @ off
    tails = missing_tails(off, weights, covariances, each[0] + others)
    return OtherHypotheses(middle, float(weights[0]), others, tails)


def combined_estimate(
    best: HomeFit, others: OtherHypotheses, inflation: np.ndarray | None = None
) -> PoseEstimate:
    """Return the estimate by the mixture of all hypotheses, with an `inflation` (3, 3)."""
    pose, alone = best.in_home_frame
    covariance = others.share * alone + others.covariance
    if inflation is not None:
        covariance += inflation
    # A large uncertainty is curved around the landmarks: add the sagitta of the arc.
    (a, b), (_, d) = covariance[:2, :2].tolist()
    largest = 0.5 * (a + d) + math.hypot(0.5 * (a - d), b)
    sagitta = largest / (2.0 * best.home_distance)
    covariance[0, 0] += sagitta**2
    covariance[1, 1] += sagitta**2
    return PoseEstimate.of(pose + others.shift, covariance)


def centre(points: np.ndarray, weights: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the robust centre of weighted points: mean of near ones, median of far ones.

    It minimises the mean of sqrt(d^2 + INLIER^2), a pseudo-Huber loss of the distance d in
    standard deviations (Weiszfeld's iteration). Similar hypotheses are averaged, which has the
    least error; and unlike the mean, the centre does not follow an improbable one far away.

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
    # The centre is a weighted mean of the points: their products give all distances.
    products, share = points @ inverted(covariance)[0] @ points.T, weights
    squares = products.diagonal() + INLIER**2
    for _ in range(MAX_CENTRE_STEPS):
        towards = products @ share
        # A squared distance is not negative; a point far away leaves rounding of its square.
        pull = weights / np.sqrt(np.maximum(squares - 2.0 * towards + share @ towards, INLIER**2))
        step = pull / pull.sum() - share
        share = share + step
        if step @ products @ step < CENTRE_CONVERGED**2:
            break
    return np.asarray(share @ points)


def missing_tails(
    off: np.ndarray, weights: np.ndarray, covariances: np.ndarray, covariance: np.ndarray
) -> np.ndarray | None:
    """Return what must be added to a mixture's covariance to bound its tails; None if nothing.

    Overbounding of a Gaussian mixture (DeCleene, 2000): no lighter tails than the mixture has. The
    second moment of a mixture is its mean squared error, not a bound: a component of 3 % that lies
    elsewhere is 5.7 standard deviations of the mixture away, where no Gaussian has 3 %. So the
    covariance is inflated until `INLIER` deviations contain all but `FALSE_ALARM` of the mixture,
    towards each of its components and along the axes.

    Parameters
    ----------
    off : ndarray, shape (k, n)
        Means of the components, from the centre of the mixture.
    weights : ndarray, shape (k,)
        Their probabilities; they sum to one.
    covariances : ndarray, shape (k, n, n)
        Of the components.
    covariance : ndarray, shape (n, n)
        Of the mixture: its second moment.

    Raises
    ------
    numpy.linalg.LinAlgError
        When the covariance is not positive definite.
    """
    root, unit = np.linalg.cholesky(covariance), np.eye(len(covariance))
    whiten = np.linalg.solve(root, unit)
    off, covariances = off @ whiten.T, whiten @ covariances @ whiten.T
    away = np.sqrt((off * off).sum(axis=1))
    apart = away > 1.0
    towards = np.concatenate([unit, off[apart] / away[apart, None]])
    # Whitened, the mixture has unit variance: a component's below its rounding may be negative.
    variances = np.maximum(((towards @ covariances) * towards).sum(axis=2), ROUNDING)
    at, sigma = towards @ off.T, np.sqrt(variances).T
    lacks = _beyond(np.full(len(at), INLIER), at, sigma, weights) > FALSE_ALARM
    if not lacks.any():
        return None
    towards, quantile = towards[lacks], _quantile(at[lacks], sigma[lacks], weights)
    wide = unit.copy()
    for i in np.argsort(-quantile).tolist():
        along = wide @ towards[i]
        variance, needed = float(towards[i] @ along), (quantile[i] / INLIER) ** 2
        if needed > variance:
            wide += (needed - variance) / variance**2 * along[:, None] * along
    return np.asarray(root @ (wide - unit) @ root.T)


def _quantile(at: np.ndarray, sigma: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the two-sided `FALSE_ALARM` quantiles of mixtures on a line (u,); see `_beyond`."""
    # Bounds: each component alone, and all of them if each had its share of the probability.
    alone, share = FALSE_ALARM / weights, 0.5 * FALSE_ALARM / (weights.size * weights)
    near, far = (
        (np.abs(at) - sigma * ndtri(np.minimum(p, 1.0))).max(axis=1) for p in (alone, share)
    )
    for _ in range(NUM_HALVINGS):
        middle = 0.5 * (near + far)
        reaches = _beyond(middle, at, sigma, weights) > FALSE_ALARM
        near, far = np.where(reaches, middle, near), np.where(reaches, far, middle)
    return np.asarray(far)


def _beyond(
    limit: np.ndarray, at: np.ndarray, sigma: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Return the probability (u,) of one-dimensional mixtures beyond a limit (u,) to both sides.

    Their components are Gaussians with `weights` (k,), at `at` and with `sigma`, both (u, k).
    """
    both = np.stack([at, -at]) - limit[:, None]
    return np.asarray(ndtr(both / sigma).sum(axis=0) @ weights)
