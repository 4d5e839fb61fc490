"""History of twists, with late ones inserted, and dead reckoning of heading and path."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from homeward.estimator import TwistHold

STEADY_S = 0.5
"""Averaging time of the speed: longer than the noise of samples, shorter than changes of speed [s].
"""

MOVING_SPEED, MOVING_TURN_RATE = 0.05, 0.1
"""Mean speed [m/s] and turn rate [rad/s] over `STEADY_S` from which odometry indicates a motion:
several standard deviations of jitter and bias at standstill, and a slower robot moves less in a
second than a pose is uncertain."""
MEAN_S = 0.07
"""Averaging time of the twist that the derivative by the lag uses: noise of single samples would
count as information on the lag, and a longer mean trails behind where the robot accelerates [s]."""


class Twist(NamedTuple):
    """A twist, valid from its stamp to the next, and the dead reckoning there.

    A twist of unknown motion has the speeds zero, and `until` not after `t`.
    """

    t: float
    """[s]"""
    v: float
    """[m/s]"""
    omega: float
    """[rad/s]"""
    until: float
    """Time up to which the motion is known: by this twist, or, where that is before `t`, by an
    earlier one [s]."""
    heading: float
    """Heading by odometry alone [rad]."""
    path: float
    """Signed path by odometry alone, backward negative [m]."""
    steady: float
    """Mean speed just before, free of sample noise [m/s]."""


_stamp = attrgetter("t")


class Twists:
    """The single history of twists, shared by all that need any of it."""

    def __init__(self) -> None:
        self._twists: deque[Twist] = deque()
        self._hold = TwistHold()

    def __bool__(self) -> bool:
        """Whether there was a twist at all."""
        return bool(self._twists)

    @property
    def newest(self) -> float:
        """Stamp of the newest twist [s]; minus infinity if there was none."""
        return self._twists[-1].t if self._twists else -math.inf

    def add(self, t: float, v: float, omega: float) -> None:
        """Insert a twist, which may be late; one with the stamp of another replaces it.

        NaN for `v` or `omega`: the motion is unknown until the next twist.
        """
        hold = self._hold.add(t)
        if math.isnan(v) or math.isnan(omega):
            v = omega = hold = 0.0
        later = []
        while self._twists and self._twists[-1].t > t:
            later.append(self._twists.pop())
        if self._twists and t == self._twists[-1].t:
            self._twists.pop()
        self._append(t, v, omega, hold)
        for twist in reversed(later):
            self._append(*twist[:3], twist.until - twist.t)

    def _append(self, t: float, v: float, omega: float, hold: float) -> None:
        """Append a twist that holds for a time [s]; none: the motion is unknown."""
        known = self._twists[-1].until if self._twists else -math.inf
        until = t + hold if hold > 0.0 else min(known, t)
        self._twists.append(Twist(t, v, omega, until, *self.reckoned(t), self.steady_speed(t)))

    def before(self, t: float) -> Twist | None:
        """Return the twist that holds at `t` [s], or did last; None before the first."""
        after = bisect_right(self._twists, t, key=_stamp)
        return self._twists[after - 1] if after else None

    def unknown_time(self, t: float) -> float:
        """Return for how long the motion has been unknown at `t` [s]; infinite without twists."""
        twist = self.before(t)
        return math.inf if twist is None else max(t - twist.until, 0.0)

    def heading(self, t: float) -> float:
        """Return the heading at `t` [s], by odometry alone [rad]."""
        return self.reckoned(t)[0]

    def path(self, t: float) -> float:
        """Return the signed path up to `t` [s], by odometry alone [m]."""
        return self.reckoned(t)[1]

    def moves(self, t: float) -> bool:
        """Return whether odometry indicates a motion at `t` [s], beyond jitter at standstill.

        A twist that has held for long without a successor is no evidence.
        """
        if t - self.newest > 0.5 * STEADY_S:
            return False
        (heading, path), (before, start) = self.reckoned(t), self.reckoned(t - STEADY_S)
        fast = abs(path - start) / STEADY_S > MOVING_SPEED
        return fast or abs(heading - before) > MOVING_TURN_RATE * STEADY_S

    def mean(self, t: float) -> tuple[float, float]:
        """Return the mean speed [m/s] and turn rate [rad/s] in the last `MEAN_S` before `t` [s].

        Only time after the first twist counts. Before that, the first twist is the mean.
        """
        if not self._twists:
            return 0.0, 0.0
        first = self._twists[0]
        since = max(t - MEAN_S, first.t)
        if t <= since:
            return first.v, first.omega
        (heading, path), (before, start) = self.reckoned(t), self.reckoned(since)
        return (path - start) / (t - since), (heading - before) / (t - since)

    def steady_speed(self, t: float) -> float:
        """Return the mean speed just before `t` [s], free of sample noise [m/s]."""
        return (self.reckoned(t)[1] - self.reckoned(t - STEADY_S)[1]) / STEADY_S

    def reckoned(self, t: float) -> tuple[float, float]:
        """Return heading [rad] and signed path [m] at `t` [s] from odometry alone."""
        twist = self.before(t)
        if twist is None:
            twist = self._twists[0] if self._twists else None
            return (twist.heading, twist.path) if twist else (0.0, 0.0)
        dt = max(min(t, twist.until) - twist.t, 0.0)
        return twist.heading + twist.omega * dt, twist.path + twist.v * dt

    def reckoned_at(self, times: list[float]) -> np.ndarray | None:
        """Return `reckoned` at k times [s], newest first, (2, k); None before the first twist."""
        if self.before(times[0]) is None:
            return None
        return np.array([self.reckoned(t) for t in times]).T

    def between(self, begin: float, end: float) -> list[Twist]:
        """Return the twists that hold from `begin` until `end` [s], at least in part."""
        first = len(self._twists)
        while first > 0 and self._twists[first - 1].t >= begin:
            first -= 1
        held = (self._twists[i] for i in range(max(first - 1, 0), len(self._twists)))
        return [twist for twist in held if twist.t < end]

    def forget(self, t: float) -> None:
        """Drop the twists that ended before `t` [s]."""
        while len(self._twists) > 1 and self._twists[1].t < t:
            self._twists.popleft()


class DeadReckoning:
    """Pose by odometry alone, advanced from frame to frame."""

    def __init__(self) -> None:
        self.x = self.y = 0.0
        self.heading = self._path = math.nan

    def advance(self, t: float, twists: Twists) -> tuple[float, float, float]:
        """Advance to `t` [s]; return x, y [m] and heading [rad], which is not wrapped."""
        heading, path = twists.reckoned(t)
        if not math.isnan(self._path):
            step, middle = path - self._path, 0.5 * (heading + self.heading)
            self.x += step * math.cos(middle)
            self.y += step * math.sin(middle)
        self.heading, self._path = heading, path
        return self.x, self.y, heading
