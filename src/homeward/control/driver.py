"""Driver of a robot to a goal, which stops with a reason whenever driving is not safe."""

from __future__ import annotations

import math

from homeward.control.following import STAND
from homeward.control.goals import Belief, Goal, GoalController, GoalState
from homeward.control.limits import Limits
from homeward.control.watchdog import Debounced, Fault
from homeward.estimator import Status
from homeward.geometry.frames import Twist, position_sigma

AFTERWARDS_S = 1.0
"""Time after the end of a drive for which zero commands are sent [s]."""
MAX_STEP_S = 0.1
"""Maximum time step for the limits of acceleration [s]."""


class Driver:
    """Drives to a goal within limits. Times are from a steady clock [s]."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.state, self.reason = GoalState.IDLE, ""
        self.value: float | None = None
        """The measured quantity behind the reason, if any."""
        self.is_lost = False
        """Whether the robot is stopped because its pose is not good enough."""
        self._goal: Goal | None = None
        self._controller: GoalController | None = None
        """Controller of the goal; None until the goal is known."""
        self._twist, self._last = STAND, -math.inf
        self._since = -math.inf
        """When the state began."""
        self._localised_at = -math.inf
        """When the robot was last localised."""
        self._uncertain = Debounced()

    @property
    def active(self) -> bool:
        """Whether a drive is in progress."""
        return self.state in (GoalState.DRIVING, GoalState.HELD)

    def go(self, now: float, goal: Goal | None = None) -> None:
        """Start a drive; without a goal, as soon as `aim` sets one."""
        self._goal = self._controller = None
        self._twist, self._localised_at, self.value, self._last = STAND, -math.inf, None, now
        self._enter(GoalState.HELD, "", now)
        self.aim(goal)

    def aim(self, goal: Goal | None) -> None:
        """Set the goal; a new object restarts its controller."""
        if goal is not self._goal:
            self._goal = goal
            self._controller = None if goal is None else goal.controller(self._limits)

    def fail(self, reason: str, now: float) -> None:
        """Stop, and give up."""
        if self.active:
            self.value = None
            self._stand(GoalState.FAILED, reason, now)

    def command(self, now: float, belief: Belief, faults: tuple[Fault, ...] = ()) -> Twist | None:
        """Return the command at `now` [s], or None to send none, given faults of the sensors."""
        dt, self._last = min(now - self._last, MAX_STEP_S), now
        if belief.status is Status.LOCALISED:
            self._localised_at = now
        if not self.active:
            over = self.state is GoalState.IDLE or now - self._since > AFTERWARDS_S
            return None if over else STAND
        fault = self.hindrance(now, belief, faults)
        pose_fault = None if faults else fault
        hindrance, self.value = fault or ("", None)
        if self._controller is None:
            return self._hold(hindrance, now, self._limits.patience)
        output = self._controller.step(now, belief, hindrance)
        is_pose_fault = pose_fault is not None and output.reason == hindrance
        self.is_lost = output.is_lost or is_pose_fault
        if output.state is GoalState.HELD:
            return self._hold(output.reason, now, self._controller.patience)
        if output.state is not GoalState.DRIVING:
            return self._stand(output.state, output.reason, now)
        if self.state is not GoalState.DRIVING:
            self._enter(GoalState.DRIVING, "", now)
        self.reason = output.reason
        self._twist = self._limits.accelerated(self._twist, output.twist, dt)
        return self._twist

    def hindrance(self, now: float, belief: Belief, faults: tuple[Fault, ...] = ()) -> Fault | None:
        """Return why the robot could not drive at `now` [s]; None if it could."""
        return faults[0] if faults else self._pose_fault(now, belief)

    def _pose_fault(self, now: float, belief: Belief) -> Fault | None:
        """Return why the pose is not good enough for driving; None if it is."""
        limits = self._limits
        if self._controller is not None and self._controller.by_odometry:
            return None if belief.pose is not None else Fault("no odometry")
        if belief.pose is None or belief.covariance is None:
            return Fault(f"lost, no pose: {belief.status.value}")
        if belief.status is not Status.LOCALISED and now - self._localised_at > limits.coast:
            return Fault(f"lost, not localised: {belief.status.value}", now - self._localised_at)
        sigma, limit = position_sigma(belief.covariance), limits.largest_sigma
        if self._uncertain.is_active(not sigma <= limit, now):
            return Fault(f"lost, too uncertain: sigma of more than {limit:g} m", sigma)
        return None

    def _hold(self, why: str, now: float, patience: float) -> Twist:
        """Stop at once, and give up after `patience` [s]."""
        if self.state is GoalState.HELD and now - self._since > patience:
            return self._stand(GoalState.FAILED, why, now)
        if self.state is GoalState.HELD:
            self.reason, self._twist = why, STAND
            return STAND
        return self._stand(GoalState.HELD, why, now)

    def _stand(self, state: GoalState, reason: str, now: float) -> Twist:
        self._twist = STAND
        self._enter(state, reason, now)
        return STAND

    def _enter(self, state: GoalState, reason: str, now: float) -> None:
        self.state, self.reason, self._since = state, reason, now
