"""Integrity monitoring: whether there is a pose to publish, its status and the reason."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from homeward.estimator import MIN_AGREEING, Estimate, Innovation, Status
from homeward.geometry.frames import Pose
from homeward.geometry.se2 import rotation
from homeward.geometry.statistics import positive
from homeward.io.naming import natural
from homeward.io.table import quoted
from homeward.localizer.home.estimate import HomeFit
from homeward.localizer.home.hypotheses import Hypotheses
from homeward.localizer.output.pose import (
    CommonErrors,
    OtherHypotheses,
    PoseEstimate,
    combined_estimate,
    other_hypotheses,
    uncheckable_outliers,
)
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import CLOSE, FIX_HYSTERESIS, INLIER, MINIMAL
from homeward.reasons import Reason, too_few_agree


def why_home_is_not_found(
    mapped: Collection[str], home: Collection[str], used: Collection[str], has_odometry: bool
) -> str:
    """Return why home was not found.

    Parameters
    ----------
    mapped : collection of str
        Landmarks in the map.
    home : collection of str
        Landmarks that home saw.
    used : collection of str
        Those of them that are mapped.
    has_odometry : bool
        Whether odometry has come yet.
    """
    if len(home) < MINIMAL:
        return too_few_at_home(len(home))
    if not has_odometry:
        return "no odometry has come yet; without it no landmark can be mapped"
    if not mapped:
        return "no landmark is mapped yet; drive an arc to see them from other places"
    if not used and len(mapped) >= MINIMAL:
        first = (sorted(ids, key=natural)[:2] for ids in (mapped, home))
        own, others = (" and ".join(map(quoted, ids)) for ids in first)
        none = f"none of the {len(mapped)} landmarks that are mapped was seen from home"
        return f"{none}: they have ids such as {own}, those of home {others}"
    needed = f"{MINIMAL} are needed; drive an arc"
    return f"{len(used)} of the landmarks that home saw are mapped; {needed}"


def too_few_at_home(number: int) -> str:
    """Return that home saw too few landmarks to check each other."""
    landmarks = "1 landmark" if number == 1 else f"{number} landmarks"
    return f"home saw only {landmarks}; {MIN_AGREEING} are needed for a verified pose"


class IntegrityMonitor:
    """Integrity monitor: the pose by all hypotheses, and how far it can be relied on.

    Parameters
    ----------
    settings : LocalizerSettings
        Settings of the localiser.
    scale_sigma : float or None
        Standard deviation of the map's scale that is not in the state; None: the state contains it.
    """

    def __init__(self, settings: LocalizerSettings, scale_sigma: float | None) -> None:
        self._settings, self._scale_sigma = settings, scale_sigma
        self._best: HomeFit | None = None
        """The most probable hypothesis; None where home is not found."""
        self._estimate = PoseEstimate(Pose(0.0, 0.0, 0.0), np.zeros((3, 3)))
        """Pose at the newest keyframe, without the uncertainty of scale."""
        self._others = OtherHypotheses.nothing()
        self._weights: np.ndarray | None = None
        """Probabilities of the hypotheses in `_others`."""
        self._checked = self._stayed = np.zeros(0, bool)
        """Home bearings of the best one that the others check, and those of landmarks that stayed.
        """
        self._rival_probability = 0.0
        self._max_sigma = math.inf
        """Largest standard deviation of a pose that is published already [m] ..."""
        self._max_survey_sigma = math.inf
        """... and of one by a survey to be relied on [m]."""
        self.fixed = False
        """Whether the pose is certain enough to be published."""
        self.errors = CommonErrors()
        """Errors that are not in the hypotheses: of the camera's pose, and of scale."""
        self.set_scale_variance(0.0)

    def set_scale_variance(self, variance: float) -> None:
        """Set the variance of the map's scale, next to that of the speed's [1]."""
        given = self._scale_sigma
        self.errors.scale_sigma = 0.0 if given is None else math.sqrt(given**2 + variance)

    def update(
        self, now: Hypotheses | None, solved: bool, stayed: np.ndarray | None = None
    ) -> None:
        """Update by the hypotheses of a new keyframe.

        Parameters
        ----------
        now : Hypotheses or None
            None if home was not found.
        solved : bool
            Whether they come from a solution with landmarks in sight: only then may a pose be
            withdrawn.
        stayed : ndarray, shape (q,), bool, optional
            Which landmarks are still where they were first mapped; all by default.
        """
        self._best = None if now is None else now.best
        if now is None:
            self.fixed, self._weights = False, None
            return
        self._stayed = np.ones_like(now.best.inliers) if stayed is None else stayed
        if now.weights is not self._weights:  # not only propagated
            self._others, self._weights = other_hypotheses(now), now.weights
            self._checked = now.best.checked
        self._estimate = combined_estimate(now.best, self._others)
        if solved or not self.fixed:
            converged = self.fixed or (now.best.converged and now.unconverged_probability < 0.5)
            self.fixed = converged and self._is_fixed(now.best)
            self._rival_probability = now.rivals(INLIER)
        outliers = uncheckable_outliers(now.best, self._checked)
        if outliers is not None:
            self._estimate = combined_estimate(now.best, self._others, outliers)
            self.fixed &= _sigma(self._estimate.covariance) <= self._max_sigma

    def estimate(
        self,
        t: float,
        moved: tuple[np.ndarray, np.ndarray] | None,
        between_stamps: np.ndarray,
        coasting: bool,
        innovations: tuple[Innovation, ...] = (),
    ) -> Estimate:
        """Return the estimate: the pose if there is one, its status and the reason.

        Parameters
        ----------
        t : float
            When [s].
        moved : tuple of ndarray, shapes (3,) and (3, 3), or None
            The motion since the keyframe and its covariance, in the robot's frame there [m, m,
            rad]; None at the keyframe itself.
        between_stamps : ndarray, shape (3,)
            The motion now [m, m, rad] in the time by which the stamps of odometry and bearings
            differ. The pose is that of the bearings' stamps, and with equal probability those of
            the odometry are right.
        coasting : bool
            Whether there are no bearings now.
        innovations : tuple of Innovation
            Innovations to go with it.
        """
        if self._best is None or not self.fixed:
            return Estimate(t, Status.MAPPING, Reason.NOT_FIXED.words, None, None, innovations)
        estimate, tails = self._estimate.after(moved, self.errors, self._others.tails)
        status, reason = self._status(estimate, self._best, coasting)
        covariance = estimate.covariance + tails
        if between_stamps.any():
            later = rotation(estimate.pose.heading) @ between_stamps
            covariance = covariance + 0.5 * later[:, None] * later
        covariance = self.errors.covariance_scale * covariance
        terms = float(covariance.trace())
        if moved is not None:
            lever = float(moved[0][:2] @ moved[0][:2])
            terms *= 1.0 + lever  # the error of the heading moves the position by it
        covariance = positive(covariance, "the covariance of a published pose", terms)
        return Estimate(t, status, reason, estimate.pose, covariance, innovations)

    def home_is_found(self, best: HomeFit) -> bool:
        """Return whether home is certain enough to evaluate landmarks by it."""
        reach = self._settings.largest_sigma * best.home_distance
        return _sigma(best.covariance) <= reach and (best.converged or self.fixed)

    def _status(self, estimate: PoseEstimate, best: HomeFit, coasting: bool) -> tuple[Status, str]:
        """Return the status of an estimate, and the reason."""
        surveyed = len(best.problem.surveyed)
        agreeing = int(np.count_nonzero(best.inliers)) + surveyed
        checked = int(np.count_nonzero(self._checked)) + surveyed
        if agreeing < MIN_AGREEING:
            return Status.UNVERIFIED, too_few_agree(agreeing)
        independent = best.problem.bodies.independent(best.inliers) + surveyed
        if independent < MIN_AGREEING:
            words = f"of {agreeing} agreeing home bearings only {independent} are independent"
            return Status.UNVERIFIED, f"{words}: landmarks near each other may have moved together"
        if checked < MIN_AGREEING:
            return Status.UNVERIFIED, f"only {checked} of {agreeing} home bearings are checked"
        stayed = int(np.count_nonzero(best.inliers & self._stayed)) + surveyed
        if stayed < MINIMAL:
            words = f"only {stayed} of {agreeing} agreeing home bearings belong to static landmarks"
            return Status.UNVERIFIED, f"{words}; former positions do not confirm a pose"
        if self._rival_probability > 1.0 - self._settings.sure:
            return Status.UNVERIFIED, f"another home has probability {self._rival_probability:.2f}"
        if coasting:
            return Status.COASTING, Reason.NO_BEARINGS.words
        # One or two sightings of a survey give a pose that is linear only if certain already.
        limit = min(self._max_sigma, self._max_survey_sigma) if surveyed else self._max_sigma
        if max(estimate.covariance[0, 0], estimate.covariance[1, 1]) > limit**2:
            return Status.UNVERIFIED, "the landmarks in view do not determine the pose; drive on"
        if surveyed:
            words = f"{surveyed} known landmarks and {agreeing - surveyed} home bearings agree"
            return Status.LOCALISED, words
        return Status.LOCALISED, f"{agreeing} home bearings agree"

    def _is_fixed(self, best: HomeFit) -> bool:
        """Return whether the pose is certain enough to be published, with hysteresis."""
        # For a wrong home far away the landmarks would be distant; for the robot they are not.
        distance = min(best.home_distance, best.landmark_distance(best.pose))
        reach = self._settings.largest_sigma * distance
        self._max_sigma, self._max_survey_sigma = FIX_HYSTERESIS * reach, CLOSE * distance
        limit = self._max_sigma if self.fixed else reach
        # If home's heading is as uncertain, linearisation in it fails.
        turn = math.sqrt(self._estimate.covariance[2, 2]) * distance
        only_scale = CommonErrors(scale_sigma=self.errors.scale_sigma)
        return max(turn, _sigma(self._estimate.after(None, only_scale)[0].covariance)) <= limit


def _sigma(covariance: np.ndarray) -> float:
    """Return the larger standard deviation of x and y [m]."""
    return math.sqrt(max(covariance[0, 0], covariance[1, 1]))
