"""Validity of twists: from their stamp to the next one, for a limited time."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection

import numpy as np

TWIST_VALIDITY_S, MAX_TWIST_VALIDITY_S = 1.0, 5.0
"""Time for which a twist is valid without a successor, and its limit for slow odometry [s]: in more
than 5 s a robot in a room starts, turns and stops."""
VALIDITY_SHARE = 1.5
"""Validity of a twist of slow odometry, in typical intervals; a longer gap is a dropout [1]."""
NUM_INTERVALS = 5
"""Number of latest intervals in the typical one: two dropouts do not change their median."""


def twist_validity(intervals: Collection[float]) -> float:
    """Return the time for which a twist is valid without a successor [s], from `intervals` [s].

    That is `TWIST_VALIDITY_S`, or longer where odometry is slow, to bridge its usual interval.
    Fewer than `NUM_INTERVALS` intervals do not count.
    """
    if len(intervals) < NUM_INTERVALS:
        return TWIST_VALIDITY_S
    typical = sorted(intervals)[len(intervals) // 2]
    return min(max(TWIST_VALIDITY_S, VALIDITY_SHARE * typical), MAX_TWIST_VALIDITY_S)


def validities(t: np.ndarray) -> np.ndarray:
    """Return the times for which recorded twists with stamps `t` [s] are valid, (n,) [s]."""
    intervals = np.diff(t)
    valid = twist_validity(intervals.tolist())
    return np.asarray(np.minimum(np.append(intervals, valid), valid))


class TwistValidity:
    """Time for which twists are valid, from the latest intervals between them."""

    def __init__(self) -> None:
        self._newest = -math.inf
        self._intervals: deque[float] = deque(maxlen=NUM_INTERVALS)
        self.seconds = TWIST_VALIDITY_S
        """Validity of the newest twist [s]."""

    def add(self, t: float) -> float:
        """Add the stamp of a twist [s], which may be late; return `seconds`."""
        if t > self._newest > -math.inf:
            self._intervals.append(t - self._newest)
            self.seconds = twist_validity(self._intervals)
        self._newest = max(self._newest, t)
        return self.seconds
