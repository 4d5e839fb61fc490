"""Goals of a drive: a point, home by bearings alone, a route, or a turn on the spot.

A goal makes a `GoalController`, which is asked at every tick, also while something hinders the
robot, for a `ControlOutput`. Limits of acceleration, and giving up, are those of
`homeward.control.driver`.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Literal, NamedTuple, Protocol

import numpy as np

from homeward.control import following
from homeward.control.following import STAND
from homeward.control.laws import Slope, homing, steer, way_home
from homeward.control.limits import Limits
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, to_polar

ROUND = 1.05 * math.tau
"""Odometry that nobody calibrated may turn by 5 % less than it says [rad]."""
RATE = 0.5
"""A camera of 60 degrees at 15 Hz sees each landmark thirty times then [rad/s]."""
UNSEEN: Mapping[str, float] = MappingProxyType({})


class GoalState(enum.Enum):
    """State of a drive."""

    IDLE = "idle"
    """Nobody sent the robot anywhere, or that is over."""
    DRIVING = "driving"
    HELD = "held"
    """Standing, for a reason; it goes on by itself."""
    ARRIVED = "arrived"
    TURNED = "turned"
    """Once round, where home is stored by a turn."""
    FAILED = "failed"


class Belief(NamedTuple):
    """Estimate by which a robot is driven."""

    status: Status
    pose: Pose | None
    """In the frame of home, or of the place's first one."""
    covariance: np.ndarray | None
    """(3, 3)"""
    seen: Mapping[str, float] = UNSEEN
    """Id to direction [rad] in the frame of the pose, of the landmarks seen last."""


class ControlOutput(NamedTuple):
    """Decision of a goal's controller at one time."""

    state: GoalState
    reason: str
    twist: Twist = STAND
    is_lost: bool = False
    """Whether the robot stands because its pose is not good enough."""


class GoalController(NamedTuple):
    """Controller of one drive to a goal."""

    patience: float
    """After standing for so long it has failed [s]."""
    step: Callable[[float, Belief, str], ControlOutput]
    """Output at a time [s]; with a hindrance, in words, the robot must stand."""
    by_odometry: bool = False
    """Whether odometry alone suffices: the belief's pose may lie in any frame."""


class Goal(Protocol):
    """Where the robot is sent."""

    def controller(self, limits: Limits) -> GoalController:
        """Return the controller of a drive there, from wherever the robot is."""


class PointGoal(NamedTuple):
    """A point to drive to, by a law on the pose.

    The default law is `homeward.control.laws.steer`. With the paper's, the speed is constant.
    """

    name: str
    x: float
    """In the frame of the belief [m]."""
    y: float
    standoff: float = 0.0
    """As near as it is to come [m]."""
    law: Literal["lyapunov", "paper"] = "lyapunov"

    def controller(self, limits: Limits) -> GoalController:
        """Return the controller of a drive there."""

        def step(now: float, belief: Belief, hindrance: str) -> ControlOutput:
            if hindrance or belief.pose is None:
                return ControlOutput(GoalState.HELD, hindrance)
            dx, dy = self.x - belief.pose.x, self.y - belief.pose.y
            distance = math.hypot(dx, dy)
            left = max(distance - self.standoff, 0.0)
            if left < limits.radius:
                return _there(f"{distance:.3f} m from {self.name}", self.name, belief.status)
            heading, most = belief.pose.heading, limits.turn_rate
            if self.law == "paper":
                v, omega = map(float, homing(to_polar(Pose(-dx, -dy, heading)), limits.speed))
                twist = Twist(v, max(-most, min(most, omega)))
            else:
                share = left / distance
                twist = steer(share * dx, share * dy, heading, limits.speed, most)
            return ControlOutput(GoalState.DRIVING, "", twist)

        return GoalController(limits.patience, step)


class BearingGoal(NamedTuple):
    """Home, by bearings and a compass (the heading of the pose) alone; no memory."""

    slope: Slope
    """Of `homeward.control.laws.LAWS`."""
    home: Mapping[str, float]
    """Id to home bearing [rad]."""
    distance: float
    """Of landmarks from home, about [m]."""

    def controller(self, limits: Limits) -> GoalController:
        """Return the controller of a drive there."""

        def step(now: float, belief: Belief, hindrance: str) -> ControlOutput:
            if hindrance or belief.pose is None:
                return ControlOutput(GoalState.HELD, hindrance)
            way = way_home(self.slope, belief.seen, self.home, self.distance)
            if way is None:
                why = "fewer than two landmarks of home in view"
                return ControlOutput(GoalState.HELD, why, is_lost=True)
            if math.hypot(*way) < limits.radius:
                return _there("home, by bearings", "home", belief.status)
            twist = steer(*way, belief.pose.heading, limits.speed, limits.turn_rate)
            return ControlOutput(GoalState.DRIVING, "", twist)

        return GoalController(limits.patience, step)


def _there(words: str, name: str, status: Status) -> ControlOutput:
    """Return the output within the radius: only a robot that is localised has arrived."""
    if status is Status.LOCALISED:
        return ControlOutput(GoalState.ARRIVED, words)
    return ControlOutput(GoalState.HELD, f"at {name}, but {status.value}", is_lost=True)


class RouteGoal(NamedTuple):
    """A route to drive along, by `homeward.control.following`."""

    name: str
    path: following.Path
    """In the frame of the belief."""

    def controller(self, limits: Limits) -> GoalController:
        """Return the controller of a drive along it; the `Follower` decides when it has failed."""
        follower = following.Follower(self.path, limits.speed, limits.turn_rate)

        def step(now: float, belief: Belief, hindrance: str) -> ControlOutput:
            sure = belief.status is Status.LOCALISED
            twist = follower.twist(now, belief.pose, sure, hindrance or False)
            match follower.state:
                case following.PathState.ARRIVED:
                    return ControlOutput(GoalState.ARRIVED, f"arrived at the end of {self.name}")
                case following.PathState.FAILED:
                    return ControlOutput(GoalState.FAILED, f"given up: {follower.reason}")
                case following.PathState.HELD:
                    lost = follower.reason == following.NO_POSE
                    return ControlOutput(GoalState.HELD, follower.reason, is_lost=lost)
                case following.PathState.STOPPED:
                    if twist == STAND:
                        return ControlOutput(GoalState.HELD, f"waiting at {self._stop(follower)}")
                    return ControlOutput(
                        GoalState.DRIVING, f"turning at {self._stop(follower)}", twist
                    )
            if follower.entering:
                return ControlOutput(GoalState.DRIVING, f"entering {self.name}", twist)
            metres = f"{follower.along:.0f} of {self.path.length:.0f} m"
            return ControlOutput(GoalState.DRIVING, f"following {self.name}, {metres}", twist)

        return GoalController(math.inf, step)

    def _stop(self, follower: following.Follower) -> str:
        """Return the stop that is made, in words."""
        if follower.reason:
            return f"way point {follower.reason}"
        last = follower.stop == len(self.path.stops) - 1
        return "the end" if last else "a turn of the way"


class TurnGoal(NamedTuple):
    """One turn on the spot, so that a camera that sees a part of home sees all of it.

    By odometry alone: the pose of the belief is that of the robot in its odometry frame.
    """

    def controller(self, limits: Limits) -> GoalController:
        """Return the controller of the turn."""
        left, last = ROUND, math.nan

        def step(now: float, belief: Belief, hindrance: str) -> ControlOutput:
            nonlocal left, last
            if hindrance or belief.pose is None:
                return ControlOutput(GoalState.HELD, hindrance)
            heading = float(belief.pose.heading)
            if math.isfinite(last):
                left -= float(wrap(heading - last))
            last = heading
            if left <= 0.0:
                return ControlOutput(GoalState.TURNED, "once round")
            return ControlOutput(GoalState.DRIVING, "", Twist(0.0, min(RATE, limits.turn_rate)))

        return GoalController(limits.patience, step, by_odometry=True)
