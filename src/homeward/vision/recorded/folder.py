"""Drives from image folders: home's panorama, panoramas along the drive, and odometry."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from homeward.drives.drive import Drive, Sightings, Truth
from homeward.drives.folder import (
    ODOMETRY,
    SETTINGS,
    TRUTH,
    read_drive_settings,
    read_odometry,
    read_samples,
)
from homeward.drives.images import IMAGES, file_within, read_images
from homeward.drives.plausibility import OTHER_CLOCK, require_overlap
from homeward.errors import InputError, naming_file
from homeward.io.blas_threads import single_threaded_blas
from homeward.io.reading import is_there, require_folder
from homeward.odometry.history import dead_reckoning
from homeward.vision.cameras.image_files import read_grey
from homeward.vision.checks import (
    SelfOcclusion,
    SelfOcclusionDetector,
    find_mirrored,
    require_panoramas,
)
from homeward.vision.comparison import Comparison
from homeward.vision.features.detection import read_features
from homeward.vision.front_end import FrameBearings, FrontEnd
from homeward.vision.homing.visual_homing import LASTING_SIGHTINGS
from homeward.vision.recorded.estimator import ImageDrive
from homeward.vision.recorded.settings import IMAGE_SETTINGS, ImageSettings, settings_in

HOME_STEM = "home"
TESTED_SEAMS = 8
"""Number of pictures along the drive that are tested for being panoramas, as home's is."""
TESTED_MIRRORED = 3
"""Number of pictures that are compared mirrored if none matches home."""
UNLIKE = "images that match no earlier image"
RARE = f"sightings of landmarks seen fewer than {LASTING_SIGHTINGS} times"


@single_threaded_blas()
def see_folder(
    path: str | os.PathLike[str],
    on_progress: Callable[[float], None] | None = None,
    on_ready: Callable[[], None] | None = None,
    force: bool = False,
) -> ImageDrive:
    """Turn an image folder into a drive.

    Parameters
    ----------
    path : path-like
        Folder with images.csv (t [s], file), the images (JPEG or PNG), a home image, odometry.csv,
        and optionally images.yaml (`ImageSettings`), drive.yaml and truth.csv.
    on_progress : callable, optional
        Called with the fraction done, in [0, 1].
    on_ready : callable, optional
        Called before the images along the drive are processed, which takes long.
    force : bool
        Whether to accept pictures that do not look like panoramas, as `force` in images.yaml.

    Returns
    -------
    ImageDrive
        Landmarks seen at home are named h and a number, others k and a number. Its remarks count
        images without a match, rare landmarks, and matches that turn with the camera.

    Raises
    ------
    InputError
        If a file is missing or cannot be used, images and odometry do not overlap, or pictures
        are no panoramas; names file, row and fault.
    """
    folder = Path(path)
    require_folder(folder)
    if not is_there(folder / IMAGES):
        raise InputError(f"not a folder of images: it has no {IMAGES}", folder)
    settings = settings_in(folder)
    remarks: dict[str, int] = {}
    images = read_images(folder, remarks)
    if not images.files:
        raise InputError("no rows", folder / IMAGES)
    blind = drive_without_images(folder, {"the images": images.t}, remarks)
    place = home_image(folder, settings)
    camera = settings.panorama
    picture, home = read_features(place, camera, mask=settings.mask)
    if camera.seen is None and not (force or settings.force):
        with naming_file(folder):
            some = [images.files[k] for k in _evenly(images.files, TESTED_SEAMS)]
            require_panoramas([picture, *(camera.panorama(read_grey(f)) for f in some)], camera)
    if on_ready is not None:
        on_ready()
    front_end = FrontEnd(home, camera, settings.landmarks)
    headings = dead_reckoning(blind.odometry, images.t).heading
    frames, occlusion = _process_images(front_end, images.files, headings, on_progress)
    if unlike := sum(not frame.bearings for frame in frames):
        remarks[UNLIKE] = unlike
    if occlusion is not None:
        remarks[f"{occlusion.words} ({IMAGE_SETTINGS}, mask: FILE)"] = occlusion.matches
    sightings = _sightings(images.t, frames, remarks)
    compared = [frame.home for frame in frames]
    remarks |= _check_mirrored(front_end, images.files, compared)
    pictures = tuple(zip(images.t.tolist(), compared, strict=True))
    seen = {"sightings": sightings, "home": front_end.home_bearings, "pictures": pictures}
    return ImageDrive(**{**vars(blind), **seen, "remarks": remarks})


def drive_without_images(
    folder: Path, stamps: Mapping[str, np.ndarray], remarks: dict[str, int]
) -> Drive:
    """Read the drive of an image folder, without bearings and home.

    The folder has odometry.csv, and optionally drive.yaml and truth.csv; `stamps` (n,) are those of
    pictures [s], in order, by their name in messages, and `remarks` becomes the drive's. Raises
    `InputError` if a file is missing or cannot be used, or pictures and odometry do not overlap.
    """
    odometry = read_odometry(folder / ODOMETRY, remarks)
    for name, t in stamps.items():
        spans = {"the odometry": odometry.t, name: t}
        ends = {what: (float(times[0]), float(times[-1])) for what, times in spans.items()}
        require_overlap(ends, OTHER_CLOCK, folder)
    return Drive(
        name=folder.resolve().name,
        odometry=odometry,
        sightings=Sightings.of_rows(()),
        home={},
        settings=read_drive_settings(folder / SETTINGS),
        truth=read_samples(Truth, folder / TRUTH, remarks),
        remarks=remarks,
    )


def home_image(folder: Path, settings: ImageSettings) -> Path:
    """Return the file of the home image: named in the settings, or HOME_STEM in any case.

    Raises `InputError` if there is none, several candidates, or one outside the folder.
    """
    found = home_images(folder, settings)
    if len(found) != 1:
        what = "no home image" if not found else f"{len(found)} files named home"
        raise InputError(f"{what}: set home: FILE in {IMAGE_SETTINGS}", folder)
    return found[0]


def home_images(folder: Path, settings: ImageSettings) -> list[Path]:
    """Return the file named in the settings, or all candidates; errors as in `home_image`."""
    if settings.home is not None:
        return [file_within(folder, settings.home, "home", folder / IMAGE_SETTINGS)]
    found = sorted(
        f
        for f in folder.iterdir()
        if f.stem.lower() == HOME_STEM and f.suffix.lower() not in ("", ".csv", ".yaml")
    )
    return [file_within(folder, file.name, "home", folder) for file in found]


def _evenly(items: Sequence[object], number: int) -> list[int]:
    """Return the indices of at most `number` items, evenly from the first to the last."""
    return [int(k) for k in np.unique(np.linspace(0, len(items) - 1, number).astype(int))]


def _check_mirrored(
    front_end: FrontEnd, files: list[Path], compared: Sequence[Comparison | None]
) -> dict[str, int]:
    """Return a remark if no picture matches home, but one does if it is mirrored."""
    tried = [(file, seen) for file, seen in zip(files, compared, strict=True) if seen is not None]
    if front_end.camera.seen is not None or any(seen.accepted for _, seen in tried):
        return {}
    for file, seen in (tried[k] for k in _evenly(tried, TESTED_MIRRORED)):
        picture, view = read_features(file, front_end.camera, like=front_end.home)
        if words := find_mirrored(seen, picture, (front_end.home, view), front_end.camera):
            return {f"pair of pictures (home and {file.name}): {words}": 1}
    return {}


def _process_images(
    front_end: FrontEnd,
    files: list[Path],
    headings: np.ndarray,
    on_progress: Callable[[float], None] | None,
) -> tuple[list[FrameBearings], SelfOcclusion | None]:
    """Return the bearings in each image, and the self-occlusion; headings are from odometry."""
    frames, occlusion = [], SelfOcclusionDetector()
    for k, (file, heading) in enumerate(zip(files, headings.tolist(), strict=True)):
        _, view = read_features(file, front_end.camera, like=front_end.home)
        frames.append(front_end.take(view))
        occlusion.see(view, heading)
        if on_progress is not None:
            on_progress((k + 1) / len(files))
    return frames, occlusion.found


def _sightings(t: np.ndarray, frames: list[FrameBearings], remarks: dict[str, int]) -> Sightings:
    """Combine the sightings of all frames, without rarely seen landmarks."""
    times = Counter(name for frame in frames for name in frame.bearings)
    rows = [
        (stamp, name, bearing, frame.sigmas[name])
        for stamp, frame in zip(t.tolist(), frames, strict=True)
        for name, bearing in frame.bearings.items()
    ]
    kept = [row for row in rows if times[row[1]] >= LASTING_SIGHTINGS]
    if rare := len(rows) - len(kept):
        remarks[RARE] = rare
    return Sightings.of_rows(kept)
