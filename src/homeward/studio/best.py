"""The bound as a scene is played: how well anybody could know the pose who is told what moved."""

from __future__ import annotations

import math

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, polar_covariance_to_pose, to_polar
from homeward.lab.bounds import RunningBound
from homeward.lab.simulation.live_robot import LiveRobot
from homeward.lab.simulation.scenario import Scenario
from homeward.studio.rival import ellipse

NEAREST_M = 1e-3
"""A prior in polar coordinates says nothing of a direction nearer to home than this [m]."""


class Best:
    """The posterior Cramer-Rao bound on a robot that is driven, carried and deceived."""

    radius: float | None = None
    """One sigma of the position [m]; None where it is not fixed, or bearings have no noise."""

    def __init__(self, robot: LiveRobot, scenario: Scenario) -> None:
        self._robot, self._last = robot, (math.nan, robot.pose)
        self._bound: RunningBound | None = None
        if not scenario.noise.bearing_sigma:
            return
        world, start, errors = robot.world, scenario.start, scenario.odometry
        covariance = None
        if start.prior:
            polar = to_polar(robot.pose)._replace(R=max(math.hypot(*robot.pose[:2]), NEAREST_M))
            sigmas = start.sigma_R, start.sigma_theta, start.sigma_alpha
            covariance = polar_covariance_to_pose(polar, np.diag(np.square(sigmas)))
        self._bound = RunningBound(
            world.in_home_frame,
            bearing_sigma=scenario.noise.bearing_sigma,
            home_sigma=scenario.noise.home_sigma or scenario.noise.bearing_sigma,
            speed_sigma=errors.speed_sigma,
            turn_sigma=errors.turn_sigma,
            moved=np.array([i in world.moved or i not in robot.drive.home for i in world.ids]),
            start_covariance=covariance,
            mount=scenario.sensor.pose,
        )

    def see(self, t: float, pose: Pose, seen: set[str]) -> None:
        """Take what was seen at `t` [s] from a true pose in the home frame."""
        if self._bound is None:
            return
        world, now, (then, before) = self._robot.world, np.array(pose, float), self._last
        if math.isfinite(then):
            # The chord of so short an arc is nearly the arc.
            way = math.hypot(pose.x - before.x, pose.y - before.y)
            twist = np.array([way, wrap(pose.heading - before.heading)]) / (t - then)
            self._bound.drive(np.array(before, float), now, twist, t - then)
        self._bound.see(now, world.in_home_frame, np.array([i in seen for i in world.ids]))
        self._last = t, pose
        axes = ellipse(self._bound.covariance()[:2, :2])
        self.radius = None if axes is None else math.hypot(axes[0], axes[1])

    def carry(self) -> None:
        """Take it that the robot was carried away."""
        self._last = math.nan, self._robot.pose
        if self._bound is not None:
            self._bound.carry()

    def move(self, landmark: str) -> None:
        """Take it that a landmark was moved."""
        if self._bound is not None:
            self._bound.move(self._robot.world.ids.index(landmark))

    def sense_by(self, scenario: Scenario) -> None:
        """Take it that the camera and its noise are others now."""
        if self._bound is not None and scenario.noise.bearing_sigma:
            self._bound.bearing_sigma = scenario.noise.bearing_sigma
            self._bound.mount = scenario.sensor.pose
