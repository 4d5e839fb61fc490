"""The loop closed by images: a picture in, bearings found in it, an estimate, a command out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from homeward.drives.cameras.lens import Lens
from homeward.drives.drive import Drive, HomeBearing
from homeward.errors import InputError
from homeward.estimator import Estimate, Estimator, LandmarkEstimate
from homeward.frames import Pose
from homeward.one_thread import one_thread
from homeward.simulation.course import Ending, before, drive_course
from homeward.simulation.log import Log
from homeward.simulation.render.eye import Eye
from homeward.vision.cameras.panoramic import Cylindrical, Equirectangular, Panorama
from homeward.vision.features.detection import View, look
from homeward.vision.front_end import FrameBearings, FrontEnd
from homeward.vision.homing.visual_homing import VisualHoming
from homeward.vision.tags.front_end import TagFrontEnd

LEAST_TILT = 0.002
"""A camera that is said not to tilt is still not trusted more than this [rad]."""


Keep = Callable[[float, Pose, np.ndarray], None]
"""Told of each picture: its time [s], the robot's true pose in the home frame, the picture."""


@dataclass(frozen=True)
class ImageDrive:
    """A drive through a rendered room."""

    eye: Eye
    drive: Drive
    """With what was made of the images, and truth in the home frame."""
    images: int
    """How many were taken on the way."""
    ending: Ending
    final_pose: Pose
    """True pose in the home frame where the drive ended."""
    estimates: list[Estimate]
    """What the estimator answered to each image in which something was found."""
    landmarks: list[LandmarkEstimate]
    """What it knew of each landmark at the end."""

    @property
    def final_distance(self) -> float:
        """True distance from home at the end [m]."""
        return math.hypot(self.final_pose.x, self.final_pose.y)


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
            self.front_end = TagFrontEnd(camera_of(eye), eye.scenario.tags.family)
            stored = self.front_end.see(eye.home_picture()).home if home is None else home
            self._home = dict(stored)
        elif not blind:
            camera = panorama_of(eye)
            self.front_end = FrontEnd(look(eye.home_picture(), camera), camera)
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
        each picture.

        Raises
        ------
        InputError
            When the robot runs into something.
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
            if self.front_end is not None:
                seen = self.front_end.see(picture)
                if isinstance(sight, VisualHoming) and isinstance(seen, FrameBearings):
                    sight.home(t, seen.home)
                log.bearings(t, seen.bearings, seen.sigmas)

        home = self.drive.home_bearings()
        ending, pose = drive_course(self.eye.scenario, log, see, home, progress)
        drive = log.fill(self.drive)
        known = [] if sight is None else sight.landmarks()
        return ImageDrive(self.eye, drive, self._taken, ending, pose, log.estimates, known)


def camera_of(eye: Eye) -> Panorama | Lens:
    """Return the camera of a scenario as the front-end knows it: its tilt, but not each shake."""
    camera = eye.scenario.camera
    tilt = {"roll": camera.roll, "pitch": camera.pitch}
    tilt["tilt_sigma"] = max(LEAST_TILT, camera.tilt_sigma)
    if camera.projection == "pinhole":
        size = {"width": camera.width, "height": camera.height}
        middle = {"cx": (camera.width - 1) / 2, "cy": (camera.height - 1) / 2}
        return Lens(fx=camera.focal, fy=camera.focal, **middle, **size, **tilt)
    kind = Equirectangular if camera.projection == "equirectangular" else Cylindrical
    return kind(**tilt)


def panorama_of(eye: Eye) -> Panorama:
    """Return `camera_of` a scenario in which landmarks are found all round.

    Raises
    ------
    InputError
        When it does not see all round.
    """
    camera = camera_of(eye)
    if not isinstance(camera, Panorama):
        raise InputError("camera.projection: a pinhole camera needs tags to come home by")
    return camera


def moved_boxes(eye: Eye) -> dict[str, bool]:
    """Return the boxes moved since home was stored; True where home's picture shows one."""
    shown = {eye.then.things[i] for i in np.unique(eye.home_truth().thing).tolist()}
    boxes = eye.scenario.boxes.items()
    return {name: name in shown for name, box in boxes if box.stood is not None}


def things_seen(eye: Eye, home: View) -> list[str]:
    """Return the name of the thing on which each feature of the home view lies."""
    truth = eye.home_truth()
    height, width = truth.thing.shape
    rows = np.clip(np.rint(home.row).astype(int), 0, height - 1)
    columns = np.rint(home.column).astype(int) % width
    return [eye.then.things[i] for i in truth.thing[rows, columns].tolist()]
