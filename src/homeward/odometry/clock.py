"""A clock that never runs backwards, even where stamps are set back permanently."""

from __future__ import annotations

import math

MAX_DELAY_S = 1.0
"""Maximum delay of a late sample [s]; a larger one indicates that the clock was set back."""
NUM_SET_BACK, SET_BACK_S = 10, 1.0
"""The clock was set back after this number of such stamps in a row, over this time [s]."""


class Clock:
    """Converts stamps to the time of a drive, which continues where stamps are set back."""

    def __init__(self) -> None:
        self._offset = 0.0
        self._latest = -math.inf
        self._back: list[float] = []

    def read(self, stamp: float) -> float:
        """Return the time [s] of a sample's stamp [s]; of a late one, before the latest time."""
        t = stamp + self._offset
        if not math.isfinite(t):
            return t
        if t < self._latest - MAX_DELAY_S:
            return self._set_back(stamp, t)
        self._back.clear()
        self._latest = max(self._latest, t)
        return t

    def peek(self, stamp: float) -> float:
        """Return the time [s] of a stamp [s] without counting it as a sample."""
        return stamp + self._offset

    def _set_back(self, stamp: float, t: float) -> float:
        """Count a stamp that is too far back; after enough of them, continue from there."""
        if self._back and stamp < self._back[-1]:
            self._back.clear()
        self._back.append(stamp)
        if len(self._back) < NUM_SET_BACK or stamp - self._back[0] < SET_BACK_S:
            return t
        self._offset = self._latest - self._back[0]
        self._back.clear()
        self._latest = stamp + self._offset
        return self._latest
