"""A clock that never runs backwards, though the stamps may be set back for good."""

from __future__ import annotations

import math

LATE_S = 1.0
"""A sample may be so late; a stamp that lies farther back is not just late [s]."""
FOR_GOOD, FOR_GOOD_S = 10, 1.0
"""After so many of them in a row, over so long a time, the clock was set back [s]."""


class Clock:
    """Makes of the stamps of a drive a time that goes on when they are set back."""

    def __init__(self) -> None:
        self._offset = 0.0
        self._latest = -math.inf
        self._back: list[float] = []

    def read(self, stamp: float) -> float:
        """Return the time [s] of a sample's stamp [s]; before the latest one when it is late."""
        t = stamp + self._offset
        if not math.isfinite(t):
            return t
        if t < self._latest - LATE_S:
            return self._set_back(stamp, t)
        self._back.clear()
        self._latest = max(self._latest, t)
        return t

    def peek(self, stamp: float) -> float:
        """Return the time [s] of a stamp [s] that is only asked about."""
        return stamp + self._offset

    def _set_back(self, stamp: float, t: float) -> float:
        """Count a stamp that lies far back; go on from it when there are enough of them."""
        if self._back and stamp < self._back[-1]:
            self._back.clear()
        self._back.append(stamp)
        if len(self._back) < FOR_GOOD or stamp - self._back[0] < FOR_GOOD_S:
            return t
        self._offset = self._latest - self._back[0]
        self._back.clear()
        self._latest = stamp + self._offset
        return self._latest
