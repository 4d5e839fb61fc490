"""A simulated robot to play against: it senses as time goes on, and drives as it is told."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from homeward.control.following import STAND
from homeward.geometry.frames import Pose, Twist, advance
from homeward.lab.simulation.scenario import Scenario
from homeward.lab.simulation.sensing import Camera, Wheels
from homeward.lab.simulation.simulate import prepare
from homeward.lab.simulation.world import build_world


class Sensed(NamedTuple):
    """What the robot's sensors say at one time."""

    t: float
    """[s]"""
    twist: Twist
    """By its wheels."""
    seen: Mapping[str, float] | None
    """Id to bearing from the camera's axis [rad]; None where the camera did not look."""


class LiveRobot:
    """A robot in a scenario, at its start, of which only the trajectory is not driven.

    Rates are the scenario's, its jitter left out. A command that is not repeated in time ends.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.view = scenario.view
        """Of the camera [rad]."""
        self.turns = scenario.trajectory.spin is not None
        """Whether home is where it begins, and is stored by a turn."""
        self.drive = prepare(scenario)
        """Before it begins: home and settings, no samples."""
        self.world = build_world(scenario)
        self.t = 0.0
        """[s]"""
        self.pose = scenario.start.in_home_frame(scenario.home.pose)
        """True, in the home frame; for scoring alone."""
        self._home = self.pose if self.turns else Pose(0.0, 0.0, 0.0)
        self.period = 1.0 / scenario.rates.odometry
        """Of `step` [s]."""
        self._looks = 1.0 / scenario.rates.bearings
        self._steps = self._looked = 0
        self._wheels, self._camera = Wheels(scenario), Camera(scenario, self.world)
        self._command, self._until = STAND, -math.inf

    @property
    def distance(self) -> float:
        """True distance from home [m]."""
        return math.hypot(self.pose.x - self._home.x, self.pose.y - self._home.y)

    def command(self, twist: Twist, hold: float) -> None:
        """Drive by `twist` from the next step on, for `hold` [s]."""
        self._command, self._until = twist, self.t + hold

    def step(self) -> Sensed:
        """Say what is sensed now, and drive on until it is time for that again."""
        twist = self._command if self.t < self._until else STAND
        seen = None
        if self.t >= self._looked * self._looks - 1e-9:
            seen, self._looked = self._camera.look(self.pose), self._looked + 1
        sensed = Sensed(self.t, self._wheels.measure(twist), seen)
        self.pose = Pose(*map(float, advance(self.pose, twist, self.period)))
        self._steps += 1
        self.t = round(self._steps * self.period, 6)
        return sensed

    def sense_by(self, scenario: Scenario) -> None:
        """Sense as another scenario has it from now on; landmarks, home and rates stay."""
        self._wheels, self._camera = Wheels(scenario), Camera(scenario, self.world)

    def move_landmark(self, name: str, dx: float, dy: float) -> None:
        """Move a landmark by so much, in room coordinates [m]."""
        self.world.places[self.world.ids.index(name)] += (dx, dy)
