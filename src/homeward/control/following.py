"""Path following by pure pursuit, from the closest point of entry, with stops.

The robot drives on the arc through an aim on the path ahead of it. Unlike control laws in the
path's own frame (Micaelli and Samson 1993), pure pursuit needs no curvature, which a taught chain
of poses with errors of a centimetre or two does not have. It converges from any pose:

- The aim moves forward only, when the robot is nearer to it than the look-ahead.
- A robot that does not face the aim turns on the spot, and then drives on an arc. With the aim at
  distance d and bearing e, d' = -v cos e and e' = -v sin e / d. Therefore d / sin e is constant,
  and d falls to zero at any speed. If the turn rate would exceed its limit, the speed is reduced,
  which does not change the arc.
- So each aim is reached, and the last one is the end of the path.
- At a distance y from a straight path and with the look-ahead L, to first order,
  y'' + 2 v / L y' + 2 v^2 / L^2 y = 0: the distance falls with a damping of 0.71 at any speed.

References
----------
Coulter, "Implementation of the Pure Pursuit Path Tracking Algorithm", CMU-RI-TR-92-01.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from homeward.control.goals import Belief, ControlOutput, GoalController, GoalState
from homeward.control.limits import Limits
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, bearing

LOOKAHEAD = 0.4
"""Distance to the aim [m]: several times the error of a pose, so that its noise hardly affects
steering, and less than the width of an aisle, so that corners are cut by a decimetre only."""
FACING = 0.7
"""Maximum bearing of an aim to drive to; otherwise the robot turns on the spot [rad]. The arc then
deviates from its chord by less than a fifth of the look-ahead."""
REACHED = 0.03
"""Distance within which a stop is reached [m]: about the error of a good pose."""
ALIGNED = 0.05
"""Heading error within which a robot is aligned at a stop [rad]."""
SETTLING_S = 1.0
"""Time constant of the speed near a stop, and of the heading at a stop [s]."""
COAST_S = 3.0
"""Time for which the robot drives on while it is not localised [s]: about a metre, on which
odometry with an error of 5 % adds 5 cm."""
STUCK_M = 0.5
"""A robot commanded to drive this far that moved less than a fifth of it is stuck [m]."""
RETRY_S, PATIENCE_S = 5.0, 30.0
"""Time until a stuck robot tries again, and time without progress until it gives up [s]."""
MIN_LENGTH = 1e-9
"""Corners that are nearer to each other are one but for rounding, and have no direction [m]."""
NO_POSE = "no pose to rely on"


class Stop(NamedTuple):
    """Stop on a path."""

    at: float
    """Position along the path [m]."""
    heading: float | None
    """Heading to turn to [rad]."""
    dwell: float
    """Duration of the stop [s]."""
    name: str = ""


class Path:
    """Polyline to follow, with stops.

    `points` (n, 2) are its corners [m], one or more. A stop has the index of a corner, the heading
    to turn to [rad] or None, a duration [s] and a name; stops are in order, and are added at the
    end and at corners sharper than 90 degrees.
    """

    def __init__(
        self, points: np.ndarray, stops: Sequence[tuple[int, float | None, float, str]] = ()
    ) -> None:
        self.points = np.asarray(points, float).reshape(-1, 2)
        lengths = np.hypot(*np.diff(self.points, axis=0).T)
        self.along = np.concatenate([[0.0], np.cumsum(lengths)])
        """(n,): position of each corner along the path [m]."""
        stops_at = {i: Stop(float(self.along[i]), h, d, n) for i, h, d, n in stops}
        steps = np.flatnonzero(lengths > MIN_LENGTH)
        ways = np.diff(self.points, axis=0)[steps]
        back = steps[1:][(ways[1:] * ways[:-1]).sum(axis=1) < 0.0]
        for corner in (*back.tolist(), len(self.points) - 1):
            stops_at.setdefault(corner, Stop(float(self.along[corner]), None, 0.0))
        self.stops = tuple(sorted(stops_at.values(), key=lambda stop: stop.at))
        self._begins, self._ways = steps, ways

    @property
    def length(self) -> float:
        """Length [m]."""
        return float(self.along[-1])

    def at(self, along: float) -> tuple[float, float]:
        """Return the point x, y [m] at a position along the path [m]."""
        x, y = (float(np.interp(along, self.along, self.points[:, i])) for i in (0, 1))
        return x, y

    def entry(self, pose: Pose, begin: float = 0.0, end: float = math.inf) -> float:
        """Return the position of the closest point of entry [m], between `begin` and `end`.

        A heading difference of 1 rad counts as much as the look-ahead, so that of two opposite
        paths in one aisle, the one in the robot's direction is used.
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


class RouteGoal(NamedTuple):
    """Route to follow."""

    name: str
    path: Path
    """In the frame of the belief."""

    def controller(self, limits: Limits) -> GoalController:
        """Return the controller of a drive along the route, which decides when it fails."""
        return GoalController(math.inf, Follower(self, limits).step)


class Follower:
    """Follows a route once, from any pose, within the `limits` of the robot.

    A robot that moves sideways keeps its heading between stops.
    """

    def __init__(self, goal: RouteGoal, limits: Limits) -> None:
        self._name, self._path, self._limits = *goal, limits
        self._speed, self._turn_rate = limits.speed, limits.turn_rate
        self._stop = 0
        """Index of the current or next stop."""
        self._entering = True
        """Whether the robot is still driving to the path, at the start or after a push."""
        self._aim: float | None = None
        self._nearest = math.inf
        """Minimum distance to the aim up to now [m]."""
        self._leave_at = math.inf
        """When a stop ends [s]."""
        self._localised_at = -math.inf
        """When the robot was last localised [s]."""
        self._held_since = self._retry_at = math.inf
        """Start of a time without progress, and when a stuck robot tries again [s]."""
        self._progress_pose = Pose(math.nan, math.nan, math.nan)
        self._commanded, self._last = 0.0, math.nan
        """Distance commanded since the pose of the last progress [m], time of the last command [s].
        """

    def step(self, now: float, belief: Belief, hindrance: str) -> ControlOutput:
        """Return the output at `now` [s], which never decreases, until the drive is over.

        If a hindrance is given, the robot must stop.
        """
        if belief.status is Status.LOCALISED:
            self._localised_at = now
        if now < self._leave_at < math.inf:  # needs no pose
            return ControlOutput(GoalState.HELD, f"waiting at {self._stop_words}")
        if hindrance:
            return self._hold(hindrance, now)
        if belief.pose is None or now - self._localised_at > COAST_S:
            return self._hold(NO_POSE, now)
        if self._is_stuck(now, belief.pose):
            return self._hold("blocked: commanded to drive, but did not move", now)
        output = self._along(now, belief.pose)
        since = 0.0 if math.isnan(self._last) else now - self._last
        self._commanded += math.hypot(output.twist.v, output.vy) * since
        self._last = now
        return output

    @property
    def _stop_words(self) -> str:
        """The current stop in words."""
        if name := self._path.stops[self._stop].name:
            return f"way point {name}"
        is_last = self._stop == len(self._path.stops) - 1
        return "the end" if is_last else "a corner of the path"

    def _along(self, now: float, pose: Pose) -> ControlOutput:
        """Return the output when nothing prevents driving."""
        if self._aim is None:
            # A robot at the start drives all of the path, also if the path ends there.
            begins = math.dist(self._path.at(0.0), pose[:2]) < LOOKAHEAD
            self._aim = 0.0 if begins else self._path.entry(pose)
            self._stop = sum(stop.at < self._aim for stop in self._path.stops)
        stop, distance = self._path.stops[self._stop], self._aim_ahead_of(pose)
        if distance > self._nearest + LOOKAHEAD:  # pushed off, or the pose was corrected
            self._reenter(pose, distance)
            distance = self._aim_ahead_of(pose)
        self._nearest = min(self._nearest, distance)
        if self._aim >= stop.at and self._nearest <= REACHED:
            return self._stay(now, pose, stop)
        self._leave_at = math.inf
        twist, vy = self._pursue(pose, distance, self._aim >= stop.at)
        words = f"following {self._name}, {self._aim:.0f} of {self._path.length:.0f} m"
        words = f"entering {self._name}" if self._entering else words
        return ControlOutput(GoalState.DRIVING, words, twist, vy=vy)

    def _aim_ahead_of(self, pose: Pose) -> float:
        """Move the aim until it is far enough ahead or at a stop; return its distance [m]."""
        assert self._aim is not None
        last = self._path.stops[self._stop].at
        distance = math.dist(self._path.at(self._aim), pose[:2])
        self._entering = self._entering and distance >= LOOKAHEAD
        while distance < LOOKAHEAD and self._aim < last:
            # By the triangle inequality, no smaller step makes it far enough.
            self._aim = min(self._aim + max(LOOKAHEAD - distance, 0.01), last)
            distance, self._nearest = math.dist(self._path.at(self._aim), pose[:2]), math.inf
        return distance

    def _reenter(self, pose: Pose, distance: float) -> None:
        """Set the aim to the closest point of entry between the previous stop and the next."""
        assert self._aim is not None
        stops, reach = self._path.stops, LOOKAHEAD + 2.0 * distance
        before = stops[self._stop - 1].at if self._stop else 0.0
        begin, end = max(before, self._aim - reach), min(stops[self._stop].at, self._aim + reach)
        self._aim, self._nearest = self._path.entry(pose, begin, end), math.inf
        self._entering = True

    def _pursue(self, pose: Pose, distance: float, stopping: bool) -> tuple[Twist, float]:
        """Return twist and speed to the left: on the arc to the aim, or a turn towards it."""
        assert self._aim is not None
        e = float(bearing(pose, *self._path.at(self._aim)))
        speed = min(self._speed, distance / SETTLING_S) if stopping else self._speed
        if (sideways := self._limits.sideways) is not None:
            c, s = math.cos(e), math.sin(e)
            speed = min(speed, 1.0 / math.hypot(c / self._speed, s / sideways))
            return Twist(speed * c, 0.0), speed * s
        if abs(e) > FACING:
            return Twist(0.0, math.copysign(self._turn_rate, e)), 0.0
        sharp = 2.0 * abs(math.sin(e)) * speed  # the turn rate times the distance
        if sharp > self._turn_rate * distance:
            speed *= self._turn_rate * distance / sharp
        return Twist(speed, 2.0 * math.sin(e) * speed / distance if distance > 0.0 else 0.0), 0.0

    def _stay(self, now: float, pose: Pose, stop: Stop) -> ControlOutput:
        """Turn to the heading of a stop, wait, and continue to the next one."""
        self._held_since, words = math.inf, self._stop_words
        e = 0.0 if stop.heading is None else float(wrap(stop.heading - pose.heading))
        if self._leave_at == math.inf:
            if abs(e) > ALIGNED:
                limit = self._turn_rate
                twist = Twist(0.0, max(-limit, min(limit, e / SETTLING_S)))
                return ControlOutput(GoalState.DRIVING, f"turning at {words}", twist)
            self._leave_at = now + stop.dwell
        if now >= self._leave_at:
            if self._stop == len(self._path.stops) - 1:
                return ControlOutput(GoalState.ARRIVED, f"arrived at the end of {self._name}")
            self._leave_at, self._nearest = math.inf, math.inf
            self._stop += 1
        return ControlOutput(GoalState.HELD, f"waiting at {words}")

    def _is_stuck(self, t: float, pose: Pose) -> bool:
        """Return whether the robot was commanded to drive, but did not move."""
        if not math.dist(self._progress_pose[:2], pose[:2]) < 0.2 * STUCK_M:
            self._progress_pose, self._commanded, self._held_since = pose, 0.0, math.inf
        if self._commanded <= STUCK_M:
            return False
        self._retry_at = min(self._retry_at, t + RETRY_S)
        if t < self._retry_at:
            return True
        self._commanded, self._retry_at = 0.0, math.inf
        return False

    def _hold(self, why: str, now: float) -> ControlOutput:
        """Stop at once, and give up after `PATIENCE_S`."""
        self._held_since, self._last = min(self._held_since, now), now
        if now - self._held_since > PATIENCE_S:
            words = f"given up: {why}; no progress for {PATIENCE_S:g} s"
            return ControlOutput(GoalState.FAILED, words)
        return ControlOutput(GoalState.HELD, why, is_lost=why == NO_POSE)
