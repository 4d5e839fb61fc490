"""Control of the robot of a scene: keys, a homing law, the scene's path, or none."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from homeward.control.following import STAND
from homeward.control.goals import Belief
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Twist
from homeward.lab.simulation.live_robot import LiveRobot
from homeward.lab.simulation.scenario import Homing, Scenario
from homeward.lab.simulation.trajectories import Control, exact, make_control
from homeward.studio.messages import Keys, Steer
from homeward.studio.rival import Rival
from homeward.studio.scenes import with_start

KEYS_HOLD_S, KEYS_TURN = 0.4, 1.0
"""Time after which keys that are not repeated count as released [s], and their yaw rate [rad/s]."""


class Steering:
    """Source of commands for the robot of a scenario."""

    def __init__(self, scenario: Scenario, robot: LiveRobot, asked: Steer) -> None:
        self._scenario, self._robot = scenario, robot
        self._keys, self._keys_until = STAND, -math.inf
        self.steer(asked)

    def steer(self, asked: Steer) -> None:
        """Change the control, from the current pose."""
        self._control = None if asked.by in ("keys", "nobody") else self._make(asked)
        self.asked, self.done = asked, False

    def _make(self, asked: Steer) -> Control:
        now, home = with_start(self._scenario, self._robot.pose), self._robot.drive.home_bearings()
        drive = now.trajectory
        if asked.by == "law":
            drive = Homing(law=asked.law, speed=drive.speed)
        now = now.model_copy(update={"trajectory": drive, "estimator": asked.pose_source})
        return make_control(now, self._robot.pose, home)

    def hold(self, keys: Keys) -> None:
        """Set the state of the keys."""
        self._keys = Twist(self._scenario.trajectory.speed * keys.v, KEYS_TURN * keys.omega)
        self._keys_until = self._robot.t + KEYS_HOLD_S

    def twist(self, rivals: Sequence[Rival], seen: Mapping[str, float]) -> Twist:
        """Return the command now; `seen` are the last bearings by id [rad]."""
        t = self._robot.t
        if self._control is None:
            return self._keys if self.asked.by == "keys" and t < self._keys_until else STAND
        belief = self._belief(rivals)
        if belief.pose is not None:
            turn = self._scenario.sensor.yaw + belief.pose.heading
            belief = belief._replace(seen={i: float(wrap(b + turn)) for i, b in seen.items()})
        twist = self._control.twist(t, belief)
        if twist is None:
            self._control, self.done = None, True
        return twist or STAND

    def _belief(self, rivals: Sequence[Rival]) -> Belief:
        """Return the estimate for the control."""
        for rival in rivals:
            if rival.name == self.asked.pose_source:
                estimate = rival.estimate
                return Belief(estimate.status, estimate.pose, estimate.covariance)
        return exact(self._robot.pose)
