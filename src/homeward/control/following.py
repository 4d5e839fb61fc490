"""Following a path: the closest point of entry, then along it by arcs, with stops on the way.

The law is pure pursuit: the arc through an aim on the path that runs ahead of the robot. It needs
no curvature of the path, which a taught chain of poses, each off by a centimetre or two, does not
have; laws in the path's own frame (Micaelli and Samson 1993) do. And it gets there from anywhere:

- The aim stands until the robot is nearer to it than the look-ahead, and then runs on, never back.
- A robot that does not face the aim turns on the spot. One that does drives on an arc, on which,
  with the aim at distance d and bearing e, d' = -v cos e and e' = -v sin e / d: d / sin e stays
  what it is, so that d falls to zero. That holds whatever the speed is, so the speed falls where
  the turn rate would grow beyond its bound, and the arc stays.
- So each aim is reached, and the last one is the end.
- Beside a straight path, with y the distance from it and L the look-ahead, to first order,
  y'' + 2 v / L y' + 2 v^2 / L^2 y = 0: it falls with a damping of 0.71, whatever the speed.

References
----------
Coulter, "Implementation of the Pure Pursuit Path Tracking Algorithm", CMU-RI-TR-92-01.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, bearing

LOOKAHEAD = 0.4
"""The aim is so far ahead [m]: several times what a pose is off, so that its noise hardly steers,
and less than an aisle is wide, so that corners are cut by a decimetre."""
FACING = 0.7
"""An aim within this of straight ahead is driven to; else the robot turns on the spot [rad]. The
arc then bulges by less than a fifth of the look-ahead."""
REACHED = 0.03
"""A stop counts as reached within this distance [m]: about what a good pose is off."""
ALIGNED = 0.05
"""At a stop the robot turns until its heading is so near the taught one [rad]."""
SETTLING_S = 1.0
"""Near a stop the speed is at most the distance over this; headings settle likewise [s]."""
COAST_S = 3.0
"""So long the robot drives on where its pose is not sure [s]: for about a metre, on which odometry
that is wrong by 5 % is off by 5 cm."""
STUCK_M = 0.5
"""A robot that was told to drive so far and did not get a fifth of it is stuck [m]."""
RETRY_S, PATIENCE_S = 5.0, 30.0
"""A stuck robot tries again after so long; one that got nowhere for so long gives up [s]."""
STAND = Twist(0.0, 0.0)
NO_POSE = "no pose to rely on"


class Stop(NamedTuple):
    """A place on a path at which to come to a stand."""

    at: float
    """Along the path [m]."""
    heading: float | None
    """To turn to there [rad]."""
    dwell: float
    """To stand there [s]."""
    name: str = ""


class Path:
    """A line to follow, with stops.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Its corners [m], one at least.
    stops : sequence of (int, float or None, float, str)
        At which corner, the heading to turn to [rad], how long [s] and the name; in order. Where
        the path turns back sharply, and at its end, there is a stop anyway.
    """

    def __init__(
        self, points: np.ndarray, stops: Sequence[tuple[int, float | None, float, str]] = ()
    ) -> None:
        self.points = np.asarray(points, float).reshape(-1, 2)
        lengths = np.hypot(*np.diff(self.points, axis=0).T)
        self.along = np.concatenate([[0.0], np.cumsum(lengths)])
        """(n,): how far each corner is along it [m]."""
        told = {i: Stop(float(self.along[i]), h, d, n) for i, h, d, n in stops}
        steps = np.flatnonzero(lengths > 0.0)
        ways = np.diff(self.points, axis=0)[steps]
        back = steps[1:][(ways[1:] * ways[:-1]).sum(axis=1) < 0.0]
        for corner in (*back.tolist(), len(self.points) - 1):
            told.setdefault(corner, Stop(float(self.along[corner]), None, 0.0))
        self.stops = tuple(sorted(told.values(), key=lambda stop: stop.at))
        self._begins, self._ways = steps, ways

    @property
    def length(self) -> float:
        """How long it is [m]."""
        return float(self.along[-1])

    def at(self, along: float) -> tuple[float, float]:
        """Return the point so far along it, x, y [m]."""
        x, y = (float(np.interp(along, self.along, self.points[:, i])) for i in (0, 1))
        return x, y

    def entry(self, pose: Pose, begin: float = 0.0, end: float = math.inf) -> float:
        """Return how far along the closest point of entry is [m], between two such lengths.

        A radian between the robot's heading and the path's counts as much as the look-ahead, so
        that of two ways in one aisle that is taken which leads where the robot faces.
        """
        end = min(end, self.length)
        first, last = self.along[self._begins], self.along[self._begins + 1]
        within = (last >= begin) & (first <= end)
        if not within.any():
            return max(begin, 0.0)
        a, way = self.points[self._begins], self._ways
        length = last - first
        share = ((np.array(pose[:2]) - a) * way).sum(axis=1) / length**2
        along = np.clip(first + np.clip(share, 0.0, 1.0) * length, begin, end)
        there = a + way * ((along - first) / length)[:, None]
        off = np.hypot(*(there - pose[:2]).T)
        turn = wrap(np.arctan2(way[:, 1], way[:, 0]) - pose.heading)
        cost = np.where(within, off**2 + (LOOKAHEAD * turn) ** 2, np.inf)
        return float(along[np.argmin(cost)])


class PathState(enum.Enum):
    """Where a drive along a path stands."""

    DRIVING = "driving"
    STOPPED = "stopped"
    """At a stop, turning to its heading or waiting."""
    HELD = "held"
    """Standing, for a reason; it goes on by itself."""
    ARRIVED = "arrived"
    FAILED = "failed"


class Follower:
    """Follows a path from wherever the robot is, once.

    Parameters
    ----------
    path : Path
        In the frame of the poses that it will be told.
    speed, turn_rate : float
        The most [m/s, rad/s].
    """

    def __init__(self, path: Path, speed: float, turn_rate: float) -> None:
        self._path, self._speed, self._turn_rate = path, speed, turn_rate
        self.state, self.reason = PathState.HELD, "not asked yet"
        self.stop = 0
        """Which of the path's stops comes next, or is being made."""
        self.entering = True
        """Whether it is still on its way to the path, at the beginning or after a push."""
        self._aim: float | None = None
        self._nearest = math.inf
        """To the aim so far [m]."""
        self._leave = math.inf
        """When a stop is over [s]."""
        self._sure = -math.inf
        """When the pose was sure last [s]."""
        self._held = self._again = math.inf
        """Since when it gets nowhere, and when a stuck robot tries again [s]."""
        self._mark, self._told, self._last = Pose(math.nan, math.nan, math.nan), 0.0, math.nan
        """Where it got on last, how far it was told to drive since [m], and when last [s]."""

    @property
    def over(self) -> bool:
        """Whether it has arrived, or given up."""
        return self.state in (PathState.ARRIVED, PathState.FAILED)

    @property
    def along(self) -> float:
        """How far along the path the aim is [m]."""
        return self._aim or 0.0

    def twist(
        self, t: float, pose: Pose | None, sure: bool = True, blocked: bool | str = False
    ) -> Twist:
        """Return the command.

        Parameters
        ----------
        t : float
            Now [s], not before the call before.
        pose : Pose or None
            Where the robot believes it is.
        sure : bool
            Whether that is one to rely on.
        blocked : bool or str
            Whether something is in the way, as a scanner or a bumper tells; or what, in words.
        """
        if self.over:
            return STAND
        if sure:
            self._sure = t
        if self.state is PathState.STOPPED and t < self._leave < math.inf:
            return STAND  # to wait it takes no pose
        if blocked:
            return self._hold(blocked if isinstance(blocked, str) else "blocked", t)
        if pose is None or t - self._sure > COAST_S:
            return self._hold(NO_POSE, t)
        if self._is_stuck(t, pose):
            return self._hold("blocked: told to drive, and did not get on", t)
        twist = self._along(t, pose)
        self._told += twist.v * (0.0 if math.isnan(self._last) else t - self._last)
        self._last = t
        return twist

    def _along(self, t: float, pose: Pose) -> Twist:
        """Return the command where nothing speaks against driving."""
        if self._aim is None:
            # Who stands where it begins wants all of it, also where it ends there.
            begins = math.dist(self._path.at(0.0), pose[:2]) < LOOKAHEAD
            self._aim = 0.0 if begins else self._path.entry(pose)
            self.stop = sum(stop.at < self._aim for stop in self._path.stops)
        stop, distance = self._path.stops[self.stop], self._aim_ahead_of(pose)
        if distance > self._nearest + LOOKAHEAD:  # pushed off, or the pose was corrected
            self._reenter(pose, distance)
            distance = self._aim_ahead_of(pose)
        self._nearest = min(self._nearest, distance)
        if self._aim >= stop.at and self._nearest <= REACHED:
            return self._stay(t, pose, stop)
        self.state, self.reason, self._leave = PathState.DRIVING, "", math.inf
        return self._pursue(pose, distance, self._aim >= stop.at)

    def _aim_ahead_of(self, pose: Pose) -> float:
        """Let the aim run on until it is far enough ahead, or at a stop; return its distance."""
        assert self._aim is not None
        last = self._path.stops[self.stop].at
        distance = math.dist(self._path.at(self._aim), pose[:2])
        self.entering = self.entering and distance >= LOOKAHEAD
        while distance < LOOKAHEAD and self._aim < last:
            # On the path or off it: it cannot be far enough any sooner.
            self._aim = min(self._aim + max(LOOKAHEAD - distance, 0.01), last)
            distance, self._nearest = math.dist(self._path.at(self._aim), pose[:2]), math.inf
        return distance

    def _reenter(self, pose: Pose, distance: float) -> None:
        """Aim at the closest point that is left between the stop before and the next one."""
        assert self._aim is not None
        stops, reach = self._path.stops, LOOKAHEAD + 2.0 * distance
        before = stops[self.stop - 1].at if self.stop else 0.0
        begin, end = max(before, self._aim - reach), min(stops[self.stop].at, self._aim + reach)
        self._aim, self._nearest = self._path.entry(pose, begin, end), math.inf
        self.entering = True

    def _pursue(self, pose: Pose, distance: float, stopping: bool) -> Twist:
        """Return the command along the arc to the aim; one that is not ahead is turned to."""
        assert self._aim is not None
        e = float(bearing(pose, *self._path.at(self._aim)))
        if abs(e) > FACING:
            return Twist(0.0, math.copysign(self._turn_rate, e))
        speed = min(self._speed, distance / SETTLING_S) if stopping else self._speed
        sharp = 2.0 * abs(math.sin(e)) * speed  # the turn rate times the distance
        if sharp > self._turn_rate * distance:
            speed *= self._turn_rate * distance / sharp
        return Twist(speed, 2.0 * math.sin(e) * speed / distance if distance > 0.0 else 0.0)

    def _stay(self, t: float, pose: Pose, stop: Stop) -> Twist:
        """Turn to the heading of a stop, wait, and go on to the next one."""
        self.state, self.reason, self._held = PathState.STOPPED, stop.name, math.inf
        e = 0.0 if stop.heading is None else float(wrap(stop.heading - pose.heading))
        if self._leave == math.inf:
            if abs(e) > ALIGNED:
                most = self._turn_rate
                return Twist(0.0, max(-most, min(most, e / SETTLING_S)))
            self._leave = t + stop.dwell
        if t < self._leave:
            return STAND
        self._leave, self._nearest = math.inf, math.inf
        if self.stop == len(self._path.stops) - 1:
            self.state, self.reason = PathState.ARRIVED, stop.name
        else:
            self.stop += 1
        return STAND

    def _is_stuck(self, t: float, pose: Pose) -> bool:
        """Say whether the robot was told to drive, and its pose says that it did not."""
        if not math.dist(self._mark[:2], pose[:2]) < 0.2 * STUCK_M:
            self._mark, self._told, self._held = pose, 0.0, math.inf
        if self._told <= STUCK_M:
            return False
        self._again = min(self._again, t + RETRY_S)
        if t < self._again:
            return True
        self._told, self._again = 0.0, math.inf
        return False

    def _hold(self, why: str, t: float) -> Twist:
        """Stand at once; after a while give up."""
        self._held, self._last = min(self._held, t), t
        gives_up = t - self._held > PATIENCE_S
        self.state = PathState.FAILED if gives_up else PathState.HELD
        self.reason = f"{why}; got nowhere for {PATIENCE_S:g} s" if gives_up else why
        return STAND
