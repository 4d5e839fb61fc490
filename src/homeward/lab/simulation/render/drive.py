"""Camera in a rendered room, drives closed by its images, and image data sets.

The loop renders an image, extracts bearings, estimates the pose, and commands a twist.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from homeward.drives.cameras.camera import tilt_matrix, unit_vectors
from homeward.drives.drive import Drive, HomeBearing
from homeward.drives.folder import ODOMETRY, SETTINGS, TRUTH, write_folder
from homeward.errors import InputError
from homeward.estimator import Estimator, LandmarkEstimate
from homeward.geometry.frames import Pose, compose
from homeward.io.blas_threads import single_threaded_blas
from homeward.io.reading import naming
from homeward.io.table import write_csv
from homeward.lab.simulation.course import Driven, Log, before, drive_course
from homeward.lab.simulation.render.rays.raycast import Viewpoint, trace, viewpoint
from homeward.lab.simulation.render.room.settings import RenderScenario
from homeward.lab.simulation.render.scene import RoomScene, build_scene
from homeward.lab.simulation.render.shading.picture import NOTHING, picture, pixel_things, png
from homeward.lab.simulation.simulate import SCENARIO, scenario_yaml
from homeward.lab.simulation.world import Stream
from homeward.vision.cameras.panoramic import Panorama, PartialPanorama
from homeward.vision.features.detection import Features, extract
from homeward.vision.front_end import FrameBearings, FrontEnd
from homeward.vision.homing.visual_homing import VisualHoming
from homeward.vision.tags.front_end import TagFrontEnd

ROBOT_RADIUS = 0.15
"""Minimum distance of the robot's centre from boxes and walls [m]."""


class Eye:
    """Camera of a scenario; the same scenario always gives the same images.

    Raises `InputError` where home is in a box.
    """

    def __init__(self, scenario: RenderScenario) -> None:
        self.scenario = scenario
        self.then = build_scene(self.scenario, at_home=True)
        """The room when home was stored."""
        self.now = build_scene(self.scenario)
        """The room during the drive."""
        if thing := self.then.blocked(scenario.home.x, scenario.home.y):
            raise InputError(f"home: in {thing}")

    @property
    def home_view(self) -> Viewpoint:
        """Viewpoint of the camera when home was stored."""
        mount = self.scenario.home_mount.pose
        return self._view(compose(self.scenario.home.pose, mount), 0)

    def home_picture(self) -> np.ndarray:
        """Return the home image, (height, width, 3), blue green red."""
        return picture(self.then, self.home_view, self.scenario.camera, self._chance(0))

    def home_things(self) -> np.ndarray:
        """Return the object of each pixel of the home image, as `pixel_things`."""
        return pixel_things(self.then, self.home_view, self.scenario.camera)

    def view(self, robot: Pose, number: int) -> Viewpoint:
        """Return the viewpoint of image `number` (from 1) for a robot pose in the home frame."""
        in_room = compose(self.scenario.home.pose, robot)
        return self._view(compose(in_room, self.scenario.sensor.pose), number)

    def look(self, t: float, robot: Pose, number: int) -> np.ndarray:
        """Return image `number` (from 1), taken at `t` [s]; shape (height, width, 3).

        Raises `InputError` where the robot collides with a box or a wall.
        """
        centre = compose(self.scenario.home.pose, robot)
        if thing := self.now.blocked(centre.x, centre.y, ROBOT_RADIUS):
            raise InputError(
                f"after {t:.1f} s the robot runs into {thing}; change the start, path or boxes"
            )
        view = self.view(robot, number)
        return picture(self.now, view, self.scenario.camera, self._chance(number))

    def things(self, robot: Pose, number: int) -> np.ndarray:
        """Return the object of each pixel of an image, as `pixel_things`."""
        return pixel_things(self.now, self.view(robot, number), self.scenario.camera)

    def _view(self, camera: Pose, number: int) -> Viewpoint:
        settings = self.scenario.camera
        # A separate generator, so that tilt does not depend on image noise.
        tilts = np.random.default_rng([self.scenario.seed, int(Stream.TILT), number])
        roll, pitch = settings.tilt_sigma * tilts.standard_normal(2)
        tilt = settings.roll + roll, settings.pitch + pitch
        return viewpoint(camera.x, camera.y, settings.above_floor, camera.heading, *tilt)

    def _chance(self, number: int) -> np.random.Generator:
        return np.random.default_rng([self.scenario.seed, int(Stream.IMAGES), number])


Keep = Callable[[float, Pose, np.ndarray], None]
"""Called with the time [s], the robot's true pose in the home frame, and the image."""


@dataclass(frozen=True)
class ImageDrive(Driven):
    """A drive through a rendered room, with the results from its images."""

    eye: Eye
    images: int
    """Number of images taken during the drive."""
    landmarks: list[LandmarkEstimate]
    """Landmark estimates at the end."""


class ImageLoop:
    """Robot at the start, with a camera and a front-end for its images.

    If `blind`, images are rendered but not used.
    """

    def __init__(self, eye: Eye, blind: bool = False) -> None:
        self.eye, self._taken = eye, 0
        self.front_end: FrontEnd | TagFrontEnd | None = None
        self._home: dict[str, HomeBearing] = {}
        if not blind and eye.scenario.tags is not None:
            self.front_end = TagFrontEnd(eye.scenario.camera.known, eye.scenario.tags.family)
            self._home = dict(self.front_end.see(eye.home_picture()).home)
        elif not blind:
            camera = panorama_of(eye)
            there = extract(camera.panorama(eye.home_picture()), camera, camera.seen)
            self.front_end = FrontEnd(there, camera)
            self._home = self.front_end.all_home_bearings()

    @property
    def drive(self) -> Drive:
        """Home and settings without samples, to make an estimator from."""
        return before(self.eye.scenario, self._home, None, self.eye.scenario.view)

    @single_threaded_blas()
    def run(
        self,
        estimator: Estimator | None = None,
        keep: Keep | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> ImageDrive:
        """Drive to the end; neither the loop nor the estimator can be used again.

        The estimator, made for `drive`, steers the robot; None: the true pose does. `keep` receives
        each image. Raises `InputError` when the robot collides with something.
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
    """Return the camera of a scenario as a panoramic camera."""
    camera = eye.scenario.camera.known
    return camera if isinstance(camera, Panorama) else PartialPanorama.through(camera)


def moved_boxes(eye: Eye) -> dict[str, bool]:
    """Return the boxes moved since home was stored; True where the home image shows one."""
    seen = np.unique(eye.home_things())
    shown = {eye.then.things[i] for i in seen[seen != NOTHING].tolist()}
    boxes = eye.scenario.boxes.items()
    return {name: name in shown for name, box in boxes if box.stood is not None}


def things_seen(eye: Eye, home: Features) -> list[str]:
    """Return the name of the object of each feature of the home image."""
    camera, view, surfaces = eye.scenario.camera, eye.home_view, eye.then.surfaces
    tilt = tilt_matrix(camera.roll, camera.pitch)
    met = trace(surfaces, view, unit_vectors(home.azimuth, home.elevation) @ tilt).surface
    return [eye.then.things[i] for i in surfaces.thing[met].tolist()]


IMAGES, HOME_IMAGE, THINGS = "images.csv", "home.png", "things.csv"
IMAGE_SETTINGS = "images.yaml"
PICTURES, DRIVE = "images", "drive"
"""Folders of the images, and of the front-end's bearings in them."""


def write_rendered(
    eye: Eye,
    folder: Path,
    make_estimator: Callable[[Drive], Estimator] | None = None,
    progress: Callable[[float], None] | None = None,
) -> ImageDrive:
    """Drive through a room, and write an image data set.

    It has home.png, images.csv (t, file) and the images, images.yaml (the camera), odometry.csv,
    truth.csv and drive.yaml as in a drive folder, things.csv (the true objects of the room), and
    scenario.yaml, which repeats the drive. The estimator that steers by the images is made from a
    drive with home and settings; its bearings are written to the drive folder `DRIVE`. Without
    `make_estimator`, the true pose steers. `progress` receives the fraction of the maximum
    duration. Raises `InputError` when the robot collides with something, or the folder, which must
    be empty, cannot be written.
    """
    rows: list[tuple[float, str]] = []

    def keep(t: float, robot: Pose, image: np.ndarray) -> None:
        name = f"{len(rows) + 1:06d}"
        rows.append((t, f"{PICTURES}/{name}.png"))
        (folder / PICTURES / f"{name}.png").write_bytes(png(image))

    with naming(folder, "cannot be written"):
        (folder / PICTURES).mkdir()
        (folder / HOME_IMAGE).write_bytes(png(eye.home_picture()))
        loop = ImageLoop(eye, blind=make_estimator is None)
        estimator = make_estimator(loop.drive) if make_estimator else None
        made = loop.run(estimator, keep, progress)
        if estimator is not None:
            write_folder(made.drive, folder / DRIVE)
        _write_logs(made.drive, folder)
        write_csv(folder / IMAGES, ("t", "file"), rows)
        write_csv(folder / THINGS, *_things(eye.now))
        (folder / IMAGE_SETTINGS).write_text(_image_settings(eye), encoding="utf-8")
        (folder / SCENARIO).write_text(scenario_yaml(eye.scenario), encoding="utf-8")
    return made


def _image_settings(eye: Eye) -> str:
    """Return images.yaml: the camera as a robot has calibrated it."""
    camera = eye.scenario.camera.known
    known = camera.model_dump(mode="json", exclude={"axis", "horizon", "row_scale"})
    tags = {} if eye.scenario.tags is None else {"tags": eye.scenario.tags.family}
    return yaml.safe_dump({"camera": known, "home": HOME_IMAGE} | tags, sort_keys=False)


def _write_logs(drive: Drive, folder: Path) -> None:
    """Write odometry, ground truth and settings as in a drive folder."""
    with tempfile.TemporaryDirectory(dir=folder) as logs:
        write_folder(drive, Path(logs))
        for name in (ODOMETRY, TRUTH, SETTINGS):
            (Path(logs) / name).replace(folder / name)


def _things(scene: RoomScene) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
    """Return header and rows of things.csv; positions are in room coordinates [m]."""
    rows: list[tuple[object, ...]] = []
    for index, name in enumerate(scene.things):
        if (box := scene.scenario.boxes.get(name)) is None:
            rows.append((index, name, *[""] * 5))
        else:
            former = ("", "") if box.stood is None else box.stood.at
            rows.append((index, name, int(box.stood is not None), *box.at, *former))
    return ("index", "thing", "moved", "x", "y", "stood_x", "stood_y"), rows
