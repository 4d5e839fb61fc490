"""Process noise of odometry: as the drive gives it, or learnt from what the map leaves of motions.

Bearings cannot tell the scale of a map, odometry does; who believes odometry too little lets errors
of bearings bend the map, and who believes it too much is too sure. What is usual of wheels is off
by ten times either way for good ones on a table, and for bad ones on a carpet.
"""

from __future__ import annotations

import math

import numpy as np

from homeward.drives.drive import OdometryNoise
from homeward.drives.odometry_noise import OdometryDefaults, noise_rates
from homeward.localizer.tunables import (
    GATE_INFLATION,
    MAX_NOISE_RATIO,
    NOISE_MEMORY,
    NOISE_PRIOR_MOTIONS,
)

NOTABLE = 2.0
"""Deviations that differ by so many times are told to the user [1]."""


class ProcessNoise:
    """How fast the variances of the robot's motion grow.

    Parameters
    ----------
    given : OdometryNoise
        What the drive says of it.
    default : OdometryDefaults
        What is believed at first where it says nothing.
    """

    def __init__(self, given: OdometryNoise, default: OdometryDefaults) -> None:
        self._at_first = self.rates = noise_rates(given, default)
        """(3, 3), at first and as believed now."""
        self._learns = np.array([given.speed_sigma is None, given.turn_sigma is None])
        self.scales = np.ones((2, 2))
        """Variances of shift and turn over what was believed at first, of most motions (first row)
        and of all: wheels that slip now and then have a heavy tail [1]."""
        self._squares, self._redundancies = np.zeros((2, 2)), np.zeros((2, 2))
        self._expected = np.ones(2)
        """What they are thought to be before motions were looked at: by what is usual of wheels."""

    @property
    def core(self) -> np.ndarray:
        """(2,): variances of shift and turn of most motions, over those of all [1]."""
        return np.asarray(self.scales[0] / self.scales[1])

    @property
    def uncounted(self) -> float:
        """Variance of shift that the map's own does not count, over what was believed at first [1].

        The map weighs down what does not fit; of slips by which all of it is too large nothing does
        not. So what all motions have more than most is carried, and before they were looked at they
        may be as bad as the gate bears with.
        """
        squares, redundancy = self._squares[1, 0], self._redundancies[1, 0]
        before = NOISE_PRIOR_MOTIONS * self._expected[0] * GATE_INFLATION**2
        of_all = (before + squares) / (NOISE_PRIOR_MOTIONS + redundancy)
        return max(0.0, float(of_all - self.scales[0, 0]))

    @property
    def words(self) -> tuple[str, ...]:
        """What the user should know of it."""
        off = np.sqrt(self.scales[1] / self._expected)
        if (np.abs(np.log(off)) < math.log(NOTABLE)).all():
            return ()
        way, turn = off.tolist()
        return (
            f"By the bearings, odometry errs {way:.2g} times as much as was supposed in its way, "
            f"and {turn:.2g} times in its turns.",
        )

    def update(
        self, squares: np.ndarray, redundancies: np.ndarray, motions: int, keyframes: int
    ) -> np.ndarray:
        """Learn from what the map leaves of motions.

        Parameters
        ----------
        squares, redundancies : ndarray, shape (2, 2)
            Of so many motions; see `Misfit`.
        motions : int
            See above.
        keyframes : int
            How many of them are new.

        Returns
        -------
        ndarray, shape (2, 2)
            By how much variances that are kept are to be widened [1].
        """
        share, kept = keyframes / motions, np.exp(-keyframes / NOISE_MEMORY)
        self._squares = kept * self._squares + share * squares * self.scales[0]
        self._redundancies = kept * self._redundancies + share * np.maximum(redundancies, 0.0)
        return self._believe()

    def expect(self, share: float) -> np.ndarray:
        """Expect so large a share of the usual variance of the way; returns what `update` does."""
        if self._learns[0]:
            self._expected[0] = share
        return self._believe()

    def _believe(self) -> np.ndarray:
        """Believe what was learnt and, as so many motions, what is usual; return the widening."""
        known = NOISE_PRIOR_MOTIONS + self._redundancies
        now = (NOISE_PRIOR_MOTIONS * self._expected + self._squares) / known
        now[1] = np.maximum(now[0], now[1])
        doubted = (now > MAX_NOISE_RATIO**2) | (self.scales > 1.0)
        given = np.where(doubted, np.maximum(now, 1.0), 1.0)
        before, self.scales = self.scales, np.where(self._learns, now, given)
        self.rates = self._at_first * self.scales[1, [0, 0, 1], None]
        return np.asarray(self.scales / before)
