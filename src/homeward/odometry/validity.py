"""Clock, validity and limits of odometry samples."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection

import numpy as np

MAX_SPEED, MAX_TURN_RATE = 10.0, 20.0
"""Maximum speed [m/s] and yaw rate [rad/s] of the robots that homeward is made for."""
MAX_RATE = 1e4
"""Maximum speed [m/s] or yaw rate [rad/s] of any vehicle; a larger value is a data error."""
MAX_ACCELERATION, MAX_TURN_ACCELERATION = 3.0, 10.0
"""Maximum acceleration [m/s^2, rad/s^2] that robots use; the limit for recordings, where the motion
before and after a sample is known."""
GRIP_ACCELERATION, GRIP_TURN_ACCELERATION = 10.0, 50.0
"""Maximum acceleration that wheels can transmit [m/s^2, rad/s^2]: 1 g for a friction coefficient of
about 1 on a dry floor, with wheels 0.2 m from the centre. The limit for online samples, where only
the motion before is known."""


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
