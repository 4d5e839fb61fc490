"""Goals of a drive: a point, home from bearings alone, or a turn on the spot.

A goal creates a `GoalController`, which returns a `ControlOutput` at every tick, also while driving
is prevented. `homeward.control.driver` limits accelerations and gives up after a time.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Literal, NamedTuple, Protocol

import numpy as np

from homeward.control.laws import BearingLaw, home_vector, homing, steer
from homeward.control.limits import Limits
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, to_polar

FULL_TURN = 1.05 * math.tau
"""Rotation by uncalibrated odometry, which may report 5 % too much [rad]."""
TURN_RATE = 0.5
"""At this rate a camera of 60 degrees and 15 Hz sees each landmark 30 times [rad/s]."""
STAND = Twist(0.0, 0.0)
NO_SIGHTINGS: Mapping[str, float] = MappingProxyType({})


class GoalState(enum.Enum):
    """State of a drive."""

    IDLE = "idle"
    """No goal, or cancelled."""
    DRIVING = "driving"
    HELD = "held"
    """Stopped for a reason, and continues when that is gone."""
    ARRIVED = "arrived"
    TURNED = "turned"
    """Turned once on the spot, to store home."""
    FAILED = "failed"


class Belief(NamedTuple):
    """Estimate from which a robot is driven."""

    status: Status
    pose: Pose | None
    """In the frame of home, or of the place's first home."""
    covariance: np.ndarray | None
    """(3, 3)"""
    seen: Mapping[str, float] = NO_SIGHTINGS
    """Direction [rad] in the frame of the pose, of each landmark in the last frame."""
    unseen_s: float = 0.0
    """Time for which the robot drove without a landmark in view [s]."""
    back: float = 0.0
    """Angle to the heading that it had with a landmark in view, wrapped [rad]."""


class ControlOutput(NamedTuple):
    """Decision of a goal's controller at one time."""

    state: GoalState
    reason: str
    twist: Twist = STAND
    is_lost: bool = False
    """Whether the robot is stopped because its pose is not good enough."""
    vy: float = 0.0
    """Speed to the left of a robot that moves sideways [m/s]."""


class GoalController(NamedTuple):
    """Controller of one drive to a goal."""

    patience: float
    """Maximum duration of a stop before the drive fails [s]."""
    step: Callable[[float, Belief, str], ControlOutput]
    """Output at a time [s]; if a hindrance is given, in words, the robot must stop."""
    by_odometry: bool = False
    """Whether odometry alone suffices: the belief's pose may be in any frame."""


class Goal(Protocol):
    """Goal of a drive."""

    def controller(self, limits: Limits) -> GoalController:
        """Return the controller of a drive to the goal, from any pose."""


class PointGoal(NamedTuple):
    """Point to drive to, by a homing law that uses the pose.

    The default law is `homeward.control.laws.steer`, on a nearly straight path: the robot turns on
    the spot until the point is within 45 degrees ahead. With the paper's, the speed is constant.
    A robot that moves sideways drives straight to the point, and keeps its heading.
    """

    name: str
    x: float
    """In the frame of the belief [m]."""
    y: float
    standoff: float = 0.0
    """Distance from the point at which to stop [m]."""
    law: Literal["lyapunov", "paper"] = "lyapunov"

    def controller(self, limits: Limits) -> GoalController:
        """Return the controller of a drive to the goal."""

        def step(now: float, belief: Belief, hindrance: str) -> ControlOutput:
            if hindrance or belief.pose is None:
                return ControlOutput(GoalState.HELD, hindrance)
            dx, dy = self.x - belief.pose.x, self.y - belief.pose.y
            distance = math.hypot(dx, dy)
            left = max(distance - self.standoff, 0.0)
            if left < limits.radius:
                return _at_goal(f"{distance:.3f} m from {self.name}", self.name, belief.status)
            heading, limit = belief.pose.heading, limits.turn_rate
            if self.law == "paper":
                v, omega = map(float, homing(to_polar(Pose(-dx, -dy, heading)), limits.speed))
                twist = Twist(v, max(-limit, min(limit, omega)))
            elif limits.sideways is not None:
                share = left / distance
                return _strafing(share * dx, share * dy, heading, limits)
            else:
                share = left / distance
                twist = steer(share * dx, share * dy, heading, limits.speed, limit, sharpness=2.0)
            return ControlOutput(GoalState.DRIVING, "", twist)

        return GoalController(limits.patience, step)


class BearingGoal(NamedTuple):
    """Home, from bearings and a compass (the heading of the pose) alone, without memory."""

    law: BearingLaw
    """From `homeward.control.laws.LAWS`."""
    home: Mapping[str, float]
    """Home bearing [rad] of each landmark."""
    distance: float
    """Approximate distance of landmarks from home [m]."""

    def controller(self, limits: Limits) -> GoalController:
        """Return the controller of a drive to the goal."""

        def step(now: float, belief: Belief, hindrance: str) -> ControlOutput:
            if hindrance or belief.pose is None:
                return ControlOutput(GoalState.HELD, hindrance)
            way = home_vector(self.law, belief.seen, self.home, self.distance)
            if way is None:
                why = "fewer than two landmarks with a home bearing in view"
                return ControlOutput(GoalState.HELD, why, is_lost=True)
            if math.hypot(*way) < limits.radius:
                return _at_goal("home, from bearings", "home", belief.status)
            if limits.sideways is not None:
                return _strafing(*way, belief.pose.heading, limits)
            twist = steer(*way, belief.pose.heading, limits.speed, limits.turn_rate)
            return ControlOutput(GoalState.DRIVING, "", twist)

        return GoalController(limits.patience, step)


def _strafing(x: float, y: float, heading: float, limits: Limits) -> ControlOutput:
    """Return the output of a robot that drives straight along (x, y) [m] with any heading [rad]."""
    v, vy = limits.towards(x, y, heading)
    return ControlOutput(GoalState.DRIVING, "", Twist(v, 0.0), vy=vy)


def _at_goal(words: str, name: str, status: Status) -> ControlOutput:
    """Return the output within the radius; only a localised robot has arrived."""
    if status is Status.LOCALISED:
        return ControlOutput(GoalState.ARRIVED, words)
    return ControlOutput(GoalState.HELD, f"at {name}, but {status.value}", is_lost=True)


class TurnGoal(NamedTuple):
    """One turn on the spot, so that a narrow camera sees all landmarks at home.

    Uses odometry alone: the pose of the belief is in the odometry frame.
    """

    def controller(self, limits: Limits) -> GoalController:
        """Return the controller of the turn."""
        left, last = FULL_TURN, math.nan

        def step(now: float, belief: Belief, hindrance: str) -> ControlOutput:
            nonlocal left, last
            if hindrance or belief.pose is None:
                return ControlOutput(GoalState.HELD, hindrance)
            heading = float(belief.pose.heading)
            if math.isfinite(last):
                left -= float(wrap(heading - last))
            last = heading
            if left <= 0.0:
                return ControlOutput(GoalState.TURNED, "turned once round")
            return ControlOutput(
                GoalState.DRIVING, "", Twist(0.0, min(TURN_RATE, limits.turn_rate))
            )

        return GoalController(limits.patience, step, by_odometry=True)
