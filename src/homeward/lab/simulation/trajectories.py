"""Control of a simulated robot: a command from the time and the estimate.

`homeward.control` drives a simulated robot to its goal, as it drives a real one. This module adds
the search without a pose, scripted drives with the true pose, and the place of a repeated route.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from typing import Protocol, assert_never

import numpy as np

from homeward.control.driver import Driver
from homeward.control.following import LOOKAHEAD, Path, RouteGoal
from homeward.control.goals import (
    NO_SIGHTINGS,
    BearingGoal,
    Belief,
    Goal,
    GoalState,
    PointGoal,
)
from homeward.control.laws import law_named
from homeward.control.limits import Limits
from homeward.control.watchdog import Fault
from homeward.drives.drive import Drive
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.geometry.frames import Pose, Twist, bearing, between
from homeward.lab.simulation.scenario import (
    ByPoints,
    Circle,
    Course,
    Homing,
    Repeat,
    Scenario,
    Teach,
    Waypoints,
)
from homeward.places.files import load_place, newest
from homeward.places.place import Place


def settled(scenario: Scenario) -> Scenario:
    """Return a scenario with the version of its place and the day set, so that it is repeatable.

    Raises `InputError` when there is no such place or route.
    """
    repeat = scenario.trajectory
    if not isinstance(repeat, Repeat):
        return scenario
    version = repeat.version or newest(repeat.place)
    place = load_place(repeat.place, version)
    place.route(repeat.route)
    where = os.path.realpath(repeat.place)
    now = {"place": where, "version": version, "when": _day(repeat, place)}
    return scenario.model_copy(update={"trajectory": repeat.model_copy(update=now)})


def as_visitor(scenario: Scenario, drive: Drive) -> Drive:
    """Return a drive with the place whose route it repeats, if the scenario repeats one.

    Raises `InputError` when the place cannot be read.
    """
    repeat = scenario.trajectory
    if not isinstance(repeat, Repeat):
        return drive
    place = load_place(repeat.place, repeat.version)
    return place.visited_by(drive, _day(repeat, place))


def _day(repeat: Repeat, place: Place) -> float:
    """Return the day of a repeat [days since 1970]."""
    return place.when + 1.0 if repeat.when is None else repeat.when


Command = Twist | None
"""None at the end of the drive."""
SEARCH_RADIUS = 0.5
"""Radius of the first arc of a search [m]; the arc gives parallax."""
SAME_CIRCLES = 3
"""Number of rounds before the arc widens."""
NARROW = math.pi
"""A robot with a smaller field of view [rad] stops on the circle to look round: ahead it sees each
landmark from only a part of the circle, with at most half of the full baseline."""
LOOK_RATE = 0.6
"""Yaw rate while looking round [rad/s]."""
LOOKS_PER_ROUND = 3
"""Number of stops on a circle, for a sufficient baseline to each landmark."""
WAIT_S = 2.0
"""Waiting time of a robot that has lost its pose, before it searches [s]."""
TURN_ACCELERATION = 1.0
"""Maximum change of the yaw rate of a scripted drive [rad/s^2]."""
LINE_STEP = 0.01
"""The aim of a scripted drive moves along its path in steps of this length [m]."""
MAX_PATH_M = 1e5
"""Length of a scripted path."""


def exact(pose: Pose, seen: Mapping[str, float] = NO_SIGHTINGS) -> Belief:
    """Return the belief of a robot with its true pose."""
    return Belief(Status.LOCALISED, pose, np.zeros((3, 3)), seen)


class Control(Protocol):
    """Control of one drive."""

    gave_up: str = ""
    """The reason, if the control gave up."""

    def twist(self, t: float, belief: Belief) -> Command:
        """Return the command at `t` [s], which increases from call to call."""


def make_control(scenario: Course, start: Pose, home: Mapping[str, float] | None = None) -> Control:
    """Return the control of a scenario's drive from `start` in the home frame.

    `home` has the home bearings [rad] by id.
    """
    control = _make_control(scenario, start, home or {})
    spin = scenario.trajectory.spin
    return SpinFirst(spin, control) if spin else control


def _make_control(scenario: Course, start: Pose, home: Mapping[str, float]) -> Control:
    truly = scenario.estimator == "truth"
    match scenario.trajectory:
        case Homing() as drive:
            looks = scenario.view < NARROW and not truly
            return GoalControl(homing_goal(drive, home), limits_of(drive), scenario.view, looks)
        case Circle() as drive:
            return CircleControl(drive)
        case Waypoints() as drive if truly:
            path = Path(_corners(drive, scenario.home.pose, start))
            if not path.length <= MAX_PATH_M:
                raise InputError(f"trajectory.points: {path.length:.3g} m long; max {MAX_PATH_M:g}")
            return LineControl(drive, path)
        case Waypoints() | Teach() as drive:
            corners = _corners(drive, scenario.home.pose, start)
            dwell = drive.dwell if isinstance(drive, Teach) else None
            stops = (
                [] if dwell is None else [(i, None, dwell, str(i)) for i in range(1, len(corners))]
            )
            goal = RouteGoal("the path", Path(corners, stops))
            return GoalControl(goal, limits_of(drive), scenario.view)
        case Repeat() as drive:
            place = load_place(drive.place, drive.version)
            goal = RouteGoal(drive.route, place.route(drive.route).path)
            return GoalControl(goal, limits_of(drive), scenario.view, blocked=drive.blocked)
        case other:
            assert_never(other)


def homing_goal(drive: Homing, home: Mapping[str, float]) -> Goal:
    """Return home as the goal for the law of a drive; `home` has the home bearings [rad]."""
    if slope := law_named(drive.law):
        return BearingGoal(slope, home, drive.landmark_distance)
    return PointGoal("home", 0.0, 0.0, law="paper" if drive.law == "paper" else "lyapunov")


def limits_of(drive: Homing | Teach | Repeat | Waypoints) -> Limits:
    """Return a robot's limits with the settings of a drive; the paper's law has no other limits."""
    given = {"speed": drive.speed, "turn_rate": drive.max_turn_rate, "patience": math.inf}
    if isinstance(drive, Homing | Waypoints):
        given["radius"] = drive.stop_radius
    if isinstance(drive, Homing) and (drive.law == "paper" or drive.drives_unlocalised):
        given |= {"coast": math.inf, "largest_sigma": math.inf}
    if isinstance(drive, Homing) and drive.law == "paper":
        given |= {"acceleration": math.inf, "turn_acceleration": math.inf}
    return Limits(**given)


class SpinFirst(Control):
    """Full rotation on the spot at a rate [rad/s], a rest of 1 s, and then another control."""

    def __init__(self, rate: float, then: Control) -> None:
        self._rate, self._then, self._turns_s = rate, then, math.tau / abs(rate)

    def twist(self, t: float, belief: Belief) -> Command:
        """Return the command; see `Control`."""
        if t < self._turns_s + 1.0:
            return Twist(0.0, self._rate if t < self._turns_s else 0.0)
        twist = self._then.twist(t, belief)
        self.gave_up = self._then.gave_up
        return twist


class Search:
    """Circles of increasing radius through one point: far landmarks need a wide baseline.

    With a narrow `view` [rad] the robot stops and looks round: straight ahead a camera sees each
    landmark from only a part of the circle, with little parallax.
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
        """Let the next search start from the beginning."""
        self._since = None


class GoalControl(Control):
    """Driver of `homeward.control`, with a search while the robot waits for a pose.

    The goal is in the home frame. A robot that `looks_round` does so once on arrival, for landmarks
    behind it, and continues from there. In the interval `blocked` [s] an obstacle is reported.
    """

    def __init__(
        self,
        goal: Goal,
        limits: Limits,
        view: float = math.tau,
        looks_round: bool = False,
        blocked: tuple[float, float] | None = None,
    ) -> None:
        # A lost robot searches on circles here, and need not turn on the spot before.
        self.driver, self._goal = Driver(limits.model_copy(update={"search": 0.0})), goal
        self._search = Search(limits.speed, view)
        self._blocked = blocked or (math.inf, math.inf)
        self._looks_round, self._looks_until = looks_round, -math.inf
        self._lost_since: float | None = None
        self._has_driven = False

    def twist(self, t: float, belief: Belief) -> Command:
        """Return the command; see `Control`."""
        driver = self.driver
        if t < self._looks_until:
            return Twist(0.0, LOOK_RATE)
        if driver.state is GoalState.IDLE:
            driver.go(t, self._goal)
        begin, end = self._blocked
        faults = (Fault("blocked"),) if begin <= t < end else ()
        twist = driver.command(t, belief, faults)
        if driver.state is GoalState.ARRIVED and self._looks_round:
            self._looks_round, self._looks_until = False, t + math.tau / LOOK_RATE
            driver.go(t, self._goal)
            return Twist(0.0, LOOK_RATE)
        if not driver.active:
            self.gave_up = driver.reason if driver.state is GoalState.FAILED else ""
            return None
        if driver.state is not GoalState.HELD or not driver.is_lost:
            self._lost_since = None
            self._has_driven = self._has_driven or driver.state is GoalState.DRIVING
            self._search.end()
            return twist
        if self._lost_since is None:
            self._lost_since = t
        waits = self._has_driven and t < self._lost_since + WAIT_S
        return twist if waits else self._search.twist(t)


class CircleControl(Control):
    """Constant speed and yaw rate."""

    def __init__(self, trajectory: Circle) -> None:
        self._twist = Twist(trajectory.speed, trajectory.omega)

    def twist(self, t: float, belief: Belief) -> Command:
        """Return the command; see `Control`."""
        return self._twist


class LineControl(Control):
    """Scripted drive along a path: constant speed, steered by the true pose. No robot runs it."""

    def __init__(self, trajectory: Waypoints, path: Path) -> None:
        self._trajectory, self._path, self._aim = trajectory, path, 0
        self._last_t, self._last_omega = 0.0, 0.0

    def twist(self, t: float, belief: Belief) -> Command:
        """Return the command; see `Control`."""
        assert belief.pose is not None
        x, y, distance = self._aim_ahead_of(belief.pose)
        error = float(bearing(belief.pose, x, y))
        if self._aim * LINE_STEP >= self._path.length:
            is_past = distance < LOOKAHEAD and abs(error) > math.pi / 2
            if is_past or distance < self._trajectory.stop_radius:
                return None
        wanted = self._turn_rate(error, distance)
        change = TURN_ACCELERATION * (t - self._last_t)
        omega = max(self._last_omega - change, min(self._last_omega + change, wanted))
        self._last_t, self._last_omega = t, omega
        return Twist(self._trajectory.speed, omega)

    def _aim_ahead_of(self, pose: Pose) -> tuple[float, float, float]:
        """Move the aim along the path to the look-ahead distance; return x, y and distance [m]."""
        while True:
            x, y = self._path.at(self._aim * LINE_STEP)
            distance = math.hypot(x - pose.x, y - pose.y)
            if distance >= LOOKAHEAD or self._aim * LINE_STEP >= self._path.length:
                return x, y, distance
            self._aim += 1

    def _turn_rate(self, error: float, distance: float) -> float:
        """Return the yaw rate of the arc to a point at bearing `error`; at its limit if behind."""
        limit = self._trajectory.max_turn_rate
        if abs(error) > math.pi / 2:
            return math.copysign(limit, error)
        return max(-limit, min(limit, 2 * self._trajectory.speed * math.sin(error) / distance))


def _corners(trajectory: ByPoints, home: Pose, start: Pose) -> np.ndarray:
    """Return the start and the way points, shape (n, 2), in the home frame [m]."""
    corners = [(start.x, start.y)]
    for x, y in trajectory.points:
        local = between(home, Pose(x, y, 0.0))
        corners.append((local.x, local.y))
    if trajectory.end_at_home:
        corners.append((0.0, 0.0))
    return np.array(corners, float)
