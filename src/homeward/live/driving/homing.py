"""Driving on a robot, and turning: only where that is safe, and saying why where it is not."""

from __future__ import annotations

import math
from typing import NamedTuple

from homeward.angles import wrap
from homeward.control import Twist
from homeward.estimator import Status
from homeward.frames import position_sigma
from homeward.live.driving.goals import STAND, Belief, Drive, Goal, State, Step
from homeward.live.driving.watchdog import Fault, Lasting
from homeward.live.settings import Limits

AFTERWARDS_S = 1.0
"""So long after the end the robot is told to stand, and then left to others [s]."""
LONGEST_STEP_S = 0.1
"""Between two commands no more time counts for acceleration [s]."""
ROUND = 1.05 * math.tau
"""Odometry that nobody calibrated may turn by 5 % less than it says [rad]."""
RATE = 0.5
"""A camera of 60 degrees at 15 Hz sees each landmark thirty times then [rad/s]."""


class Homing:
    """Drives to a goal, home or another one, within limits.

    Time is of a steady clock [s], and not read here.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.state, self.reason = State.IDLE, ""
        self.value: float | None = None
        """The number that goes with the reason, if any."""
        self._goal: Goal | None = None
        self._drive: Drive | None = None
        """To the goal; None until that is known."""
        self._twist, self._last = STAND, -math.inf
        self._since = -math.inf
        """When the state began."""
        self._sure = -math.inf
        """When the robot was localised last."""
        self._uncertain = Lasting()

    @property
    def active(self) -> bool:
        """Whether it is on its way."""
        return self.state in (State.DRIVING, State.HELD)

    def go(self, now: float) -> None:
        """Begin to drive, as soon as `aim` tells where to."""
        self._goal = self._drive = None
        self._twist, self._sure, self.value = STAND, -math.inf, None
        self._enter(State.HELD, "", now)

    def aim(self, goal: Goal | None) -> None:
        """Take where to drive to; another object is another drive."""
        if goal is not self._goal:
            self._goal, self._drive = goal, None if goal is None else goal.drive(self._limits)

    def fail(self, reason: str, now: float) -> None:
        """Stand, and give up."""
        if self.active:
            self.value = None
            self._stand(State.FAILED, reason, now)

    def command(self, now: float, belief: Belief, faults: tuple[Fault, ...]) -> Twist | None:
        """Return the command at `now`, or None where the robot is left to others.

        Parameters
        ----------
        now : float
            [s]
        belief : Belief
            Where the robot is.
        faults : tuple of Fault
            Faults of the sensors.
        """
        dt, self._last = min(now - self._last, LONGEST_STEP_S), now
        if belief.status is Status.LOCALISED:
            self._sure = now
        if not self.active:
            over = self.state is State.IDLE or now - self._since > AFTERWARDS_S
            return None if over else STAND
        found = faults[0] if faults else self._doubt(now, belief)
        hindrance, self.value = found or ("", None)
        if self._drive is None:
            return self._hold(hindrance, now, self._limits.patience)
        step = self._drive.step(now, belief, hindrance)
        if step.state is State.HELD:
            return self._hold(step.reason, now, self._drive.patience)
        if step.state is not State.DRIVING:
            return self._stand(step.state, step.reason, now)
        if self.state is not State.DRIVING:
            self._enter(State.DRIVING, "", now)
        self.reason, self._twist = step.reason, self._limited(step.twist, dt)
        return self._twist

    def _doubt(self, now: float, belief: Belief) -> Fault | None:
        """Return why the pose is not one to drive by; None where it is."""
        limits = self._limits
        if belief.pose is None or belief.covariance is None:
            return Fault(f"lost, no pose: {belief.status.value}")
        if belief.status is not Status.LOCALISED and now - self._sure > limits.coast:
            return Fault(f"lost, not localised: {belief.status.value}", now - self._sure)
        sigma, largest = position_sigma(belief.covariance), limits.largest_sigma
        if self._uncertain.holds(not sigma <= largest, now):
            return Fault(f"lost, too uncertain: sigma of more than {largest:g} m", sigma)
        return None

    def _hold(self, why: str, now: float, patience: float) -> Twist:
        """Stand at once; after a while give up."""
        if self.state is State.HELD and now - self._since > patience:
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


class Turning(Homing):
    """Turns round once, so that a camera that sees a part of home sees all of it.

    By odometry alone, within the limits of a drive home. The pose that it is told is that of the
    robot in its odometry frame.
    """

    def go(self, now: float) -> None:
        """Begin to turn."""
        super().go(now)
        self.aim(_Round())

    def _doubt(self, now: float, belief: Belief) -> Fault | None:
        return None if belief.pose is not None else Fault("no odometry")


class _Round(NamedTuple):
    """To have turned once round."""

    def drive(self, limits: Limits) -> Drive:
        """Return the turn."""
        left, last = ROUND, math.nan

        def step(now: float, belief: Belief, hindrance: str) -> Step:
            nonlocal left, last
            if hindrance or belief.pose is None:
                return Step(State.HELD, hindrance)
            heading = float(belief.pose.heading)
            if math.isfinite(last):
                left -= float(wrap(heading - last))
            last = heading
            if left <= 0.0:
                return Step(State.TURNED, "once round")
            return Step(State.DRIVING, "", Twist(0.0, min(RATE, limits.turn_rate)))

        return Drive(limits.patience, step)
