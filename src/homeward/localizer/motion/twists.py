"""History of twists, late ones in their place, and the heading that they alone tell."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from operator import attrgetter
from typing import NamedTuple

from homeward.estimator import HOLD_S

STEADY_S = 0.5
"""A robot's speed lasts so long, the noise of its samples does not [s]."""


class Twist(NamedTuple):
    """A twist, which holds from its stamp on, and the heading there."""

    t: float
    """[s]"""
    v: float
    """[m/s]"""
    omega: float
    """[rad/s]"""
    heading: float
    """As odometry alone has it [rad]."""
    path: float
    """The same, driven forward less backward [m]."""
    steady: float
    """Its speed before, without the noise of samples [m/s]."""


_stamp = attrgetter("t")


class Twists:
    """The one history of twists, which all ask that need any of it."""

    def __init__(self) -> None:
        self._twists: deque[Twist] = deque()

    def __bool__(self) -> bool:
        """Whether there was a twist at all."""
        return bool(self._twists)

    @property
    def newest(self) -> float:
        """Stamp of the newest twist [s]; minus infinity where there was none."""
        return self._twists[-1].t if self._twists else -math.inf

    def add(self, t: float, v: float, omega: float) -> None:
        """Take a twist, which may be late; one of the same stamp as another replaces it."""
        later = []
        while self._twists and self._twists[-1].t > t:
            later.append(self._twists.pop())
        if self._twists and t == self._twists[-1].t:
            self._twists.pop()
        for now in ((t, v, omega), *(twist[:3] for twist in reversed(later))):
            self._twists.append(Twist(*now, *self._done(now[0]), self.steady_speed(now[0])))

    def before(self, t: float) -> Twist | None:
        """Return the twist that holds at `t` [s], or did last; None before the first."""
        after = bisect_right(self._twists, t, key=_stamp)
        return self._twists[after - 1] if after else None

    def heading(self, t: float) -> float:
        """Return the heading at `t` [s], by the twists alone [rad]."""
        return self._done(t)[0]

    def steady_speed(self, t: float) -> float:
        """Return the speed before `t` [s], without the noise of samples [m/s]."""
        return (self._done(t)[1] - self._done(t - STEADY_S)[1]) / STEADY_S

    def _done(self, t: float) -> tuple[float, float]:
        """Return heading [rad] and path [m] at `t` [s], by the twists alone."""
        twist = self.before(t)
        if twist is None:
            twist = self._twists[0] if self._twists else None
            return (twist.heading, twist.path) if twist else (0.0, 0.0)
        dt = min(t - twist.t, HOLD_S)
        return twist.heading + twist.omega * dt, twist.path + twist.v * dt

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
