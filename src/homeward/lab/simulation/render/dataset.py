"""Image data sets: what a robot with a panoramic camera would log, and the truth beside it."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml

from homeward.drives.drive import Drive
from homeward.drives.folder import ODOMETRY, SETTINGS, TRUTH, write_folder
from homeward.estimator import Estimator
from homeward.geometry.frames import Pose
from homeward.io.reading import naming
from homeward.io.table import write_csv
from homeward.lab.simulation.files import SCENARIO, scenario_yaml
from homeward.lab.simulation.render.eye import Eye
from homeward.lab.simulation.render.loop import ImageDrive, ImageLoop
from homeward.lab.simulation.render.scene import Scene
from homeward.lab.simulation.render.shading.picture import PixelTruth, png

IMAGES, HOME_IMAGE, THINGS = "images.csv", "home.png", "things.csv"
IMAGE_SETTINGS = "images.yaml"
PICTURES, POINTS, DRIVE = "images", "points", "drive"
"""Folders of pictures, of what their pixels show, and of what the front-end saw in them."""


def write_rendered(
    eye: Eye,
    folder: Path,
    points: bool = False,
    make_estimator: Callable[[Drive], Estimator] | None = None,
    progress: Callable[[float], None] | None = None,
) -> ImageDrive:
    """Drive through a room, and write an image data set.

    It has home.png, images.csv (t, file) and the images, images.yaml (which camera took them),
    odometry.csv, truth.csv and drive.yaml as in a drive folder, things.csv (the truth about what
    stands in the room), and scenario.yaml, which repeats it all.

    Parameters
    ----------
    eye : Eye
        The camera in its room.
    folder : Path
        An empty folder.
    points : bool
        Whether to write what each pixel shows, too: an .npz an image, of `point` (height, width,
        3) [m, home frame; z from the floor] and `thing` (height, width), a row of things.csv.
    make_estimator : callable, optional
        Makes the estimator whose pose steers, fed by the images, for a drive that has home and
        settings; what the front-end saw is written to the drive folder `DRIVE`. None: the truth
        steers.
    progress : callable, optional
        Told now and then the share of the longest duration that is done.

    Raises
    ------
    InputError
        When the robot runs into something, or the folder cannot be written.
    """
    rows: list[tuple[float, str]] = []

    def keep(t: float, robot: Pose, image: np.ndarray) -> None:
        name = f"{len(rows) + 1:06d}"
        rows.append((t, f"{PICTURES}/{name}.png"))
        (folder / PICTURES / f"{name}.png").write_bytes(png(image))
        if points:
            truth = eye.truth(t, robot, len(rows))
            _write_points(folder / POINTS / f"{name}.npz", eye, truth)

    with naming(folder, "cannot be written"):
        (folder / PICTURES).mkdir()
        (folder / HOME_IMAGE).write_bytes(png(eye.home_picture()))
        if points:
            (folder / POINTS).mkdir()
            _write_points(folder / POINTS / "home.npz", eye, eye.home_truth())
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
    """Return images.yaml: what a robot would know of its camera."""
    camera = eye.scenario.camera.known
    known = camera.model_dump(mode="json", exclude={"axis", "horizon", "row_scale"})
    tags = {} if eye.scenario.tags is None else {"tags": eye.scenario.tags.family}
    return yaml.safe_dump({"camera": known, "home": HOME_IMAGE} | tags, sort_keys=False)


def _write_logs(drive: Drive, folder: Path) -> None:
    """Write odometry, truth and settings as a drive folder has them."""
    with tempfile.TemporaryDirectory(dir=folder) as logs:
        write_folder(drive, Path(logs))
        for name in (ODOMETRY, TRUTH, SETTINGS):
            (Path(logs) / name).replace(folder / name)


def _write_points(path: Path, eye: Eye, truth: PixelTruth) -> None:
    """Write what each pixel shows, in the home frame."""
    home = eye.scenario.home
    c, s = math.cos(home.heading), math.sin(home.heading)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    local = (truth.point - [home.x, home.y, 0.0]) @ turn
    np.savez_compressed(path, point=local.astype(np.float32), thing=truth.thing.astype(np.uint16))


def _things(scene: Scene) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
    """Return header and rows of things.csv; places are in room coordinates [m]."""
    rows: list[tuple[object, ...]] = []
    for index, name in enumerate(scene.things):
        if (box := scene.scenario.boxes.get(name)) is None:
            rows.append((index, name, *[""] * 5))
        else:
            stood = ("", "") if box.stood is None else box.stood.at
            rows.append((index, name, int(box.stood is not None), *box.at, *stood))
    return ("index", "thing", "moved", "x", "y", "stood_x", "stood_y"), rows
