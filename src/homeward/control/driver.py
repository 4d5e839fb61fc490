"""Driver of a robot to a goal, which stops with a reason whenever driving is not safe."""

from __future__ import annotations

import math

from homeward.control.goals import STAND, Belief, Goal, GoalController, GoalState
from homeward.control.limits import Limits
from homeward.control.watchdog import DrivingTime, Fault, FaultCheck, Faults
from homeward.estimator import Status
from homeward.geometry.frames import Twist, position_sigma

AFTERWARDS_S = 1.0
"""Time after the end of a drive for which zero commands are sent [s]."""
LOST_S = 2.0
"""A pose that comes back at rest does so within this time, before a lost robot turns [s]."""
SLOW_S, SLOW_SHARE = 0.5, 0.15
"""Without a landmark in view, or not localised, for this time [s], the robot drives at most at this
share of `limits.speed`: at the default limits it stops within 0.3 m."""
RESUME_S = 1.0
"""Minimum time between two starts of a robot that is held meanwhile [s]."""
MAX_STEP_S = 0.1
"""Maximum time step for the limits of acceleration [s]."""


class Driver:
    """Drives to a goal within limits, also that of the time without a landmark in view.

    Times are from a steady clock [s].
    """

    def __init__(self, limits: Limits, max_unseen_s: float = math.inf) -> None:
        self._limits, self._max_unseen_s = limits, max_unseen_s
        self._faults = Faults()
        self.state, self.reason = GoalState.IDLE, ""
        self.value: float | None = None
        """The measured quantity behind the reason, if any."""
        self.is_lost = False
        """Whether the robot is stopped because its pose is not good enough."""
        self._goal: Goal | None = None
        self._controller: GoalController | None = None
        """Controller of the goal; None until the goal is known."""
        self._twist, self._last = STAND, -math.inf
        self.vy = 0.0
        """Speed to the left of the last command [m/s]."""
        self._since = self._started = -math.inf
        """When the state began, and when the robot last began to drive."""
        self._unlocalised = DrivingTime(math.inf)
        """Since the robot was last localised."""
        self._accurate = limits.accuracy()
        self._looked, self._look_rate = 0.0, 0.0
        """Angle turned to see landmarks, or to find the pose, since the robot last drove [rad], and
        the rate [rad/s]."""

    @property
    def active(self) -> bool:
        """Whether a drive is in progress."""
        return self.state in (GoalState.DRIVING, GoalState.HELD)

    def go(self, now: float, goal: Goal | None = None) -> None:
        """Start a drive; without a goal, as soon as `aim` sets one."""
        self._goal = self._controller = None
        self._twist, self.value, self._last, self._looked = STAND, None, now, 0.0
        self.vy = 0.0
        self._unlocalised = DrivingTime(math.inf)
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
        """Return the command at `now` [s], or None to send none, given faults of the sensors.

        A robot without a landmark in view for too long, but without other faults, turns on the spot
        until it sees one, at most once round; so does one that has lost its pose on this drive.
        """
        self._unlocalised.add(now - self._last, self._twist, self.vy)
        dt, self._last = min(now - self._last, MAX_STEP_S), now
        if belief.status is Status.LOCALISED:
            self._unlocalised = DrivingTime(0.0)
        if not self.active:
            over = self.state is GoalState.IDLE or now - self._since > AFTERWARDS_S
            return None if over else STAND
        blind = None if faults else self._blind(now, belief)
        by_odometry = self._controller is not None and self._controller.by_odometry
        if by_odometry:
            other = Fault("no odometry") if belief.pose is None else None
        else:
            other = blind or self._pose_fault(belief)
        fault = faults[0] if faults else other
        hindrance, self.value = fault or ("", None)
        if self._controller is None:
            return self._hold(hindrance, now, self._limits.patience)
        output = self._controller.step(now, belief, hindrance)
        is_pose_fault = bool(fault) and not (faults or blind) and output.reason == hindrance
        self.is_lost = output.is_lost or is_pose_fault
        if output.state is GoalState.HELD and self._limits.search and self._looked < math.tau:
            if blind is not None and belief.pose is not None:
                return self._look(belief.back, f"{output.reason}; turning to see one", dt, now)
            if is_pose_fault and self._is_lost_for_long(now):
                return self._look(0.0, f"{output.reason}; turning to find it", dt, now)
        if output.state is GoalState.HELD:
            return self._hold(output.reason, now, self._controller.patience)
        if output.state is not GoalState.DRIVING:
            return self._stand(output.state, output.reason, now)
        if self.state is GoalState.HELD and now - self._started < RESUME_S:
            return self._hold(self.reason, now, self._controller.patience)
        if self.state is not GoalState.DRIVING:
            self._enter(GoalState.DRIVING, "", now)
            self._started = now
        self.reason = output.reason
        wanted, vy = output.twist, output.vy
        lost_s = self._unlocalised.seconds
        slow_s = max(belief.unseen_s, lost_s if math.isfinite(lost_s) else 0.0)
        if slow_s > SLOW_S and not by_odometry:
            speed = math.hypot(wanted.v, vy)
            slower = min(1.0, SLOW_SHARE * self._limits.speed / speed) if speed else 1.0
            wanted, vy = Twist(slower * wanted.v, slower * wanted.omega), slower * vy
        self._twist, self.vy = self._limits.accelerated(self._twist, wanted, dt, (self.vy, vy))
        if self._twist.v or self.vy:
            self._looked = 0.0
        return self._twist

    def _is_lost_for_long(self, now: float) -> bool:
        """Return whether the robot was localised on this drive, and is at rest or turns since."""
        was_localised = math.isfinite(self._unlocalised.seconds)
        waited = self.state is GoalState.HELD and now - self._since > LOST_S
        return was_localised and (waited or self._looked > 0.0)

    def _look(self, back: float, why: str, dt: float, now: float) -> Twist:
        """Turn on the spot by `back` [rad] and on, for the reason `why`."""
        if not self._looked:
            rate = min(self._limits.search, self._limits.turn_rate)
            self._look_rate = math.copysign(rate, back)
        if self.state is not GoalState.DRIVING:
            self._enter(GoalState.DRIVING, "", now)
        self.reason = why
        turning = Twist(0.0, self._twist.omega)
        wanted = Twist(0.0, self._look_rate)
        self._twist, self.vy = self._limits.accelerated(turning, wanted, dt)
        self._looked += abs(self._twist.omega) * dt
        return self._twist

    def hindrance(self, now: float, belief: Belief, faults: tuple[Fault, ...] = ()) -> Fault | None:
        """Return why the robot could not drive by its pose at `now` [s]; None if it could."""
        return faults[0] if faults else self._blind(now, belief) or self._pose_fault(belief)

    def _pose_fault(self, belief: Belief) -> Fault | None:
        """Return why the pose is not good enough for driving; None if it is."""
        limits = self._limits
        if belief.pose is None or belief.covariance is None:
            return Fault(f"lost, no pose: {belief.status.value}")
        since = self._unlocalised.seconds
        if belief.status is not Status.LOCALISED and since > limits.coast:
            reason = f"lost, not localised: {belief.status.value}"
            return Fault(reason, since if math.isfinite(since) else None)
        sigma = float(position_sigma(belief.covariance))
        if not self._accurate.is_met(sigma):
            limit = self._accurate.largest_sigma
            return Fault(f"lost, too uncertain: sigma of more than {limit:g} m", sigma)
        return None

    def _blind(self, now: float, belief: Belief) -> Fault | None:
        """Return the fault that the robot drove too long without a landmark in view, if it did."""
        unseen_s, limit = belief.unseen_s, self._max_unseen_s
        fault = Fault(f"no landmark in view for more than {limit:g} s", unseen_s)
        return next(iter(self._faults.active([FaultCheck(fault, unseen_s > limit)], now)), None)

    def _hold(self, why: str, now: float, patience: float) -> Twist:
        """Stop at once, and give up after `patience` [s]."""
        if self.state is GoalState.HELD and now - self._since > patience:
            return self._stand(GoalState.FAILED, why, now)
        if self.state is GoalState.HELD:
            self.reason, self._twist, self.vy = why, STAND, 0.0
            return STAND
        return self._stand(GoalState.HELD, why, now)

    def _stand(self, state: GoalState, reason: str, now: float) -> Twist:
        self._twist, self.vy = STAND, 0.0
        self._enter(state, reason, now)
        return STAND

    def _enter(self, state: GoalState, reason: str, now: float) -> None:
        self.state, self.reason, self._since = state, reason, now
