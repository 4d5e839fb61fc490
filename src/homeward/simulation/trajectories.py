"""Ways to drive: from the time and the pose believed to a command, until the drive is done."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol, assert_never

import numpy as np

from homeward.control.following import COAST_S, Follower, Path, State
from homeward.control.laws import Slope, homing, law_named, steer, way_home
from homeward.errors import InputError
from homeward.frames import Polar, Pose, Twist, bearing, between, to_polar
from homeward.simulation.repeating import place_of
from homeward.simulation.scenario import ByPoints, Circle, Course, Homing, Repeat, Teach, Waypoints

Command = Twist | None
"""None where the drive is done."""
Seen = Mapping[str, float]
"""Id to direction in the home frame [rad] of what was seen last."""
UNSEEN: Seen = MappingProxyType({})
SEARCH_RADIUS = 0.5
"""Without a pose the robot drives an arc of this radius [m] at first, for the parallax."""
SAME_CIRCLES = 3
"""It goes round so often before the arc widens: most places need no wider one."""
NARROW = math.pi
"""A camera that sees less of the way round [rad] sees each landmark from a part of a circle alone,
whose breadth across the line of sight is at most half of what all of it has: it looks round."""
LOOK_RATE = 0.6
"""At so much [rad/s]: in 10 s."""
LOOKS_PER_ROUND = 3
"""From three places of a circle each landmark is seen from a base that is broad enough."""
PAST_NEAREST = 0.005
"""So much farther from home than at its nearest, an estimated pose has passed it [m]."""
SLOWEST = 0.03
"""Near home the speed falls to no less than this share of it."""
LOOKS_S = 2.0
"""One that stands without a pose looks round for so long before it searches [s]."""
LOOKAHEAD = 0.4
"""The point on the line that the robot steers at is so far ahead [m]."""
TURN_ACCELERATION = 1.0
"""Between way points the turn rate changes at most so fast [rad/s^2]."""
LINE_STEP = 0.01
"""The line through the way points is taken as points this far apart [m]."""
LONGEST_LINE = 1e5
"""[m]; its points are all held in memory."""


class Control(Protocol):
    """Steers one drive."""

    gave_up: str = ""
    """Why, where it gave up."""

    def twist(self, t: float, pose: Pose | None, sure: bool = True, seen: Seen = UNSEEN) -> Command:
        """Return the command.

        Parameters
        ----------
        t : float
            Now [s], later than at the call before.
        pose : Pose or None
            Where the robot believes it is in the home frame; None when it does not know.
        sure : bool
            Whether that pose is one to rely on.
        seen : Seen
            What was seen last.
        """


def make_control(scenario: Course, start: Pose, home: Mapping[str, float] | None = None) -> Control:
    """Return what steers the drive of a scenario that begins at `start` in the home frame.

    `home` has the home bearings [rad] by their ids.
    """
    control = _make_control(scenario, start, home)
    spin = scenario.trajectory.spin
    return SpinFirst(spin, control) if spin else control


def _make_control(scenario: Course, start: Pose, home: Mapping[str, float] | None) -> Control:
    match scenario.trajectory:
        case Homing() as trajectory if slope := law_named(trajectory.law):
            return BearingControl(trajectory, slope, home or {})
        case Homing() as trajectory:
            return HomingControl(trajectory, scenario.estimator == "truth", scenario.view)
        case Circle() as trajectory:
            return CircleControl(trajectory)
        case Waypoints() as trajectory:
            return WaypointControl(trajectory, _line(trajectory, scenario.home.pose, start))
        case Teach() as trajectory:
            corners = _corners(trajectory, scenario.home.pose, start)
            stops = [(i, None, trajectory.dwell, str(i)) for i in range(1, len(corners))]
            return PathControl(trajectory, Path(corners, stops), True, scenario.view)
        case Repeat() as trajectory:
            path = place_of(trajectory).route(trajectory.route).path
            return PathControl(trajectory, path, scenario.estimator == "truth", scenario.view)
        case other:
            assert_never(other)


class SpinFirst(Control):
    """A full turn on the spot at a rate [rad/s], a rest of 1 s, and then another control."""

    def __init__(self, rate: float, then: Control) -> None:
        self._rate, self._then, self._turns_s = rate, then, math.tau / abs(rate)

    def twist(self, t: float, pose: Pose | None, sure: bool = True, seen: Seen = UNSEEN) -> Command:
        """Return the command; see `Control`."""
        if t < self._turns_s + 1.0:
            return Twist(0.0, self._rate if t < self._turns_s else 0.0)
        twist = self._then.twist(t, pose, sure, seen)
        self.gave_up = self._then.gave_up
        return twist


class Search:
    """Circles through one point, wider and wider: far landmarks need a wide base.

    A camera with a narrow `view` [rad] sees what is ahead of it alone, and again from the same part
    of the circle, hardly across the line of sight; so the robot stops there and looks round.
    """

    def __init__(self, speed: float, view: float = math.tau) -> None:
        self._speed, self._look_s = speed, math.tau / LOOK_RATE if view < NARROW else 0.0
        self._since: float | None = None

    def twist(self, t: float) -> Twist:
        """Return the command at `t` [s]; the search begins with the first one."""
        if self._since is None:
            self._since = t
        drive_s = math.tau * SEARCH_RADIUS / (LOOKS_PER_ROUND * self._speed)
        looks, now = divmod(t - self._since, self._look_s + drive_s)
        if now < self._look_s:
            return Twist(0.0, LOOK_RATE)
        rounds = (looks + (now - self._look_s) / drive_s) / LOOKS_PER_ROUND
        doubled = math.floor(math.log2(1.0 + rounds / SAME_CIRCLES))
        return Twist(self._speed, self._speed / (SEARCH_RADIUS * 2**doubled))

    def end(self) -> None:
        """Let the next search begin anew."""
        self._since = None


class HomingControl(Control):
    """The paper's homing law, until the robot believes itself at home.

    A pose that is estimated is off by something like the stop radius: with one the robot goes on
    inside that radius for as long as it gets nearer, unless it has slowed down, and it stops only
    when it is sure. With a narrow camera it looks round there once, for what home saw behind it,
    and wherever it is unsure.
    """

    def __init__(self, trajectory: Homing, exact: bool, view: float = math.tau) -> None:
        self._trajectory, self._exact = trajectory, exact
        self._nearest = math.inf
        self._search = Search(trajectory.speed, view)
        self._look_s = math.tau / LOOK_RATE if view < NARROW and not exact else 0.0
        self._home_since: float | None = None

    def twist(self, t: float, pose: Pose | None, sure: bool = True, seen: Seen = UNSEEN) -> Command:
        """Return the command; see `Control`."""
        if pose is None or (self._look_s and not sure):
            return self._search.twist(t)
        polar = to_polar(pose)
        arrived = self._trajectory.stop_radius > polar.R
        if self._home_since is None and sure and arrived:
            self._home_since = t
        if self._home_since is not None and t < self._home_since + self._look_s:
            return Twist(0.0, LOOK_RATE)
        if not arrived:
            self._nearest = math.inf
        elif not sure:
            return self._search.twist(t)
        elif self._exact or self._trajectory.slowing or self._nearest + PAST_NEAREST < polar.R:
            return None
        else:
            self._nearest = min(self._nearest, float(polar.R))
        self._search.end()
        most = self._trajectory.max_turn_rate
        if self._trajectory.law == "lyapunov":
            return steer(-pose.x, -pose.y, pose.heading, self._speed(polar), most)
        v, omega = map(float, homing(polar, self._speed(polar)))
        return Twist(v, max(-most, min(most, omega)))

    def _speed(self, polar: Polar) -> float:
        """Return how fast to drive: slowly near home, if so told, for the law turns at 1 rad/s."""
        speed, slowing = self._trajectory.speed, self._trajectory.slowing
        if not slowing:
            return speed
        return max(min(speed, float(polar.R) / slowing), SLOWEST * speed)


class BearingControl(Control):
    """A homing law by bearings and a compass alone, until the way home is short; no memory.

    Parameters
    ----------
    trajectory : Homing
        Speed, and how near is home.
    slope : callable
        Of `homeward.control.laws.LAWS`.
    home : mapping of str to float
        Home bearings [rad] by their ids.
    """

    def __init__(self, trajectory: Homing, slope: Slope, home: Mapping[str, float]) -> None:
        self._trajectory, self._slope, self._home = trajectory, slope, home
        self._search = Search(trajectory.speed)

    def twist(self, t: float, pose: Pose | None, sure: bool = True, seen: Seen = UNSEEN) -> Command:
        """Return the command; see `Control`."""
        drive = self._trajectory
        way = way_home(self._slope, seen, self._home, drive.landmark_distance)
        if pose is None or way is None:
            return self._search.twist(t)
        self._search.end()
        if math.hypot(*way) < drive.stop_radius:
            return None
        return steer(*way, pose.heading, drive.speed, drive.max_turn_rate)


class CircleControl(Control):
    """Constant speed and turn rate."""

    def __init__(self, trajectory: Circle) -> None:
        self._twist = Twist(trajectory.speed, trajectory.omega)

    def twist(self, t: float, pose: Pose | None, sure: bool = True, seen: Seen = UNSEEN) -> Command:
        """Return the command; see `Control`."""
        return self._twist


class WaypointControl(Control):
    """Pure pursuit of a line: the arc through a point on it that runs ahead of the robot.

    References
    ----------
    Coulter, "Implementation of the Pure Pursuit Path Tracking Algorithm", CMU-RI-TR-92-01.
    """

    def __init__(self, trajectory: Waypoints, line: np.ndarray) -> None:
        self._trajectory, self._line, self._aim = trajectory, line, 0
        self._last_t, self._last_omega = 0.0, 0.0
        self._search = Search(trajectory.speed)

    def twist(self, t: float, pose: Pose | None, sure: bool = True, seen: Seen = UNSEEN) -> Command:
        """Return the command; see `Control`."""
        if pose is None:
            wanted = self._search.twist(t).omega
        else:
            self._search.end()
            distance = self._aim_ahead_of(pose)
            error = float(bearing(pose, *self._line[self._aim]))
            if self._is_done(error, distance):
                return None
            wanted = self._turn_rate(error, distance)
        change = TURN_ACCELERATION * (t - self._last_t)
        omega = max(self._last_omega - change, min(self._last_omega + change, wanted))
        self._last_t, self._last_omega = t, omega
        return Twist(self._trajectory.speed, omega)

    def _is_done(self, error: float, distance: float) -> bool:
        """Say whether the last point is reached, or passed by."""
        if self._aim < len(self._line) - 1:
            return False
        passed = distance < LOOKAHEAD and abs(error) > math.pi / 2
        return passed or distance < self._trajectory.stop_radius

    def _aim_ahead_of(self, pose: Pose) -> float:
        """Let the aim run along the line until it is far enough ahead; return its distance."""
        while True:
            x, y = self._line[self._aim]
            distance = math.hypot(x - pose.x, y - pose.y)
            if distance >= LOOKAHEAD or self._aim == len(self._line) - 1:
                return distance
            self._aim += 1

    def _turn_rate(self, error: float, distance: float) -> float:
        """Return the turn rate of the arc to a point at bearing `error`; behind, turn hard."""
        most = self._trajectory.max_turn_rate
        if abs(error) > math.pi / 2:
            return math.copysign(most, error)
        return max(-most, min(most, 2 * self._trajectory.speed * math.sin(error) / distance))


class PathControl(Control):
    """Follows a path; where the pose is lost for long it is looked for on circles.

    Parameters
    ----------
    trajectory : Teach or Repeat
        Speed, turn rate, and when something is in the way.
    path : Path
        In the home frame.
    exact : bool
        Whether the pose is the truth, which needs no landmark in sight.
    view : float
        Of the camera [rad].
    """

    def __init__(self, trajectory: Teach | Repeat, path: Path, exact: bool, view: float) -> None:
        self._follower = Follower(path, trajectory.speed, trajectory.max_turn_rate)
        self._blocked = trajectory.blocked if isinstance(trajectory, Repeat) else None
        self._exact, self._sure_at = exact, -math.inf
        self._search = Search(trajectory.speed, view)

    def twist(self, t: float, pose: Pose | None, sure: bool = True, seen: Seen = UNSEEN) -> Command:
        """Return the command; see `Control`."""
        begin, end = self._blocked or (math.inf, math.inf)
        blocked, sure = begin <= t < end, sure and (self._exact or bool(seen))
        twist = self._follower.twist(t, pose, sure, blocked)
        if self._follower.over:
            failed = self._follower.state is State.FAILED
            self.gave_up = self._follower.reason if failed else ""
            return None
        if sure or self._sure_at == -math.inf:
            self._sure_at = t
        if blocked or t - self._sure_at < COAST_S + LOOKS_S:
            self._search.end()
            return twist
        return self._search.twist(t)


def _line(trajectory: Waypoints, home: Pose, start: Pose) -> np.ndarray:
    """Return the line from `start` through the way points, shape (n, 2), in the home frame [m].

    Raises
    ------
    InputError
        When it is too long to be held.
    """
    knots = _corners(trajectory, home, start)
    lengths = np.hypot(*np.diff(knots, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    if not along[-1] <= LONGEST_LINE:
        raise InputError(f"trajectory.points: {along[-1]:.3g} m to drive, {LONGEST_LINE:g} at most")
    fine = np.append(np.arange(0.0, along[-1], LINE_STEP), along[-1])
    return np.stack([np.interp(fine, along, knots[:, i]) for i in (0, 1)], axis=-1)


def _corners(trajectory: ByPoints, home: Pose, start: Pose) -> np.ndarray:
    """Return the start and the way points, shape (n, 2), in the home frame [m]."""
    corners = [(start.x, start.y)]
    for x, y in trajectory.points:
        local = between(home, Pose(x, y, 0.0))
        corners.append((local.x, local.y))
    if trajectory.end_at_home:
        corners.append((0.0, 0.0))
    return np.array(corners, float)
