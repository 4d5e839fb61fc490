"""Image folders: home's panorama, those along a drive, and odometry, made into a drive."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from homeward.drives.drive import Drive, Sightings
from homeward.drives.folder import (
    ODOMETRY,
    SETTINGS,
    TRUTH,
    read_drive_settings,
    read_odometry,
    read_truth,
)
from homeward.drives.images import IMAGES, file_within, read_images
from homeward.drives.one_clock import OTHER_CLOCK, require_overlap
from homeward.errors import InputError, naming_file
from homeward.io.blas_threads import single_threaded_blas
from homeward.io.reading import is_there, require_folder
from homeward.odometry.dead_reckoning import dead_reckoning
from homeward.vision.cameras.image_files import read_grey
from homeward.vision.checks.camera_settings import better_settings
from homeward.vision.checks.seam import require_panoramas
from homeward.vision.checks.self_occlusion import SelfOcclusion, SelfOcclusionDetector
from homeward.vision.comparison import Comparison
from homeward.vision.features.detection import read_features
from homeward.vision.front_end import FrameBearings, FrontEnd
from homeward.vision.homing.moved_landmark_filter import LASTING
from homeward.vision.recorded.estimator import ImageDrive
from homeward.vision.recorded.settings import IMAGE_SETTINGS, ImageSettings, settings_in

HOME_STEM = "home"
TESTED_SEAMS = 8
"""So many pictures along the drive, and home's, are tested for being panoramas."""
TESTED_SETTINGS = 3
"""Where no picture is like home, other camera settings are tried on so many."""
UNLIKE = "images that match none before them"
RARE = f"sightings of landmarks seen fewer than {LASTING} times"


@single_threaded_blas()
def see_folder(
    path: str | os.PathLike[str],
    progress: Callable[[float], None] | None = None,
    ready: Callable[[], None] | None = None,
    force: bool = False,
) -> ImageDrive:
    """Turn an image folder into a drive.

    Parameters
    ----------
    path : path-like
        Folder with images.csv (t [s], file), the images (JPEG or PNG), a home image, odometry.csv,
        and perhaps images.yaml (`ImageSettings`), drive.yaml and truth.csv as in a drive folder.
    progress : callable, optional
        Told the fraction done, in [0, 1].
    ready : callable, optional
        Called when everything but the images along the drive is read: looking at them takes long.
    force : bool
        Whether pictures are taken that look like no panoramas; images.yaml may say so, too.

    Returns
    -------
    ImageDrive
        Landmarks seen at home are called h and a number, others k and a number. Its remarks count
        images that were like nothing seen before, what was left out, and matches that turn with the
        camera, as what belongs to the robot does.

    Raises
    ------
    InputError
        When a file is missing or cannot be used, images and odometry do not overlap, or pictures
        are no panoramas; names file, row and what is wrong.
    """
    folder = Path(path)
    require_folder(folder)
    if not is_there(folder / IMAGES):
        raise InputError(f"not a folder of images: no {IMAGES} in it", folder)
    settings = settings_in(folder)
    remarks: dict[str, int] = {}
    images = read_images(folder, remarks)
    if not images.files:
        raise InputError("no rows", folder / IMAGES)
    blind = drive_beside(folder, images.t, remarks)
    place = home_image(folder, settings)
    camera = settings.panorama
    picture, home = read_features(place, camera, mask=settings.mask)
    if camera.seen is None and not (force or settings.force):
        with naming_file(folder):
            some = [images.files[k] for k in _evenly(images.files, TESTED_SEAMS)]
            require_panoramas([picture, *(camera.panorama(read_grey(f)) for f in some)], camera)
    if ready is not None:
        ready()
    front_end = FrontEnd(home, camera, settings.landmarks)
    headings = dead_reckoning(blind.odometry, images.t).heading
    glances, along = _look_at_all(front_end, images.files, headings, progress)
    if unlike := sum(not glance.bearings for glance in glances):
        remarks[UNLIKE] = unlike
    if along is not None:
        remarks[f"{along.words} ({IMAGE_SETTINGS}, mask: FILE)"] = along.matches
    sightings = _sightings(images.t, glances, remarks)
    compared = [glance.home for glance in glances]
    remarks |= _check_camera_settings(picture, front_end, images.files, compared)
    pictures = tuple(zip(images.t.tolist(), compared, strict=True))
    seen = {"sightings": sightings, "home": front_end.home_bearings, "pictures": pictures}
    return ImageDrive(**{**vars(blind), **seen, "remarks": remarks})


def drive_beside(folder: Path, t: np.ndarray, remarks: dict[str, int]) -> Drive:
    """Return what a folder tells beside its pictures: a drive without bearings and home.

    Parameters
    ----------
    folder : Path
        With odometry.csv, and perhaps drive.yaml and truth.csv.
    t : ndarray, shape (n,)
        Stamps of the pictures [s], which are looked at later, since that takes long.
    remarks : dict of str to int
        Takes what is to be said; the drive's.

    Raises
    ------
    InputError
        When a file is missing or cannot be used, or pictures and odometry do not overlap.
    """
    odometry = read_odometry(folder / ODOMETRY, remarks)
    spans = {"the odometry": odometry.t, "the images": t}
    ends = {name: (float(stamps[0]), float(stamps[-1])) for name, stamps in spans.items()}
    require_overlap(ends, OTHER_CLOCK, folder)
    return Drive(
        name=folder.resolve().name,
        odometry=odometry,
        sightings=Sightings.of_rows(()),
        home={},
        settings=read_drive_settings(folder / SETTINGS),
        truth=read_truth(folder / TRUTH, remarks),
        remarks=remarks,
    )


def home_image(folder: Path, settings: ImageSettings) -> Path:
    """Return the file of the home image: named in the settings, or HOME_STEM in whatever case.

    Raises
    ------
    InputError
        When there is none, more than one could be it, or it lies outside the folder.
    """
    found = home_images(folder, settings)
    if len(found) != 1:
        what = "no home image" if not found else f"{len(found)} files named home"
        raise InputError(f"{what}: name it in {IMAGE_SETTINGS} (home: FILE)", folder)
    return found[0]


def home_images(folder: Path, settings: ImageSettings) -> list[Path]:
    """Return the file named in the settings, or all that may be the home image.

    Raises
    ------
    InputError
        When one lies outside the folder.
    """
    if settings.home is not None:
        return [file_within(folder, settings.home, "home", folder / IMAGE_SETTINGS)]
    found = sorted(
        f
        for f in folder.iterdir()
        if f.stem.lower() == HOME_STEM and f.suffix.lower() not in ("", ".csv", ".yaml")
    )
    return [file_within(folder, file.name, "home", folder) for file in found]


def _evenly(things: Sequence[object], number: int) -> list[int]:
    """Return the numbers of at most so many things, from the first to the last."""
    return [int(k) for k in np.unique(np.linspace(0, len(things) - 1, number).astype(int))]


def _check_camera_settings(
    home: np.ndarray,
    front_end: FrontEnd,
    files: list[Path],
    compared: Sequence[Comparison | None],
) -> dict[str, int]:
    """Return a remark where another setting suits home and the first picture like it far better.

    Of several along the drive, where none is like home. A lens is calibrated.
    """
    if front_end.camera.seen is not None:
        return {}
    tried = [(file, seen) for file, seen in zip(files, compared, strict=True) if seen is not None]
    like = [pair for pair in tried if pair[1].accepted][:1]
    for file, seen in like or [tried[k] for k in _evenly(tried, TESTED_SETTINGS)]:
        picture, view = read_features(file, front_end.camera, like=front_end.home)
        views = front_end.home, view
        if words := better_settings(seen, (home, picture), views, front_end.camera):
            return {f"pair of pictures, home and {file.name}, suggests other settings: {words}": 1}
    return {}


def _look_at_all(
    front_end: FrontEnd,
    files: list[Path],
    headings: np.ndarray,
    progress: Callable[[float], None] | None,
) -> tuple[list[FrameBearings], SelfOcclusion | None]:
    """Return what each image shows, and what turned with the camera; headings are by odometry."""
    glances, along = [], SelfOcclusionDetector()
    for k, (file, heading) in enumerate(zip(files, headings.tolist(), strict=True)):
        _, view = read_features(file, front_end.camera, like=front_end.home)
        glances.append(front_end.take(view))
        along.see(view, heading)
        if progress is not None:
            progress((k + 1) / len(files))
    return glances, along.found


def _sightings(t: np.ndarray, glances: list[FrameBearings], remarks: dict[str, int]) -> Sightings:
    """Put the sightings of all frames together, without landmarks that were seen too rarely."""
    times = Counter(name for glance in glances for name in glance.bearings)
    rows = [
        (stamp, name, bearing, glance.sigmas[name])
        for stamp, glance in zip(t.tolist(), glances, strict=True)
        for name, bearing in glance.bearings.items()
    ]
    kept = [row for row in rows if times[row[1]] >= LASTING]
    if rare := len(rows) - len(kept):
        remarks[RARE] = rare
    return Sightings.of_rows(kept)
