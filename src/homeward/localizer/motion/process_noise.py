"""Process noise of odometry: as given, or learnt from the residuals of motions.

Odometry alone determines the scale of a map. If its noise is overestimated, bearing errors distort
the map; if underestimated, the map is overconfident. The usual noise of wheels is ten times too
large for good ones on a table, and ten times too small for bad ones on a carpet.
"""

from __future__ import annotations

import math

import numpy as np

from homeward.drives.settings import OdometryDefaults, OdometryNoise, noise_rates
from homeward.localizer.tunables import (
    INFLATION,
    MAX_NOISE_RATIO,
    NOISE_MEMORY,
    NOISE_PRIOR,
    NOTABLE_RATIO,
)


class ProcessNoise:
    """Process noise: the rates at which the variances of the robot's motion grow.

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
