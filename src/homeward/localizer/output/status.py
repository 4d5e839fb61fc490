"""Integrity monitor: whether there is a pose to give, its status and the reason."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from homeward.drives.drive import OdometryNoise
from homeward.estimator import CHECKED, Estimate, Innovation, Status
from homeward.frames import Pose
from homeward.localizer.home.estimate import HomeFit
from homeward.localizer.home.hypotheses import Hypotheses
from homeward.localizer.output.pose import (
    OtherHypotheses,
    PoseEstimate,
    combined_estimate,
    landmark_distance,
    other_hypotheses,
    uncheckable_outliers,
)
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import FIX_HYSTERESIS, INLIER_GATE, MIN_BEARINGS, SAME_PLACE
from homeward.reasons import Reason


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
    if len(home) < MIN_BEARINGS:
        return f"home saw only {len(home)} landmarks; {MIN_BEARINGS} are needed"
    if not has_odometry:
        return "no odometry has come yet; without it no landmark can be mapped"
    if not mapped:
        return "no landmark is mapped yet; drive an arc to see them from other places"
    if not used and len(mapped) >= MIN_BEARINGS:
        return f"none of the {len(mapped)} landmarks that are mapped was seen from home"
    needed = f"{MIN_BEARINGS} are needed; drive an arc"
    return f"{len(used)} of the landmarks that home saw are mapped; {needed}"


class IntegrityMonitor:
    """Integrity monitor: the pose of all hypotheses, and how far it can be relied on.

    Parameters
    ----------
    settings : LocalizerSettings
        Of the localiser.
    odometry : OdometryNoise
        Of the drive, as far as known.
    scale_mapped : bool
        Whether the map knows by itself how uncertain its scale is.
    """

    def __init__(
        self, settings: LocalizerSettings, odometry: OdometryNoise, scale_mapped: bool = False
    ) -> None:
        given = odometry.speed_scale_sigma
        self._settings = settings
        self._speed_scale = settings.odometry.speed_scale if given is None else given
        self._scale_mapped = scale_mapped
        self.scale_variance = 0.0
        """Of the map's scale, beside the speed's [1]."""
        self._best: HomeFit | None = None
        """The most probable hypothesis; None where home is not found."""
        self._estimate = PoseEstimate(Pose(0.0, 0.0, 0.0), np.zeros((3, 3)))
        """At the newest keyframe, the speed taken at its word."""
        self._others = OtherHypotheses.nothing()
        self._weights: np.ndarray | None = None
        """Of the hypotheses that `_others` comes from."""
        self._checked = self._stayed = np.zeros(0, bool)
        """The home bearings of the best one that the others check, and of landmarks that stayed."""
        self._rivals = 0.0
        self._most = math.inf
        """How uncertain a pose may be that was given [m] ..."""
        self._close = math.inf
        """... and one by a survey that is relied on [m]."""
        self.fixed = False
        """Whether the pose is certain enough to be given."""
        self.mount_covariance = np.zeros((2, 2))
        """Covariance of x and y of the camera on the robot [m^2]."""

    @property
    def _scale_sigma(self) -> float:
        """Of the map's scale, unless the map itself knows it [1]."""
        return 0.0 if self._scale_mapped else math.sqrt(self._speed_scale**2 + self.scale_variance)

    def update(self, now: Hypotheses | None, firm: bool, stayed: np.ndarray | None = None) -> None:
        """Take the hypotheses of a new keyframe.

        Parameters
        ----------
        now : Hypotheses or None
            None when home was not found.
        firm : bool
            Whether they come from a solved window with the landmarks in sight: only then may a pose
            be withdrawn.
        stayed : ndarray, shape (q,), bool, optional
            Which landmarks stand where they were mapped first; all by default.
        """
        self._best = None if now is None else now.best
        if now is None:
            self.fixed, self._weights = False, None
            return
        self._stayed = np.ones_like(now.best.inliers) if stayed is None else stayed
        if now.weights is not self._weights:  # not only carried on
            self._others, self._weights = other_hypotheses(now), now.weights
            self._checked = now.best.checked
        self._estimate = combined_estimate(now.best, self._others)
        if firm or not self.fixed:
            at_rest = self.fixed or (now.best.converged and now.unconverged_probability < 0.5)
            self.fixed = at_rest and self._is_fixed(now.best)
            self._rivals = now.rivals(INLIER_GATE)
        faults = uncheckable_outliers(now.best, self._checked)
        if faults is not None:
            self._estimate = combined_estimate(now.best, self._others, faults)
            self.fixed &= _sigma(self._estimate.covariance) <= self._most

    def estimate(
        self,
        t: float,
        moved: tuple[np.ndarray, np.ndarray] | None,
        coasting: bool,
        innovations: tuple[Innovation, ...] = (),
    ) -> Estimate:
        """Return the pose, where there is one to give, with what to call it and why.

        Parameters
        ----------
        t : float
            When [s].
        moved : tuple of ndarray, shapes (3,) and (3, 3), or None
            The motion since the keyframe and its covariance, in the robot's frame there [m, m,
            rad]; None at the keyframe itself.
        coasting : bool
            Whether there are no bearings now.
        innovations : tuple of Innovation
            To go with it.
        """
        if self._best is None or not self.fixed:
            return Estimate(t, Status.MAPPING, Reason.NOT_FIXED.words, None, None, innovations)
        estimate = self._now(self._estimate, moved)
        status, reason = self._status(estimate, self._best, coasting)
        if self._others.tails is not None:
            estimate = self._now(self._estimate.with_more(self._others.tails), moved)
        return Estimate(t, status, reason, estimate.pose, estimate.covariance, innovations)

    def _now(
        self, estimate: PoseEstimate, moved: tuple[np.ndarray, np.ndarray] | None
    ) -> PoseEstimate:
        """Return an estimate at the keyframe after a motion since, with what is told of neither."""
        estimate = estimate if moved is None else estimate.propagate(*moved)
        return estimate.with_mount(self.mount_covariance).with_scale(self._scale_sigma)

    def home_is_found(self, best: HomeFit) -> bool:
        """Return whether home is certain enough among its landmarks to judge any of them by it."""
        reach = self._settings.largest_sigma * landmark_distance(best, best.home)
        return _sigma(best.covariance) <= reach and (best.converged or self.fixed)

    def _status(self, estimate: PoseEstimate, best: HomeFit, coasting: bool) -> tuple[Status, str]:
        """Return what to call an answer, and why."""
        surveyed = len(best.problem.surveyed)
        agreeing = int(np.count_nonzero(best.inliers)) + surveyed
        checked = int(np.count_nonzero(self._checked)) + surveyed
        if agreeing < CHECKED:
            return Status.UNVERIFIED, f"only {agreeing} home bearings agree"
        if checked < CHECKED:
            return Status.UNVERIFIED, f"only {checked} of {agreeing} home bearings are checked"
        stayed = int(np.count_nonzero(best.inliers & self._stayed)) + surveyed
        if stayed < MIN_BEARINGS:
            words = f"only {stayed} of {agreeing} home bearings that agree are of landmarks"
            return Status.UNVERIFIED, f"{words} that stayed; former places verify nothing"
        if self._rivals > 1.0 - self._settings.sure:
            return Status.UNVERIFIED, f"another home has probability {self._rivals:.2f}"
        if coasting:
            return Status.COASTING, Reason.NO_BEARINGS.words
        # A look or two at a survey tell a pose that is linear only where it is close already.
        most = min(self._most, self._close) if surveyed else self._most
        if max(estimate.covariance[0, 0], estimate.covariance[1, 1]) > most**2:
            return Status.UNVERIFIED, "what is seen does not tell where; drive on"
        if surveyed:
            words = f"{surveyed} surveyed landmarks and {agreeing - surveyed} home bearings agree"
            return Status.LOCALISED, words
        return Status.LOCALISED, f"{agreeing} home bearings agree"

    def _is_fixed(self, best: HomeFit) -> bool:
        """Return whether the pose is certain enough to be given; it is not withdrawn at once."""
        # A wrong home that lies far away would call its landmarks distant; the robot does not.
        distance = min(landmark_distance(best, best.home), landmark_distance(best, best.pose))
        reach = self._settings.largest_sigma * distance
        self._most, self._close = FIX_HYSTERESIS * reach, SAME_PLACE * distance
        most = self._most if self.fixed else reach
        # Where home may turn by as much, what is linear in its heading no longer holds.
        turn = math.sqrt(self._estimate.covariance[2, 2]) * distance
        return max(turn, _sigma(self._estimate.with_scale(self._scale_sigma).covariance)) <= most


def _sigma(covariance: np.ndarray) -> float:
    """Return the larger standard deviation of x and y [m]."""
    return math.sqrt(max(covariance[0, 0], covariance[1, 1]))
