"""The loop closed by images: a picture in, bearings found in it, an estimate, a command out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from homeward.drives.cameras.camera import tilt_matrix, unit_vectors
from homeward.drives.drive import Drive, HomeBearing
from homeward.estimator import Estimator, LandmarkEstimate
from homeward.geometry.frames import Pose
from homeward.io.one_thread import one_thread
from homeward.lab.simulation.course import Driven, Log, before, drive_course
from homeward.lab.simulation.render.eye import Eye
from homeward.lab.simulation.render.rays.raycast import trace
from homeward.lab.simulation.render.shading.picture import NOTHING
from homeward.vision.cameras.panoramic import Panorama, PartialPanorama
from homeward.vision.features.detection import Features, extract
from homeward.vision.front_end import FrameBearings, FrontEnd
from homeward.vision.homing.visual_homing import VisualHoming
from homeward.vision.tags.front_end import TagFrontEnd

Keep = Callable[[float, Pose, np.ndarray], None]
"""Told of each picture: its time [s], the robot's true pose in the home frame, the picture."""


@dataclass(frozen=True)
class ImageDrive(Driven):
    """A drive through a rendered room, with what was made of the images."""

    eye: Eye
    images: int
    """How many were taken on the way."""
    landmarks: list[LandmarkEstimate]
    """What the estimator knew of each landmark at the end."""


class ImageLoop:
    """A robot at the start, with a camera, and with a front-end if its images are to steer it.

    A `blind` one only takes them. `home` is what home stored, if not what one picture shows.
    """

    def __init__(
        self, eye: Eye, blind: bool = False, home: Mapping[str, HomeBearing] | None = None
    ) -> None:
        self.eye, self._taken = eye, 0
        self.front_end: FrontEnd | TagFrontEnd | None = None
        self._home: dict[str, HomeBearing] = {}
        if not blind and eye.scenario.tags is not None:
            self.front_end = TagFrontEnd(eye.scenario.camera.known, eye.scenario.tags.family)
            stored = self.front_end.see(eye.home_picture()).home if home is None else home
            self._home = dict(stored)
        elif not blind:
            camera = panorama_of(eye)
            there = extract(camera.panorama(eye.home_picture()), camera, camera.seen)
            self.front_end = FrontEnd(there, camera)
            self._home = self.front_end.all_home_bearings()

    @property
    def drive(self) -> Drive:
        """The drive before it begins: home and settings, for making an estimator."""
        return before(self.eye.scenario, self._home, None, self.eye.scenario.view)

    @one_thread()
    def run(
        self,
        estimator: Estimator | None = None,
        keep: Keep | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> ImageDrive:
        """Drive to the end; the loop and the estimator are used up.

        The estimator, made for `drive`, steers by its pose; None: the truth steers. `keep` is given
        each picture. Raises `InputError` when the robot runs into something.
        """
        sight = estimator
        if estimator is not None and isinstance(self.front_end, FrontEnd):
            sight = VisualHoming(estimator, **self.drive.settings.robot)
        log = Log(sight, self.eye.scenario.sensor.yaw)

        def see(t: float, robot: Pose) -> None:
            self._taken += 1
            picture = self.eye.look(t, robot, self._taken)
            if keep is not None:
                keep(t, robot, picture)
            if isinstance(self.front_end, FrontEnd):
                picture = self.front_end.camera.panorama(picture)
            if self.front_end is not None:
                seen = self.front_end.see(picture)
                if isinstance(sight, VisualHoming) and isinstance(seen, FrameBearings):
                    sight.home(t, seen.home)
                log.bearings(t, seen.bearings, seen.sigmas)

        home = self.drive.home_bearings()
        ending, pose = drive_course(self.eye.scenario, log, see, home, progress)
        drive = log.fill(self.drive)
        known = [] if sight is None else sight.landmarks()
        return ImageDrive(drive, ending, pose, log.estimates, self.eye, self._taken, known)


def panorama_of(eye: Eye) -> Panorama:
    """Return the camera of a scenario as one that finds landmarks in its panoramas."""
    camera = eye.scenario.camera.known
    return camera if isinstance(camera, Panorama) else PartialPanorama.through(camera)


def moved_boxes(eye: Eye) -> dict[str, bool]:
    """Return the boxes moved since home was stored; True where home's picture shows one."""
    seen = np.unique(eye.home_truth().thing)
    shown = {eye.then.things[i] for i in seen[seen != NOTHING].tolist()}
    boxes = eye.scenario.boxes.items()
    return {name: name in shown for name, box in boxes if box.stood is not None}


def things_seen(eye: Eye, home: Features) -> list[str]:
    """Return the name of the thing on which each feature of the home view lies."""
    camera, view = eye.scenario.camera, eye.home_view
    surfaces, _ = eye.then.at(eye.scenario.home_time, view)
    tilt = tilt_matrix(camera.roll, camera.pitch)
    met = trace(surfaces, view, unit_vectors(home.azimuth, home.elevation) @ tilt).surface
    return [eye.then.things[i] for i in surfaces.thing[met].tolist()]
