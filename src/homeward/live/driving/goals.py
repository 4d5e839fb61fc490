"""Where a robot may be sent, and how it gets there: to a point, or along a route.

Each is asked at every tick, also while something hinders the robot, for a `Step`; what bounds its
acceleration, and when it gives up, is `homeward.live.driving.homing`'s.
"""

from __future__ import annotations

import enum
import math
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


class Drive(Protocol):
    """A drive to a goal."""

    patience: float
    """After standing for so long it has failed [s]."""

    def step(self, now: float, belief: Belief, hindrance: str) -> Step:
        """Return what to do at `now` [s]; with a hindrance, in words, the robot must stand."""


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
        return _ToSpot(self, limits)


class Along(NamedTuple):
    """A route to drive along, by `homeward.following`."""

    name: str
    path: following.Path
    """In the frame of the belief."""

    def drive(self, limits: Limits) -> Drive:
        """Return a drive along it."""
        return _AlongPath(self, limits)


class _ToSpot:
    """A drive to a point."""

    def __init__(self, spot: Spot, limits: Limits) -> None:
        self._spot, self._limits = spot, limits
        self.patience = limits.patience

    def step(self, now: float, belief: Belief, hindrance: str) -> Step:
        """Return what to do; see `Drive`."""
        if hindrance or belief.pose is None:
            return Step(State.HELD, hindrance)
        name, *there, standoff = self._spot
        dx, dy = there[0] - belief.pose.x, there[1] - belief.pose.y
        distance = math.hypot(dx, dy)
        left = max(distance - standoff, 0.0)
        if left < self._limits.radius:
            if belief.status is Status.LOCALISED:
                return Step(State.ARRIVED, f"{distance:.3f} m from {name}")
            return Step(State.HELD, f"at {name}, but {belief.status.value}")
        share, most = left / distance, self._limits
        heading = belief.pose.heading
        twist = steer(share * dx, share * dy, heading, most.speed, most.turn_rate)
        return Step(State.DRIVING, "", twist)


class _AlongPath:
    """A drive along a path; when it has failed `homeward.following.Follower` knows."""

    patience = math.inf

    def __init__(self, along: Along, limits: Limits) -> None:
        self._name, self._path = along
        self._follower = following.Follower(along.path, limits.speed, limits.turn_rate)

    def step(self, now: float, belief: Belief, hindrance: str) -> Step:
        """Return what to do; see `Drive`."""
        follower, sure = self._follower, belief.status is Status.LOCALISED
        twist = follower.twist(now, belief.pose, sure, hindrance or False)
        match follower.state:
            case following.State.ARRIVED:
                return Step(State.ARRIVED, f"arrived at the end of {self._name}")
            case following.State.FAILED:
                return Step(State.FAILED, f"given up: {follower.reason}")
            case following.State.HELD:
                return Step(State.HELD, follower.reason)
            case following.State.STOPPED:
                if twist == STAND:
                    return Step(State.HELD, f"waiting at {self._stop}")
                return Step(State.DRIVING, f"turning at {self._stop}", twist)
        if follower.entering:
            return Step(State.DRIVING, f"entering {self._name}", twist)
        metres = f"{follower.along:.0f} of {self._path.length:.0f} m"
        return Step(State.DRIVING, f"following {self._name}, {metres}", twist)

    @property
    def _stop(self) -> str:
        """The stop that is made, in words."""
        if self._follower.reason:
            return f"way point {self._follower.reason}"
        last = self._follower.stop == len(self._path.stops) - 1
        return "the end" if last else "a turn of the way"
