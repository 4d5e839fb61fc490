"""Odometry since the newest keyframe, preintegrated: its noise, and a motion prior for dropouts."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections import deque
from typing import NamedTuple

import numpy as np

from homeward.drives.settings import DriveSettings, OdometryDefaults, OdometryNoise, noise_rates
from homeward.geometry.statistics import ROUNDING
from homeward.localizer.kernels import preintegrate
from homeward.localizer.motions import DELAY, TIME_CONSTANT, Motion
from homeward.localizer.reference.motion import variance_growth
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import (
    BEND,
    FIXED_TIME_CONSTANT_S,
    INFLATION,
    INITIAL_STRAIGHT_M,
    LAG_GATE,
    MAX_NOISE_RATIO,
    MEAN_S,
    MEMORY_OF_LAG_S,
    MEMORY_S,
    MIN_SPEED,
    MIN_TURN_RATE,
    NOISE_MEMORY,
    NOISE_PRIOR,
    NOTABLE_LAG_S,
    NOTABLE_RATIO,
    NUM_BENDS,
    STRAIGHTEST_SHARE,
)
from homeward.odometry.history import TwistHistory
from homeward.odometry.validity import MAX_DELAY_S


def calibration_sigmas(
    drive: DriveSettings, settings: LocalizerSettings, speed_scale: float
) -> np.ndarray:
    """Return the prior standard deviations of the odometry's calibration, shape (7,).

    That of the speed's scale is `speed_scale`; it is zero unless something observes the scale, such
    as a survey: bearings do not.
    """
    given, default = drive.odometry, settings.odometry
    scale, bias, sideways = (
        given.turn_scale_sigma,
        given.turn_bias_sigma,
        given.sideways_scale_sigma,
    )
    return np.array(
        [
            default.turn_scale if scale is None else scale,
            default.turn_bias if bias is None else bias,
            given.slip_sigma(default.turn_slip),
            settings.delay_sigma if given.delay_sigma is None else given.delay_sigma,
            settings.time_constant_sigma,
            speed_scale,
            default.sideways_scale if sideways is None else sideways,
        ]
    )


def shows_lag(calibration: np.ndarray, variances: np.ndarray) -> bool:
    """Return whether a map shows that the robot follows its odometry as a first-order lag.

    The time constant is fixed at zero until then. The information of that prior is known, and so
    what the map alone would estimate follows from its posterior, mean and variances (10,) with the
    prior of `FIXED_TIME_CONSTANT_S`. A filter also takes noise from the motions between keyframes,
    so the noise of measured twists looks like a time constant: of up to half the averaging time of
    a twist, or more if a negative delay makes up for it. So the lower bound of the estimate must
    exceed the first, and not the delay found without a time constant.
    """
    precision = 1.0 / float(variances[TIME_CONSTANT])
    own = precision - 1.0 / FIXED_TIME_CONSTANT_S**2
    if own <= ROUNDING * precision:
        return False
    estimate = float(calibration[TIME_CONSTANT]) * precision / own
    lower = estimate - LAG_GATE / math.sqrt(own)
    return 0.5 * MEAN_S < lower <= float(calibration[DELAY])


def lag_notes(calibration: np.ndarray) -> tuple[str, ...]:
    """Return notes for the user on the lag in a calibration (10,), if it is notable.

    A robot with a time constant moves that much later than its command, in the mean.
    """
    lag = float(calibration[DELAY] + calibration[TIME_CONSTANT])
    if abs(lag) < NOTABLE_LAG_S:
        return ()
    way, other = ("after", "before") if lag > 0 else ("before", "after")
    return (
        f"Odometry acts {abs(lag):.2f} s {way} its stamps, compared with the bearings. If it is "
        f"the bearings that are stamped wrong, each pose is that of {abs(lag):.2f} s {other} its "
        f"stamp: set `bearings_late: {lag:.2f}` in drive.yaml; else synchronise the clocks.",
    )


class MotionPrior:
    """Motion prior for odometry dropouts: an Ornstein-Uhlenbeck velocity (1930) of the usual size.

    The velocity is unknown, but hardly larger than usual, and forgotten with time constant
    `SPEED_TIME_S`. So the shift first grows with time, later with its square root. The process is
    evaluated in closed form: the growth between two times does not depend on intermediate calls.
    """

    def __init__(self) -> None:
        self._moving, self._path, self._turned = 0.0, 0.0, 0.0

    def count(self, moving: float, path: float, turned: float) -> None:
        """Add time spent moving [s], with the path [m] and the turns [rad] made in it."""
        keep = math.exp(-moving / MEMORY_S)
        self._moving = keep * self._moving + moving
        self._path = keep * self._path + path
        self._turned = keep * self._turned + turned

    @property
    def usual(self) -> tuple[float, float]:
        """Usual speed [m/s] and turn rate [rad/s]."""
        moving = max(self._moving, 1e-9)
        wide = 1.0 if self._moving else INFLATION  # where odometry never moved, nothing is usual
        speed = wide * max(MIN_SPEED, self._path / moving)
        return speed, wide * max(MIN_TURN_RATE, self._turned / moving)


class _Checkpoint(NamedTuple):
    """State of the integration, to which a late twist rewinds."""

    t: float
    motion: Motion
    path_by_bend: np.ndarray
    motion_prior: MotionPrior


class OdometryIntegrator:
    """Preintegrates the twists since the newest keyframe; their history is shared with others."""

    def __init__(self, twists: TwistHistory, noise: ProcessNoise) -> None:
        self._twists, self._noise = twists, noise
        self._motion = Motion.identity()
        self.end = self._since = -math.inf
        """Time up to which the twists are integrated, and of the keyframe [s]."""
        self._path_by_bend = np.zeros(NUM_BENDS)
        self._path_by_bend[0] = INITIAL_STRAIGHT_M
        self._straightest = 0.0
        self._motion_prior = MotionPrior()
        self._saved: deque[_Checkpoint] = deque()

    def rewind(self, t: float) -> None:
        """Rewind to before `t` [s], where a late twist came."""
        while self._saved and t < self.end:
            self.end, self._motion, self._path_by_bend, self._motion_prior = self._saved.pop()

    def restart(self, t: float) -> None:
        """Restart the motion at `t` [s], a new keyframe."""
        self._motion, self.end, self._since = Motion.identity(), t, t
        self._saved.clear()
        share = self._path_by_bend.cumsum() / self._path_by_bend.sum()
        straight = int((share >= STRAIGHTEST_SHARE).argmax())
        self._straightest = BEND * (straight + 0.5) if straight else 0.0

    def motion(self, t: float, calibration: np.ndarray) -> Motion:
        """Return the motion since the newest keyframe up to `t` [s]; nothing changes.

        A time before `end` counts as `end`. It is linearised at the calibration (10,).
        """
        if t <= self.end:
            return self._motion
        return self._motion.compose(self.between(self.end, t, calibration))

    def advance(self, t: float, calibration: np.ndarray) -> Motion:
        """Integrate the motion up to `t` [s] for good and return it; earlier twists are refused."""
        self.rewind(t)
        self._saved.clear()
        self._integrate(t, calibration)
        return self._motion

    def run_ahead(self, t: float, calibration: np.ndarray) -> None:
        """Integrate up to `t` [s], so that twists up to `MAX_DELAY_S` late can be inserted."""
        done = self._path_by_bend.copy(), copy.copy(self._motion_prior)
        self._saved.append(_Checkpoint(self.end, self._motion, *done))
        while len(self._saved) > 1 and self._saved[1].t <= t - MAX_DELAY_S:
            self._saved.popleft()
        self._integrate(t, calibration)

    def dropout_motion(self, t: float) -> Motion:
        """Return the motion up to `t` [s] as if odometry had dropped out since the keyframe."""
        shift, swing = variance_growth(0.0, t - self._since, self._motion_prior.usual)
        covariance = np.diag([shift, shift, swing])
        return dataclasses.replace(Motion.identity(), covariance=covariance)

    def accepts(self, t: float) -> bool:
        """Return whether a sample of `t` [s] is not too late: no later motion was used."""
        return t >= (self._saved[0].t if self._saved else self.end) or not self._twists

    @property
    def needed_since(self) -> float:
        """Oldest stamp of the twists that are still needed [s]."""
        return (self._saved[0].t if self._saved else self.end) - MEMORY_OF_LAG_S

    def _integrate(self, t: float, calibration: np.ndarray) -> None:
        """Extend the integration to `t` [s]."""
        if t <= self.end:
            return
        motion, path, moving = self._integrated(self.end, t, calibration)
        self._motion, self.end = self._motion.compose(motion), t
        self._path_by_bend += path  # for r
        self._motion_prior.count(moving, motion.path, motion.turned)

    def between(self, begin: float, end: float, calibration: np.ndarray) -> Motion:
        """Return the motion between two times [s] of which the twists are remembered."""
        return self._integrated(begin, end, calibration)[0]

    def _integrated(
        self, begin: float, end: float, calibration: np.ndarray
    ) -> tuple[Motion, np.ndarray, float]:
        """Return the motion between two times [s], its length by bend, and the time in motion."""
        prior, rates = self._motion_prior.usual, self._noise.rates
        table = self._twists.table
        return preintegrate(table, begin, end, calibration, rates, prior, self._straightest)


class ProcessNoise:
    """Process noise: the rates at which the variances of the robot's motion grow.

    Odometry alone determines the scale of a map. If its noise is overestimated, bearing errors
    distort the map; if underestimated, the map is overconfident. The usual noise of wheels is ten
    times too large for good ones on a table, and ten times too small for bad ones on a carpet.

    The estimate begins at `default` where the drive gives none.
    """

    def __init__(self, given: OdometryNoise, default: OdometryDefaults) -> None:
        self._initial_rates = self.rates = noise_rates(given, default)
        """(3, 3): initial and present rates."""
        self._learns = np.array([given.speed_sigma is None, given.turn_sigma is None])
        self.scales = np.ones((2, 2))
        """Estimated over initial variances of shift and turn, of inlier motions (first row) and of
        all: occasional wheel slip makes a heavy tail [1]."""
        self._squares, self._redundancies = np.zeros((2, 2)), np.zeros((2, 2))
        self._prior_scales = np.ones(2)
        """Prior of the scales, before any residuals."""

    @property
    def inlier_ratios(self) -> np.ndarray:
        """(2,): variances of shift and turn of inlier motions, over those of all [1]."""
        return np.asarray(self.scales[0] / self.scales[1])

    @property
    def common_slip_variance(self) -> float:
        """Variance of slips common to the whole map, over the initial variance of shift [1].

        Robust weights suppress single slips; a slip common to all motions only makes the map too
        large, and leaves no residual. So the variance of all motions beyond that of inliers is
        carried as uncertainty of the scale. Before there are residuals it may be as large as the
        gate allows.
        """
        squares, redundancy = self._squares[1, 0], self._redundancies[1, 0]
        before = NOISE_PRIOR * self._prior_scales[0] * INFLATION**2
        of_all = (before + squares) / (NOISE_PRIOR + redundancy)
        return max(0.0, float(of_all - self.scales[0, 0]))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
        off = np.sqrt(self.scales[1] / self._prior_scales)
        if (np.abs(np.log(off)) < math.log(NOTABLE_RATIO)).all():
            return ()
        way, turn = off.tolist()
        return (
            f"Estimated odometry noise: {way:.2g} x the assumed value in translation, {turn:.2g} x "
            "in rotation. `homeward tune` writes it to robot.yaml.",
        )

    def update(
        self, squares: np.ndarray, redundancies: np.ndarray, motions: int, keyframes: int
    ) -> np.ndarray:
        """Update the scales by the residuals of motions.

        `squares` and `redundancies` (2, 2) are sums over the motions (`Misfit`); `keyframes` of
        these are new. Return the factors (2, 2) by which the stored variances must be inflated.
        """
        share, kept = keyframes / motions, np.exp(-keyframes / NOISE_MEMORY)
        self._squares = kept * self._squares + share * squares * self.scales[0]
        self._redundancies = kept * self._redundancies + share * np.maximum(redundancies, 0.0)
        return self._update_scales()

    def scale_prior(self, share: float) -> np.ndarray:
        """Scale the prior variance of the path; the return value is that of `update`."""
        if self._learns[0]:
            self._prior_scales[0] = share
        return self._update_scales()

    def _update_scales(self) -> np.ndarray:
        """Combine the residuals with the prior, counted as motions; return the inflation."""
        known = NOISE_PRIOR + self._redundancies
        now = (NOISE_PRIOR * self._prior_scales + self._squares) / known
        now[1] = np.maximum(now[0], now[1])
        doubted = (now > MAX_NOISE_RATIO**2) | (self.scales > 1.0)
        given = np.where(doubted, np.maximum(now, 1.0), 1.0)
        before, self.scales = self.scales, np.where(self._learns, now, given)
        self.rates = self._initial_rates * self.scales[1, [0, 0, 1], None]
        return np.asarray(self.scales / before)
