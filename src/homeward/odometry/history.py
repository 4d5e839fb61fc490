"""Dead reckoning of twists: of a history with late ones inserted, and of recorded odometry."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple, Protocol, Self

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, advance
from homeward.odometry.validity import TwistValidity, validities
from homeward.table import GrowingTable

STEADY_S = 0.5
"""Averaging time of the speed: long enough against noise, shorter than changes of speed [s]."""
MOVING_SPEED, MOVING_TURN_RATE = 0.05, 0.1
"""Minimum mean speed [m/s] and yaw rate [rad/s] over `STEADY_S` of a moving robot: several times
the jitter and bias at standstill; in a second, a slower robot moves less than the uncertainty of a
pose."""


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


class OdometrySample(NamedTuple):
    """A twist, valid from its stamp to the next, and dead reckoning at its stamp.

    A twist of unknown motion has the speeds zero, and `until` not after `t`. A row of the table of
    twists has the same numbers; the compiled core reads the first nine.
    """

    t: float
    """[s]"""
    v: float
    """[m/s]"""
    vy: float
    """Speed to the left [m/s]."""
    omega: float
    """[rad/s]"""
    until: float
    """Time up to which the motion is known [s]: from this twist, or, where that is before `t`, from
    an earlier one."""
    heading: float
    """Dead-reckoned heading, not wrapped [rad]."""
    path: float
    """Signed path length of `v`, backward negative [m]."""
    side: float
    """Signed path length of `vy`, to the right negative [m]."""
    steady: float
    """Mean of `v` just before, without sample noise [m/s]."""
    x: float
    """Dead-reckoned position [m]."""
    y: float
    """[m]"""
    moving: float
    """Time in motion since the first twist [s]."""
    length: float
    """Path length since then [m]."""
    turned: float
    """Accumulated rotation since then [rad]."""
    is_pose_given: float
    """1 where the robot reported the pose at this stamp, else 0."""

    @property
    def driven(self) -> Driven:
        """Wheel motion since the first twist."""
        return Driven(self.moving, self.length, self.turned)

    def pose(self, t: float) -> Pose:
        """Return the dead-reckoned pose at `t` [s]."""
        start, dt = Pose(self.x, self.y, self.heading), max(min(t, self.until) - self.t, 0.0)
        return advance(start, Twist(self.v, self.omega), dt, self.vy) if dt else start

    def reckoned(self, t: float) -> tuple[float, float, float]:
        """Return heading [rad], and signed path lengths ahead and to the left [m], at `t` [s]."""
        dt = max(min(t, self.until) - self.t, 0.0)
        return self.heading + self.omega * dt, self.path + self.v * dt, self.side + self.vy * dt

    def driven_until(self, t: float) -> Driven:
        """Return the wheel motion up to `t` [s]."""
        if not (self.v or self.vy or self.omega):
            return self.driven
        dt, (moving, path, turned) = max(min(t, self.until) - self.t, 0.0), self.driven
        way = math.hypot(self.v, self.vy) * dt
        return Driven(moving + dt, path + way, turned + abs(self.omega) * dt)


ORIGIN = Pose(0.0, 0.0, 0.0)
NUM_COLUMNS = len(OdometrySample._fields)


class TwistHistory:
    """The history of twists; all users of odometry share one."""

    def __init__(self) -> None:
        self._table = GrowingTable((NUM_COLUMNS,))
        """Rows of `OdometrySample`."""
        self._validity = TwistValidity()
        self.newest = -math.inf
        """Stamp of the newest twist [s]; minus infinity if there was none."""

    def __bool__(self) -> bool:
        """Whether there was any twist."""
        return len(self._table) > 0

    @property
    def table(self) -> np.ndarray:
        """(n, 15): the twists in order of time, a row as `OdometrySample`."""
        return self._table.rows

    def _sample(self, row: int) -> OdometrySample:
        """Return a row of the table."""
        return OdometrySample._make(self.table[row].tolist())

    def _count_before(self, t: float, side: Literal["left", "right"]) -> int:
        """Return the end of the rows before `t` [s]; with the side "right", of those at it, too."""
        stamps = self.table[:, 0]
        if len(stamps) and t > stamps[-1]:
            return len(stamps)
        return int(stamps.searchsorted(t, side))

    def add(
        self, t: float, v: float, omega: float, pose: Pose | None = None, vy: float = 0.0
    ) -> None:
        """Insert a twist, which may be late; one with the stamp of another replaces it.

        `vy` is the speed of a holonomic robot to its left [m/s]. NaN for a speed: the motion is
        unknown until the next twist. A `pose` that the robot reports at the stamp replaces the
        dead-reckoned one.
        """
        validity, self.newest = self._validity.add(t), max(self.newest, t)
        if math.isnan(v + vy + omega):
            v = vy = omega = validity = 0.0
        kept = self._count_before(t, "left")
        later = [self._sample(row) for row in range(kept, len(self._table))]
        self._table.drop_last(len(later))
        same = later.pop(0) if later and later[0].t == t else None
        self._append(t, v, vy, omega, validity, pose, same)
        for old in later:
            given = old.pose(old.t) if old.is_pose_given else None
            self._append(*old[:4], old.until - old.t, given)

    def _append(
        self,
        t: float,
        v: float,
        vy: float,
        omega: float,
        validity: float,
        pose: Pose | None,
        same: OdometrySample | None = None,
    ) -> None:
        """Append a twist that is valid for a time [s]; 0: the motion is unknown.

        Dead reckoning continues from the last twist, or from one of the `same` stamp.
        """
        last = self._sample(-1) if self else same
        x, y, heading = ORIGIN
        known, path, side, driven = -math.inf, 0.0, 0.0, Driven()
        if last is not None:
            (x, y, _), (heading, path, side) = last.pose(t), last.reckoned(t)
            known, driven = last.until, last.driven_until(t)
        until = t + validity if validity > 0.0 else min(known, t)
        if pose is not None:
            x, y, heading = pose.x, pose.y, heading + wrap(pose.heading - heading)
        steady = (path - self.path(t - STEADY_S)) / STEADY_S if self else 0.0
        reckoned = heading, path, side, steady, x, y, *driven
        self._table.add((t, v, vy, omega, until, *reckoned, pose is not None))

    def before(self, t: float) -> OdometrySample | None:
        """Return the latest twist at `t` [s]; None before the first."""
        after = self._count_before(t, "right")
        return self._sample(after - 1) if after else None

    def _at(self, t: float) -> OdometrySample | None:
        """Return the twist for dead reckoning at `t` [s]: the latest, or else the first, if any."""
        return self.before(t) or (self._sample(0) if self else None)

    def unknown_time(self, t: float) -> float:
        """Return the time since the motion became unknown, at `t` [s]; infinite without twists."""
        twist = self.before(t)
        return math.inf if twist is None else max(t - twist.until, 0.0)

    def heading(self, t: float) -> float:
        """Return the dead-reckoned heading at `t` [s], not wrapped [rad]."""
        return self.reckoned(t)[0]

    def path(self, t: float) -> float:
        """Return the signed path length ahead up to `t` [s] [m]."""
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
        now, before = self.reckoned(t), self.reckoned(t - STEADY_S)
        turn, path, side = (a - b for a, b in zip(now, before, strict=True))
        fast = math.hypot(path, side) / STEADY_S > MOVING_SPEED
        return fast or abs(turn) > MOVING_TURN_RATE * STEADY_S

    def mean(self, t: float, over: float) -> tuple[float, float, float]:
        """Return the mean of v, vy [m/s] and omega [rad/s] in the last `over` [s] before `t` [s].

        Only time after the first twist counts. Before that, the first twist is the mean.
        """
        if not self:
            return 0.0, 0.0, 0.0
        first = self._sample(0)
        since = max(t - over, first.t)
        if t <= since:
            return first.v, first.vy, first.omega
        now, before = self.reckoned(t), self.reckoned(since)
        omega, v, vy = ((a - b) / (t - since) for a, b in zip(now, before, strict=True))
        return v, vy, omega

    def reckoned(self, t: float) -> tuple[float, float, float]:
        """Return heading [rad], and signed path lengths ahead and to the left [m], at `t` [s]."""
        twist = self._at(t)
        return (0.0, 0.0, 0.0) if twist is None else twist.reckoned(t)

    def reckoned_at(self, times: list[float]) -> np.ndarray | None:
        """Return `reckoned` at k times [s], newest first, (3, k); None before the first twist."""
        if self.before(times[0]) is None:
            return None
        return np.array([self.reckoned(t) for t in times]).T

    def forget(self, t: float) -> None:
        """Drop the twists that ended before `t` [s]."""
        self._table.drop_first(max(0, self._count_before(t, "left") - 1))


class RecordedTwists(Protocol):
    """Twists in order of time, as in `homeward.drives.drive.Odometry`."""

    @property
    def t(self) -> np.ndarray:
        """Stamps, (n,) [s]."""

    @property
    def v(self) -> np.ndarray:
        """Speeds, (n,) [m/s]."""

    @property
    def omega(self) -> np.ndarray:
        """Yaw rates, (n,) [rad/s]."""

    @property
    def vy(self) -> np.ndarray:
        """Speeds to the left, (n,) [m/s]."""

    @property
    def bridged(self) -> Self:
        """The same with each unknown twist replaced by the last known one."""


def dead_reckoning(odometry: RecordedTwists, t: np.ndarray) -> Pose:
    """Integrate twists along arcs from the origin to poses (n,) at `t` [s].

    The first twist is at the origin. Each of one or more twists is valid for `validities`. Where
    the motion is unknown, the last known twist is used.
    """
    end = dead_reckoning_unwrapped(odometry, t)
    return end._replace(heading=wrap(end.heading))


def dead_reckoning_unwrapped(odometry: RecordedTwists, t: np.ndarray) -> Pose:
    """Integrate as `dead_reckoning`, with unwrapped headings."""
    odometry, valid = odometry.bridged, validities(odometry.t)
    twists, vy, held = Twist(odometry.v, odometry.omega), odometry.vy, valid[:-1]
    heading = np.append(0.0, np.cumsum(odometry.omega[:-1] * held))
    start = Pose(0.0, 0.0, heading[:-1])
    steps = advance(start, Twist(*(a[:-1] for a in twists)), held, vy[:-1])
    x, y = (np.append(0.0, np.cumsum(step)) for step in (steps.x, steps.y))
    last = np.maximum(np.searchsorted(odometry.t, t, side="right") - 1, 0)
    since = np.clip(t - odometry.t[last], 0.0, valid[-1])
    start = Pose(x[last], y[last], heading[last])
    return advance(start, Twist(*(a[last] for a in twists)), since, vy[last])
