"""What pictures that were not recognised say together of the way home.

Of each of them something was guessed, mostly from three or four matches, which may be chance. But
chance guesses something else each time: where several pictures, taken from different places, guess
the same heading and the same direction, and what they matched stands all round, it is a hint that
the robot may drive by, until home is recognised. It is no more than that: a thing that was moved,
or one that is there twice, gives the same hint again and again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from homeward.angles import wrap
from homeward.estimator import HOLD_S
from homeward.vision.acceptance import lacking
from homeward.vision.approach import Direction
from homeward.vision.compare import Comparison

FEWEST_MATCHES = 3
"""A guess must stand on so many."""
FEWEST_ALIKE = 5
"""So many guesses must be alike, ..."""
ALIKE = (0.2, 0.1)
"""... which they are when direction and heading differ by less than this [rad]."""
ANOTHER_PLACE_M = 0.04
"""From nearer to the last one than this [m] a picture would guess the same again."""
REMEMBER_S, HOLD_HINT_S = 120.0, 15.0
"""Older guesses count no more, for odometry may have turned too far since; and a hint is no more
where no picture has guessed the same for so long [s]."""
LEAST_SIGMA = 0.05
"""Guesses that are alike may be alike wrong by this [rad]."""


@dataclass(frozen=True)
class Hint:
    """What several pictures guess alike."""

    t: float
    """When one last did [s]."""
    told: Direction
    """What they guess, on the whole."""
    guesses: int
    """That are alike."""


class Hints:
    """Remembers what was guessed, and how far the robot has turned since."""

    def __init__(self) -> None:
        self._last: tuple[float, float, float] | None = None
        """The last twist: t [s], v [m/s], omega [rad/s]."""
        self._gone = np.zeros(2)
        """Way and turn by odometry, when that twist came [m, rad]."""
        self._guessed_at = -math.inf
        """Way at the last guess [m]."""
        self._guesses: list[tuple[float, float, float]] = []
        """(t, direction, heading less that of odometry) [s, rad, rad]."""
        self._matched: list[np.ndarray] = []
        """Azimuth and elevation at home of what each stands on, (k, 2) [rad]."""
        self._hint: Hint | None = None

    def odometry(self, t: float, v: float, omega: float) -> None:
        """Take a twist that holds from `t` [s] on: `v` [m/s] forward, `omega` [rad/s]."""
        self._gone, self._last = self._gone_at(t), (t, v, omega)

    def guessed(self, t: float, seen: Comparison) -> None:
        """Take what was guessed of a picture of stamp `t` [s] that does not tell the way itself."""
        motion, agrees = seen.motion, seen.agrees
        way, turned = self._gone_at(t).tolist()
        too_near = way < self._guessed_at + ANOTHER_PLACE_M
        if motion is None or too_near or agrees.sum() < FEWEST_MATCHES:
            return
        self._guessed_at = way
        self._guesses.append((t, motion.theta, motion.alpha - turned))
        self._matched.append(seen.pairs.home[agrees])
        while self._guesses[0][0] < t - REMEMBER_S:
            del self._guesses[0], self._matched[0]
        self._hint = self._agreed()

    def forget(self) -> None:
        """Forget it all: now it is known."""
        self._guesses, self._matched, self._hint = [], [], None

    def told(self, t: float) -> Hint | None:
        """Return the hint there is at `t` [s], its heading turned on by odometry."""
        if self._hint is None or t - self._hint.t > HOLD_HINT_S:
            return None
        told = self._hint.told
        alpha = float(wrap(told.alpha + self._gone_at(t)[1]))
        return replace(self._hint, told=replace(told, alpha=alpha))

    def _gone_at(self, t: float) -> np.ndarray:
        """Return way and turn by odometry up to `t` [s], (2,) [m, rad]."""
        if self._last is None:
            return self._gone
        since, v, omega = self._last
        return self._gone + np.array([abs(v), omega]) * min(max(t - since, 0.0), HOLD_S)

    def _agreed(self) -> Hint | None:
        """Return what most guesses agree on; None where these are too few, or all in one place."""
        t, *guessed = np.array(self._guesses).T
        guesses = np.column_stack(guessed)
        apart = wrap(guesses[:, None] - guesses)
        alike = (np.abs(apart) < ALIKE).all(axis=2)
        most = int(np.argmax(alike.sum(axis=1)))
        rows = np.flatnonzero(alike[most])
        azimuth, elevation = np.vstack([self._matched[i] for i in rows]).T
        if rows.size < FEWEST_ALIKE or lacking(azimuth, elevation=elevation):
            return None
        off = wrap(guesses[rows] - guesses[most])
        theta, alpha = wrap(guesses[most] + off.mean(axis=0)).tolist()
        covariance = np.cov(off.T) + np.diag(LEAST_SIGMA**2 * np.ones(2))
        return Hint(float(t[rows[-1]]), Direction(theta, alpha, covariance), rows.size)
