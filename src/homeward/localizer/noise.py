"""The noise of bearings: as given, or else followed by what the map leaves of them."""

from __future__ import annotations

import numpy as np

from homeward.localizer.window import Window

LEAST = 1.0
"""It is not believed to be less than this share of its default [1]."""
RESIDUALS = 40
"""So many residuals are needed to judge it."""
MAD_TO_SIGMA = 1.4826
KEPT = 0.9
"""So much of what was believed is kept from keyframe to keyframe [1]."""


class BearingNoise:
    """The standard deviation of a bearing that comes without one.

    Parameters
    ----------
    given : float or None
        What the drive says [rad]; it is taken at its word.
    default : float
        What is believed at first if it says nothing [rad].
    """

    def __init__(self, given: float | None, default: float) -> None:
        self._given, self._default = given, default
        self.sigma = given or default
        """As believed now [rad]."""

    def follow(self, window: Window, keyframes: int) -> None:
        """Follow the residuals of a window after so many keyframes, unless it was given."""
        if self._given is not None or len(window.sightings) < RESIDUALS:
            return
        now = MAD_TO_SIGMA * float(np.median(np.abs(window.residuals())))
        self.sigma += (1.0 - KEPT**keyframes) * (max(now, LEAST * self._default) - self.sigma)
