"""A robot's panoramic camera in a room: pictures at home and on the way."""

from __future__ import annotations

import numpy as np

from homeward.errors import InputError
from homeward.geometry.frames import Pose, compose
from homeward.lab.simulation.render.rays.raycast import Viewpoint, viewpoint
from homeward.lab.simulation.render.room.furnish import furnished
from homeward.lab.simulation.render.room.settings import RenderScenario
from homeward.lab.simulation.render.scene import build_scene
from homeward.lab.simulation.render.shading.picture import PixelTruth, picture, pixel_truth
from homeward.lab.simulation.world import Stream

ROBOT_RADIUS = 0.15
"""The robot must keep so far from boxes and walls [m]."""


class Eye:
    """The camera of a scenario; the same one always takes the same pictures.

    The scenario is furnished, if it is not yet. Raises `InputError` where the room has no place for
    its contents, or home is in a box.
    """

    def __init__(self, scenario: RenderScenario) -> None:
        self.scenario = furnished(scenario)
        self.then = build_scene(self.scenario, at_home=True)
        """The room when home was stored."""
        self.now = build_scene(self.scenario)
        """The room during the drive."""
        if thing := self.then.blocked(scenario.home.x, scenario.home.y):
            raise InputError(f"home: in {thing}")

    @property
    def home_view(self) -> Viewpoint:
        """Where the camera was when home was stored."""
        mount = self.scenario.home_mount.pose
        return self._view(compose(self.scenario.home.pose, mount), 0)

    def home_picture(self, turned: float = 0.0, number: int = 0) -> np.ndarray:
        """Return the picture that home stored, (height, width, 3), blue green red.

        Or another one of there, of a robot that has turned by so much [rad], by a `number` that no
        picture has.
        """
        scenario, mount = self.scenario, self.scenario.home_mount.pose
        robot = scenario.home.pose._replace(heading=scenario.home.heading + turned)
        view = self._view(compose(robot, mount), number)
        chance = self._chance(number)
        return picture(self.then, view, scenario.home_time, scenario.camera, chance)

    def home_truth(self) -> PixelTruth:
        """Return what each of its pixels shows."""
        scenario = self.scenario
        return pixel_truth(self.then, self.home_view, scenario.home_time, scenario.camera)

    def view(self, robot: Pose, number: int) -> Viewpoint:
        """Return where the camera is for picture `number` (from 1) of a robot in the home frame."""
        in_room = compose(self.scenario.home.pose, robot)
        return self._view(compose(in_room, self.scenario.sensor.pose), number)

    def look(self, t: float, robot: Pose, number: int) -> np.ndarray:
        """Return picture `number` (from 1), taken at `t` [s]; shape (height, width, 3).

        Raises `InputError` where the robot runs into something.
        """
        centre = compose(self.scenario.home.pose, robot)
        if thing := self.now.blocked(centre.x, centre.y, ROBOT_RADIUS):
            raise InputError(f"after {t:.1f} s the robot runs into {thing}")
        view = self.view(robot, number)
        return picture(self.now, view, t, self.scenario.camera, self._chance(number))

    def truth(self, t: float, robot: Pose, number: int) -> PixelTruth:
        """Return what each pixel of that picture shows."""
        return pixel_truth(self.now, self.view(robot, number), t, self.scenario.camera)

    def _view(self, camera: Pose, number: int) -> Viewpoint:
        settings = self.scenario.camera
        # A generator of its own: how a picture is tilted does not hang on its noise.
        shaken = np.random.default_rng([self.scenario.seed, int(Stream.TILT), number])
        roll, pitch = settings.tilt_sigma * shaken.standard_normal(2)
        tilt = settings.roll + roll, settings.pitch + pitch
        return viewpoint(camera.x, camera.y, settings.above_floor, camera.heading, *tilt)

    def _chance(self, number: int) -> np.random.Generator:
        return np.random.default_rng([self.scenario.seed, int(Stream.IMAGES), number])
