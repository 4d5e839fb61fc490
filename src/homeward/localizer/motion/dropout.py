"""Odometry dropout: an Ornstein-Uhlenbeck velocity as motion prior (Uhlenbeck and Ornstein, 1930).

Nobody knows where to, but hardly faster than usual. So its velocity is a random one of that size
that is forgotten in `SPEED_LASTS_S` (a process of Ornstein and Uhlenbeck): the shift grows with the
time at first, and with its root later. What it grows by from one time to another depends on these
two alone, not on how often somebody asked in between.
"""

from __future__ import annotations

import math

from homeward.localizer.tunables import LATELY_S, SLOWEST, SLOWEST_TURN, SPEED_LASTS_S, TURN_LASTS_S


class MotionPrior:
    """Motion prior: how fast the robot usually is, and so how far it may go during a dropout."""

    def __init__(self) -> None:
        self._moving, self._path, self._turned = 0.0, 0.0, 0.0

    def count(self, moving: float, path: float, turned: float) -> None:
        """Count time of moving [s], with the path [m] and the turns [rad] made in it."""
        keep = math.exp(-moving / LATELY_S)
        self._moving = keep * self._moving + moving
        self._path = keep * self._path + path
        self._turned = keep * self._turned + turned

    def variance_growth(self, silent: float, time: float) -> tuple[float, float]:
        """Return by what variances shift [m^2] and turn [rad^2] grow while odometry is silent.

        Parameters
        ----------
        silent, time : float
            How long it was silent before, and for how much longer [s].
        """
        moving = max(self._moving, 1e-9)
        speed, turn = max(SLOWEST, self._path / moving), max(SLOWEST_TURN, self._turned / moving)
        shift, swing = _growth(silent, time, SPEED_LASTS_S), _growth(silent, time, TURN_LASTS_S)
        return speed**2 * shift, turn**2 * swing


def _growth(after: float, time: float, lasts: float) -> float:
    """Return how the variance of the integral of a velocity of variance one grows [s^2]."""
    return 2.0 * lasts * (time + lasts * math.exp(-after / lasts) * math.expm1(-time / lasts))
