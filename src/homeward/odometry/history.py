"""History of twists, with late ones inserted, and dead reckoning at any time in it."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, advance
from homeward.odometry.validity import TwistValidity

STEADY_S = 0.5
"""Averaging time of the speed: long enough against noise, shorter than changes of speed [s]."""
MOVING_SPEED, MOVING_TURN_RATE = 0.05, 0.1
"""Minimum mean speed [m/s] and yaw rate [rad/s] over `STEADY_S` of a moving robot: several times
the jitter and bias at standstill; in a second, a slower robot moves less than the uncertainty of a
pose."""
MEAN_S = 0.07
"""Averaging time of a twist [s]: longer than a sample, so that their noise is averaged, and shorter
than the robot takes to accelerate."""
LAG_TIMES = -np.log1p(-np.arange(11) / 10.5)
"""Times before the present, in time constants, between which a first-order lag weighs the command
equally."""
_SLOPES = -np.diff((1.0 + LAG_TIMES) * np.exp(-LAG_TIMES))
WEIGHTS = np.stack([np.full(_SLOPES.size, 1.0 / _SLOPES.size), _SLOPES / _SLOPES.sum()])
"""(2, 10): weights of those intervals in the twist, and in the derivative by T of T times it, T the
time constant."""


class Driven(NamedTuple):
    """Accumulated wheel motion up to some time, independent of its direction."""

    moving: float = 0.0
    """Time in motion [s]."""
    path: float = 0.0
    """Path length [m]."""
    turned: float = 0.0
    """Accumulated rotation [rad]."""

    def since(self, then: Driven) -> Driven:
        """Return the wheel motion since an earlier time."""
        return Driven(*(now - before for now, before in zip(self, then, strict=True)))


class Reckoned(NamedTuple):
    """Dead reckoning at some time."""

    pose: Pose
    """Dead-reckoned pose, heading not wrapped."""
    driven: Driven
    """Wheel motion up to this time."""
    moves: bool
    """Whether the robot moves, beyond jitter at standstill."""
    age: float
    """Time since the newest twist [s]; infinite without one."""


class SettledTwist(NamedTuple):
    """The twist of a robot that follows its odometry as a first-order lag with time constant T."""

    twist: tuple[float, float]
    """Speed [m/s] and yaw rate [rad/s]."""
    slope: tuple[float, float]
    """Derivative by T of T times `twist` [m/s], [rad/s]."""


class Stretch(NamedTuple):
    """Twists of an interval, and mean rates without the noise of single samples."""

    twists: list[OdometrySample]
    """Twists that are valid in the interval, at least in part."""
    steady_speed: float
    """Mean speed just before its end [m/s]."""
    ends: tuple[SettledTwist, SettledTwist]
    """The robot's twists at its beginning and its end."""


class OdometrySample(NamedTuple):
    """A twist, valid from its stamp to the next, and dead reckoning at its stamp.

    A twist of unknown motion has the speeds zero, and `until` not after `t`.
    """

    t: float
    """[s]"""
    v: float
    """[m/s]"""
    omega: float
    """[rad/s]"""
    until: float
    """Time up to which the motion is known [s]: from this twist, or, where that is before `t`, from
    an earlier one."""
    heading: float
    """Dead-reckoned heading, not wrapped [rad]."""
    path: float
    """Signed path length, backward negative [m]."""
    steady: float
    """Mean speed just before, without sample noise [m/s]."""
    x: float
    """Dead-reckoned position [m]."""
    y: float
    """[m]"""
    driven: Driven
    """Wheel motion since the first twist."""
    is_pose_given: bool
    """Whether the robot reported the pose at this stamp."""

    def pose(self, t: float) -> Pose:
        """Return the dead-reckoned pose at `t` [s]."""
        start, dt = Pose(self.x, self.y, self.heading), max(min(t, self.until) - self.t, 0.0)
        return advance(start, Twist(self.v, self.omega), dt) if dt else start

    def reckoned(self, t: float) -> tuple[float, float]:
        """Return heading [rad] and signed path length [m] at `t` [s]."""
        dt = max(min(t, self.until) - self.t, 0.0)
        return self.heading + self.omega * dt, self.path + self.v * dt

    def driven_until(self, t: float) -> Driven:
        """Return the wheel motion up to `t` [s]."""
        if not (self.v or self.omega):
            return self.driven
        dt, (moving, path, turned) = max(min(t, self.until) - self.t, 0.0), self.driven
        return Driven(moving + dt, path + abs(self.v) * dt, turned + abs(self.omega) * dt)


_stamp = attrgetter("t")
ORIGIN = Pose(0.0, 0.0, 0.0)


class TwistHistory:
    """The history of twists; all users of odometry share one."""

    def __init__(self) -> None:
        self._samples: list[OdometrySample] = []
        self._validity = TwistValidity()
        self.newest = -math.inf
        """Stamp of the newest twist [s]; minus infinity if there was none."""

    def __bool__(self) -> bool:
        """Whether there was any twist."""
        return bool(self._samples)

    def add(self, t: float, v: float, omega: float, pose: Pose | None = None) -> None:
        """Insert a twist, which may be late; one with the stamp of another replaces it.

        NaN for `v` or `omega`: the motion is unknown until the next twist. A `pose` that the robot
        reports at the stamp replaces the dead-reckoned one.
        """
        validity, self.newest = self._validity.add(t), max(self.newest, t)
        if math.isnan(v) or math.isnan(omega):
            v = omega = validity = 0.0
        later = []
        while self._samples and self._samples[-1].t > t:
            later.append(self._samples.pop())
        same = self._samples.pop() if self._samples and self._samples[-1].t == t else None
        self._append(t, v, omega, validity, pose, same)
        for old in reversed(later):
            given = old.pose(old.t) if old.is_pose_given else None
            self._append(*old[:3], old.until - old.t, given)

    def _append(
        self,
        t: float,
        v: float,
        omega: float,
        validity: float,
        pose: Pose | None,
        same: OdometrySample | None = None,
    ) -> None:
        """Append a twist that is valid for a time [s]; 0: the motion is unknown.

        Dead reckoning continues from the last twist, or from one of the `same` stamp.
        """
        last = self._samples[-1] if self._samples else same
        x, y, heading = ORIGIN
        known, path, driven = -math.inf, 0.0, Driven()
        if last is not None:
            (x, y, _), (heading, path) = last.pose(t), last.reckoned(t)
            known, driven = last.until, last.driven_until(t)
        until = t + validity if validity > 0.0 else min(known, t)
        if pose is not None:
            x, y, heading = pose.x, pose.y, heading + wrap(pose.heading - heading)
        steady = (path - self.path(t - STEADY_S)) / STEADY_S if self._samples else 0.0
        reckoned = heading, path, steady, x, y, driven
        self._samples.append(OdometrySample(t, v, omega, until, *reckoned, pose is not None))

    def before(self, t: float) -> OdometrySample | None:
        """Return the latest twist at `t` [s]; None before the first."""
        after = bisect_right(self._samples, t, key=_stamp)
        return self._samples[after - 1] if after else None

    def _at(self, t: float) -> OdometrySample | None:
        """Return the twist for dead reckoning at `t` [s]: the latest, or else the first, if any."""
        return self.before(t) or (self._samples[0] if self._samples else None)

    def unknown_time(self, t: float) -> float:
        """Return the time since the motion became unknown, at `t` [s]; infinite without twists."""
        twist = self.before(t)
        return math.inf if twist is None else max(t - twist.until, 0.0)

    def heading(self, t: float) -> float:
        """Return the dead-reckoned heading at `t` [s], not wrapped [rad]."""
        return self.reckoned(t)[0]

    def path(self, t: float) -> float:
        """Return the signed path length up to `t` [s] [m]."""
        return self.reckoned(t)[1]

    def at(self, t: float) -> Reckoned:
        """Return the dead-reckoned state at `t` [s]."""
        twist = self._at(t)
        if twist is None:
            return Reckoned(ORIGIN, Driven(), False, math.inf)
        return Reckoned(twist.pose(t), twist.driven_until(t), self._moves(t), t - self.newest)

    def pose(self, t: float) -> Pose:
        """Return the dead-reckoned pose at `t` [s]; its heading is not wrapped."""
        twist = self._at(t)
        return ORIGIN if twist is None else twist.pose(t)

    def driven(self, t: float) -> Driven:
        """Return the wheel motion up to `t` [s]."""
        twist = self._at(t)
        return Driven() if twist is None else twist.driven_until(t)

    def _moves(self, t: float) -> bool:
        """Return whether the robot moves at `t` [s], beyond jitter at standstill.

        An old twist without a successor is no evidence of motion.
        """
        if t - self.newest > 0.5 * STEADY_S:
            return False
        (heading, path), (before, start) = self.reckoned(t), self.reckoned(t - STEADY_S)
        fast = abs(path - start) / STEADY_S > MOVING_SPEED
        return fast or abs(heading - before) > MOVING_TURN_RATE * STEADY_S

    def mean(self, t: float, over: float) -> tuple[float, float]:
        """Return the mean speed [m/s] and yaw rate [rad/s] in the last `over` [s] before `t` [s].

        Only time after the first twist counts. Before that, the first twist is the mean.
        """
        if not self._samples:
            return 0.0, 0.0
        first = self._samples[0]
        since = max(t - over, first.t)
        if t <= since:
            return first.v, first.omega
        (heading, path), (before, start) = self.reckoned(t), self.reckoned(since)
        return (path - start) / (t - since), (heading - before) / (t - since)

    def reckoned(self, t: float) -> tuple[float, float]:
        """Return heading [rad] and signed path length [m] at `t` [s]."""
        twist = self._at(t)
        return (0.0, 0.0) if twist is None else twist.reckoned(t)

    def reckoned_at(self, times: list[float]) -> np.ndarray | None:
        """Return `reckoned` at k times [s], newest first, (2, k); None before the first twist."""
        if self.before(times[0]) is None:
            return None
        return np.array([self.reckoned(t) for t in times]).T

    def settled(self, t: float, time_constant: float) -> SettledTwist:
        """Return the robot's twist at `t` [s]; the time constant [s] is `MEAN_S` / 2 at least."""
        lag = max(time_constant, 0.5 * MEAN_S)
        if not self._samples:
            return SettledTwist((0.0, 0.0), (0.0, 0.0))
        samples, reckoned = self._samples, []
        k = max(bisect_right(samples, t, key=_stamp) - 1, 0)
        for time in (t - lag * LAG_TIMES).tolist():
            while k and samples[k].t > time:
                k -= 1
            twist = samples[k]
            dt = time - twist.t  # the first twist counts before its stamp, too
            dt = max(min(dt, twist.until - twist.t), 0.0) if dt > 0.0 else dt
            reckoned.append((twist.path + twist.v * dt, twist.heading + twist.omega * dt))
        changes = np.array(reckoned)
        rates = (changes[:-1] - changes[1:]) / (lag * np.diff(LAG_TIMES))[:, None]
        (v, omega), (by_v, by_omega) = (WEIGHTS @ rates).tolist()
        return SettledTwist((v, omega), (by_v, by_omega))

    def stretch(self, begin: float, end: float, time_constant: float) -> Stretch:
        """Return the twists from `begin` until `end` [s], with mean rates."""
        first, last = (bisect_left(self._samples, t, key=_stamp) for t in (begin, end))
        valid = self._samples[max(first - 1, 0) : last]
        steady = (self.reckoned(end)[1] - self.reckoned(end - STEADY_S)[1]) / STEADY_S
        known = max(begin, self._samples[0].t) if self._samples else end
        ends = self.settled(known, time_constant), self.settled(end, time_constant)
        return Stretch(valid, steady, ends)

    def forget(self, t: float) -> None:
        """Drop the twists that ended before `t` [s]."""
        old = bisect_left(self._samples, t, lo=1, key=_stamp) - 1 if self._samples else 0
        if 2 * old > len(self._samples):  # so that each sample is shifted once on average
            del self._samples[:old]
