"""Homing on a robot: drives only where that is safe, and says why where it is not."""

from __future__ import annotations

import enum
import math
from typing import NamedTuple

import numpy as np

from homeward.control import Twist
from homeward.estimator import Status
from homeward.frames import Pose, compose, inverse
from homeward.laws import steer
from homeward.live.settings import Limits

AFTERWARDS_S = 1.0
"""So long after the end the robot is told to stand, and then left to others [s]."""
LONGEST_STEP_S = 0.1
"""Between two commands no more time counts for acceleration [s]."""
STAND = Twist(0.0, 0.0)


class State(enum.Enum):
    """Where a drive home stands."""

    IDLE = "idle"
    """Nobody asked for home, or that is over."""
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


class Homing:
    """Drives home, by the law of `homeward.laws.steer`, within limits.

    Time is of a steady clock [s], and not read here.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.state, self.reason = State.IDLE, ""
        self.goal = Pose(0.0, 0.0, 0.0)
        """Home, in the frame of the belief."""
        self._twist, self._last = STAND, -math.inf
        self._since = -math.inf
        """When the state began."""
        self._sure = -math.inf
        """When the robot was localised last."""

    @property
    def active(self) -> bool:
        """Whether it is on its way home."""
        return self.state in (State.DRIVING, State.HELD)

    def go(self, now: float) -> None:
        """Begin to drive home."""
        self._twist, self._sure = STAND, -math.inf
        self._enter(State.HELD, "", now)

    def fail(self, reason: str, now: float) -> None:
        """Stand, and give up."""
        if self.active:
            self._stand(State.FAILED, reason, now)

    def command(self, now: float, belief: Belief, faults: tuple[str, ...]) -> Twist | None:
        """Return the command at `now`, or None where the robot is left to others.

        Parameters
        ----------
        now : float
            [s]
        belief : Belief
            Where the robot is.
        faults : tuple of str
            What is wrong with the sensors.
        """
        dt, self._last = min(now - self._last, LONGEST_STEP_S), now
        if belief.status is Status.LOCALISED:
            self._sure = now
        if not self.active:
            over = self.state is State.IDLE or now - self._since > AFTERWARDS_S
            return None if over else STAND
        hindrance = faults[0] if faults else self._doubt(now, belief)
        if hindrance is not None:
            return self._hold(hindrance, now)
        return self._act(now, dt, belief)

    def _act(self, now: float, dt: float, belief: Belief) -> Twist:
        """Drive on by a belief that there is no doubt of, or end."""
        assert belief.pose is not None
        x, y, heading = compose(inverse(self.goal), belief.pose)
        if math.hypot(x, y) < self._limits.radius:
            if belief.status is Status.LOCALISED:
                return self._stand(State.ARRIVED, f"{math.hypot(x, y):.3f} m from home", now)
            return self._hold(f"at home, but {belief.status.value}", now)
        wanted = steer(-x, -y, heading, self._limits.speed, self._limits.turn_rate)
        return self._drive(wanted, now, dt)

    def _drive(self, wanted: Twist, now: float, dt: float) -> Twist:
        if self.state is not State.DRIVING:
            self._enter(State.DRIVING, "", now)
        self._twist = self._limited(wanted, dt)
        return self._twist

    def _doubt(self, now: float, belief: Belief) -> str | None:
        """Return why the pose is not one to drive by."""
        limits = self._limits
        if belief.pose is None or belief.covariance is None:
            return f"no pose: {belief.status.value}"
        if belief.status is not Status.LOCALISED and now - self._sure > limits.coast:
            return f"not localised: {belief.status.value}"
        sigma = math.sqrt(max(np.linalg.eigvalsh(belief.covariance[:2, :2])[-1], 0.0))
        if not sigma <= limits.largest_sigma:
            return f"too uncertain: sigma {sigma:.2f} m, at most {limits.largest_sigma:g} m"
        return None

    def _hold(self, why: str, now: float) -> Twist:
        """Stand at once; after a while give up."""
        if self.state is State.HELD and now - self._since > self._limits.patience:
            return self._stand(State.FAILED, why, now)
        if self.state is State.HELD:
            self.reason, self._twist = why, STAND
            return STAND
        return self._stand(State.HELD, why, now)

    def _stand(self, state: State, reason: str, now: float) -> Twist:
        self._twist = STAND
        self._enter(state, reason, now)
        return STAND

    def _enter(self, state: State, reason: str, now: float) -> None:
        self.state, self.reason, self._since = state, reason, now

    def _limited(self, wanted: Twist, dt: float) -> Twist:
        """Return a twist no farther from the last one than the accelerations allow."""
        dv, domega = self._limits.acceleration * dt, self._limits.turn_acceleration * dt
        v, omega = self._twist
        return Twist(
            v + max(-dv, min(dv, wanted.v - v)),
            omega + max(-domega, min(domega, wanted.omega - omega)),
        )
