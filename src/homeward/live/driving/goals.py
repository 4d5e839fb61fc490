"""Where a robot may be sent, and how it gets there: to a point, or along a route.

Each is asked at every tick, also while something hinders the robot, for a `Step`; what bounds its
acceleration, and when it gives up, is `homeward.live.driving.homing`'s.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from homeward import following
from homeward.control import Twist
from homeward.estimator import Status
from homeward.frames import Pose
from homeward.laws import steer
from homeward.live.settings import Limits

STAND = Twist(0.0, 0.0)


class State(enum.Enum):
    """Where a drive stands."""

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
    """What is believed of the robot now."""

    status: Status
    pose: Pose | None
    """In the frame of home, or of the place's first one."""
    covariance: np.ndarray | None
    """(3, 3)"""


class Step(NamedTuple):
    """What is to be done now."""

    state: State
    reason: str
    twist: Twist = STAND


class Drive(NamedTuple):
    """A drive to a goal."""

    patience: float
    """After standing for so long it has failed [s]."""
    step: Callable[[float, Belief, str], Step]
    """What to do now [s]; with a hindrance, in words, the robot must stand."""


class Goal(Protocol):
    """Where the robot is sent."""

    def drive(self, limits: Limits) -> Drive:
        """Return a drive there, from wherever the robot is."""


class Spot(NamedTuple):
    """A point to drive to, by the law of `homeward.laws.steer`."""

    name: str
    x: float
    """In the frame of the belief [m]."""
    y: float
    standoff: float = 0.0
    """As near as it is to come [m]."""

    def drive(self, limits: Limits) -> Drive:
        """Return a drive there."""

        def step(now: float, belief: Belief, hindrance: str) -> Step:
            if hindrance or belief.pose is None:
                return Step(State.HELD, hindrance)
            dx, dy = self.x - belief.pose.x, self.y - belief.pose.y
            distance = math.hypot(dx, dy)
            left = max(distance - self.standoff, 0.0)
            if left < limits.radius:
                if belief.status is Status.LOCALISED:
                    return Step(State.ARRIVED, f"{distance:.3f} m from {self.name}")
                return Step(State.HELD, f"at {self.name}, but {belief.status.value}")
            share, heading = left / distance, belief.pose.heading
            twist = steer(share * dx, share * dy, heading, limits.speed, limits.turn_rate)
            return Step(State.DRIVING, "", twist)

        return Drive(limits.patience, step)


class Along(NamedTuple):
    """A route to drive along, by `homeward.following`."""

    name: str
    path: following.Path
    """In the frame of the belief."""

    def drive(self, limits: Limits) -> Drive:
        """Return a drive along it; when that has failed `homeward.following.Follower` knows."""
        follower = following.Follower(self.path, limits.speed, limits.turn_rate)

        def step(now: float, belief: Belief, hindrance: str) -> Step:
            sure = belief.status is Status.LOCALISED
            twist = follower.twist(now, belief.pose, sure, hindrance or False)
            match follower.state:
                case following.State.ARRIVED:
                    return Step(State.ARRIVED, f"arrived at the end of {self.name}")
                case following.State.FAILED:
                    return Step(State.FAILED, f"given up: {follower.reason}")
                case following.State.HELD:
                    return Step(State.HELD, follower.reason)
                case following.State.STOPPED:
                    if twist == STAND:
                        return Step(State.HELD, f"waiting at {self._stop(follower)}")
                    return Step(State.DRIVING, f"turning at {self._stop(follower)}", twist)
            if follower.entering:
                return Step(State.DRIVING, f"entering {self.name}", twist)
            metres = f"{follower.along:.0f} of {self.path.length:.0f} m"
            return Step(State.DRIVING, f"following {self.name}, {metres}", twist)

        return Drive(math.inf, step)

    def _stop(self, follower: following.Follower) -> str:
        """Return the stop that is made, in words."""
        if follower.reason:
            return f"way point {follower.reason}"
        last = follower.stop == len(self.path.stops) - 1
        return "the end" if last else "a turn of the way"
