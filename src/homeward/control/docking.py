"""Docking: to the pose of a home, heading included, along its axis.

The robot drives to a point behind the dock, turns to it, and follows the axis (pure pursuit of a
point a fixed distance ahead); a robot that moves sideways drives straight to the dock from anywhere
behind it, and turns meanwhile. It turns to the dock's heading, stops, and checks the pose again:
outside the tolerances it retreats and enters again. The pose is that of the localiser, from the
bearings of all landmarks in view: never from the orientation of a tag. Where the pose is not known
well enough to decide whether the robot is there, it retreats, turns once round to see the landmarks
that are not at the dock, and enters again. After that it arrives with the standard
deviations that it has.
"""

from __future__ import annotations

import enum
import math
from typing import NamedTuple

from homeward.control.goals import STAND, Belief, ControlOutput, GoalController, GoalState
from homeward.control.laws import steer
from homeward.control.limits import Limits
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, between
from homeward.geometry.statistics import PoseAccuracy

STAGING_M = 0.8
"""Distance behind the dock at which the robot turns to it: three times `AHEAD_M`, in which an
offset from the axis decays to a twentieth [m]."""
AHEAD_M = 0.25
"""Distance ahead of the point on the axis that the robot drives to [m]."""
CORRIDOR = 0.1
"""Offset from the axis over the distance to the dock with which the robot enters at once [1]."""
SLOWEST = 0.02
"""Speed at the dock [m/s]: at 20 commands a second the robot stops within 1 mm."""
TURN_GAIN = 2.0
"""Turn rate over the error of heading [1/s]."""
TOLERANCE_M, TOLERANCE_RAD = 0.008, math.radians(0.7)
"""Largest offset from the dock's pose: a goal of 1 cm and 1 degree, less the error of the pose."""
SIGMA_M, SIGMA_RAD = 0.005, math.radians(0.5)
"""Largest standard deviations of the pose at the dock: half of the goal, or 95 % within it."""
SETTLE_S = 1.0
"""Time at rest before the pose is checked [s]: some images more than one."""
MAX_ATTEMPTS = 4
"""Times that the robot enters before the drive fails."""


class Phase(enum.Enum):
    """Part of a docking."""

    STAGING = "driving behind"
    ALIGNING = "turning to"
    ENTERING = "entering"
    TURNING = "turning at"
    SETTLING = "checking the pose at"
    RETREATING = "retreating from"
    LOOKING = "looking round before"


STRAIGHT = Phase.STAGING, Phase.ALIGNING, Phase.ENTERING
"""Phases in which a robot that moves sideways drives straight."""


class DockGoal(NamedTuple):
    """Pose of a home that is to be reached with its heading."""

    name: str
    dock: Pose
    """In the frame of the belief."""

    def controller(self, limits: Limits) -> GoalController:
        """Return the controller of a docking."""
        return GoalController(limits.patience, Docking(self, limits).step)


class Docking:
    """State of one docking.

    Parameters
    ----------
    goal : DockGoal
        The dock.
    limits : Limits
        Limits of the robot.
    """

    def __init__(self, goal: DockGoal, limits: Limits) -> None:
        self._goal, self._limits = goal, limits
        self.phase = Phase.STAGING
        self._since = -math.inf
        """When the phase began [s]."""
        self._attempts = 0
        self._is_known = True
        """Whether the last check could compare the pose with the tolerances."""
        self._has_looked = False
        self._vy = 0.0
        """Speed to the left [m/s]."""
        self._turned, self._heading = 0.0, 0.0
        """Angle turned left in this phase, and the heading at the last step [rad]."""

    def step(self, now: float, belief: Belief, hindrance: str) -> ControlOutput:
        """Return the output at a time [s]; if a hindrance is given, the robot must stop."""
        if hindrance or belief.pose is None:
            return ControlOutput(GoalState.HELD, hindrance)
        there = Pose(*map(float, between(self._goal.dock, belief.pose)))
        there = there._replace(heading=float(wrap(there.heading)))
        self._turned += float(wrap(there.heading - self._heading))
        self._heading = there.heading
        if self.phase is Phase.SETTLING:
            return self._checked(now, there, belief)
        for _ in Phase:  # phases that are over already take no time
            self._vy = 0.0
            twist = self._twist(there)
            if twist is not None:
                return ControlOutput(GoalState.DRIVING, self._words, twist, vy=self._vy)
            if self._enter(self._next, now) is Phase.SETTLING:
                break
        return ControlOutput(GoalState.DRIVING, self._words, STAND)

    @property
    def _words(self) -> str:
        return f"{self.phase.value} {self._goal.name}"

    @property
    def _next(self) -> Phase:
        order = [Phase.STAGING, Phase.ALIGNING, Phase.ENTERING, Phase.TURNING, Phase.SETTLING]
        if self.phase is Phase.RETREATING and not self._is_known:
            return Phase.LOOKING
        if self.phase in (Phase.RETREATING, Phase.LOOKING):
            return Phase.ALIGNING
        return order[order.index(self.phase) + 1]

    def _enter(self, phase: Phase, now: float) -> Phase:
        self.phase, self._since, self._turned = phase, now, 0.0
        self._attempts += phase is Phase.ENTERING
        return phase

    def _twist(self, there: Pose) -> Twist | None:
        """Return the command of a phase by the pose in the dock's frame; None where it is over."""
        x, y, heading = there
        speed = self._limits.speed
        if self._limits.sideways is not None and self.phase in STRAIGHT:
            return self._strafing(there)
        match self.phase:
            case Phase.STAGING:
                is_behind = -2.0 * STAGING_M < x < -0.5 * STAGING_M
                if is_behind and abs(y) < CORRIDOR * abs(x):
                    return None
                return steer(-STAGING_M - x, -y, heading, speed, self._limits.turn_rate)
            case Phase.ALIGNING:
                error = float(wrap(self._course(y) - heading))
                return None if abs(error) < CORRIDOR else Twist(0.0, self._turn_rate(error))
            case Phase.ENTERING:
                if x > -0.5 * SLOWEST / 20.0:
                    return None
                rate = self._turn_rate(float(wrap(self._course(y) - heading)))
                return Twist(min(speed, max(SLOWEST, -0.5 * x)), rate)
            case Phase.TURNING:
                if abs(heading) < 0.5 * TOLERANCE_RAD:
                    return None
                return Twist(0.0, self._turn_rate(-heading))
            case Phase.LOOKING:
                self._has_looked = self._turned > math.tau
                return None if self._has_looked else Twist(0.0, 0.5 * self._limits.turn_rate)
            case _:
                if x < -0.5 * STAGING_M:
                    return None
                return Twist(-0.5 * speed, self._turn_rate(-heading))

    def _strafing(self, there: Pose) -> Twist | None:
        """Return the command of such a phase where the robot moves sideways; None: it is over."""
        x, y, heading = there
        off, rate = math.hypot(x, y), self._turn_rate(-heading)
        match self.phase:
            case Phase.STAGING if x > -CORRIDOR * STAGING_M:
                goal = -STAGING_M - x, -y
            case Phase.ENTERING if off > 0.25 * TOLERANCE_M:
                share = max(0.5, min(SLOWEST / off, 1.0))
                goal = -share * x, -share * y
            case _:
                return None
        v, self._vy = self._limits.towards(*goal, heading)
        return Twist(v, rate)

    def _course(self, y: float) -> float:
        """Return the heading towards the point ahead on the axis [rad]."""
        return -math.atan2(y, AHEAD_M)

    def _turn_rate(self, error: float) -> float:
        limit = self._limits.turn_rate
        return max(-limit, min(limit, TURN_GAIN * error))

    def _checked(self, now: float, there: Pose, belief: Belief) -> ControlOutput:
        """Return the output at rest at the dock."""
        if now - self._since < SETTLE_S:
            return ControlOutput(GoalState.DRIVING, self._words, STAND)
        off, turn = math.hypot(there.x, there.y), abs(there.heading)
        sigma = sigma_turn = math.inf
        if belief.covariance is not None:
            sigma, sigma_turn, _ = PoseAccuracy.of(belief.covariance)
        words = (
            f"{1e3 * off:.0f} mm and {math.degrees(turn):.1f} degrees from {self._goal.name} "
            f"(standard deviations {1e3 * sigma:.0f} mm, {math.degrees(sigma_turn):.1f} degrees)"
        )
        is_accurate = sigma <= SIGMA_M and sigma_turn <= SIGMA_RAD
        self._is_known = belief.status is Status.LOCALISED and (is_accurate or self._has_looked)
        if self._is_known and off <= TOLERANCE_M and turn <= TOLERANCE_RAD:
            return ControlOutput(GoalState.ARRIVED, words)
        if belief.status is not Status.LOCALISED:
            words += f", but {belief.status.value}"
        if self._attempts >= MAX_ATTEMPTS:
            return ControlOutput(GoalState.FAILED, f"{words} after {self._attempts} attempts")
        turns_only = self._is_known and off <= TOLERANCE_M
        self._enter(Phase.TURNING if turns_only else Phase.RETREATING, now)
        return ControlOutput(GoalState.DRIVING, self._words, STAND)
