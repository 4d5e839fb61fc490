"""The robot's way by odometry alone."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque

from homeward.angles import wrap
from homeward.estimator import TwistHold
from homeward.frames import Pose, Twist, advance
from homeward.live.messages import OdometryIn

PATH_S = 3.0
"""Odometry is remembered so long, for bearings that come late [s]."""


class Way:
    """Dead reckoning from twist to twist, or the poses that the robot tells, lately."""

    def __init__(self) -> None:
        self._t: deque[float] = deque()
        self._samples: deque[tuple[Pose, float, float]] = deque()
        self._hold = TwistHold()

    @property
    def newest(self) -> float:
        """Newest stamp [s]; minus infinity before the first."""
        return self._t[-1] if self._t else -math.inf

    def add(self, sample: OdometryIn) -> None:
        """Go on; late samples are left out, and a clock that is set back goes on where it was."""
        before = self.at(self.newest)
        if sample.t < self.newest - PATH_S:
            self._t.clear()
            self._samples.clear()
        if sample.t < self.newest:
            return
        there = self.at(sample.t) if self._t else before
        there = there if sample.pose is None else Pose(*sample.pose)
        self._t.append(sample.t)
        self._hold.add(sample.t)
        self._samples.append((there, sample.v, sample.omega))
        while len(self._t) > 2 and self._t[1] < sample.t - PATH_S:
            self._t.popleft()
            self._samples.popleft()

    def at(self, t: float) -> Pose:
        """Return the pose at `t` [s] in the odometry frame, by the twist that held then."""
        if not self._t:
            return Pose(0.0, 0.0, 0.0)
        row = max(bisect_right(self._t, t) - 1, 0)
        pose, v, omega = self._samples[row]
        dt = min(max(t - self._t[row], 0.0), self._hold.seconds)
        there = advance(pose, Twist(v, omega), dt)
        return there._replace(heading=wrap(there.heading))
