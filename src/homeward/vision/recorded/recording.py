"""Drives from camera recordings: folders of images, videos, and images in logs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from homeward.drives.drive import Drive, HomeBearing, Sightings
from homeward.drives.folder import HOME, read_home
from homeward.drives.images import VIDEOS, Images, cameras_in, read_images
from homeward.drives.ros.kinds import is_log
from homeward.drives.ros.measurements.sightings import DUPLICATE
from homeward.drives.ros.reading import read_log
from homeward.errors import InputError, naming_file
from homeward.io.reading import is_there, naming, opened
from homeward.io.table import numbers, quoted, read_csv
from homeward.vision.cameras.grey import MAX_PIXELS
from homeward.vision.cameras.image_files import read_grey
from homeward.vision.opencv import opencv
from homeward.vision.recorded.folder import (
    drive_without_images,
    home_image,
    home_images,
    see_folder,
)
from homeward.vision.recorded.settings import IMAGE_SETTINGS, settings_in
from homeward.vision.tags.front_end import TagBearings, TagFrontEnd, why_no_tags
from homeward.vision.tags.messages import tag_eye

NO_TAGS = "pictures without a tag"
NUM_EXAMINED = 10
"""Number of images that are examined for the reason if none has a tag."""


class PictureFiles:
    """The pictures that are listed in a folder's images.csv."""

    def __init__(self, folder: Path, remarks: dict[str, int]) -> None:
        self._images: Images = read_images(folder, remarks)
        self.t = self._images.t

    def __iter__(self) -> Iterator[np.ndarray]:
        return map(read_grey, self._images.files)


class Video:
    """The frames of a video file, decoded one by one.

    Their stamps [s] are in column `t` of the CSV file with the name of the video, one row per
    frame; without this file, they are those of the container. Raises `InputError` if it cannot be
    read, or the numbers of frames and stamps differ.
    """

    def __init__(self, path: Path) -> None:
        # FFmpeg would accept a URL or a pattern, too.
        with naming(path, "cannot be read"), opened(path):
            self._path = path.resolve()
        stamps = path.with_suffix(".csv")
        self.t = self._csv_stamps(stamps) if is_there(stamps) else self._container_stamps()

    def __iter__(self) -> Iterator[np.ndarray]:
        count = 0
        for count, (_, frame) in enumerate(self._frames(), 1):
            if count > self.t.size:
                break
            yield frame
        if count != self.t.size:
            rows = self.t.size
            raise InputError(f"at least {count} frames, but {rows} stamps", self._path)

    def _csv_stamps(self, path: Path) -> np.ndarray:
        table = read_csv(path, {"t": numbers})
        table.require_order()
        return table["t"]

    def _container_stamps(self) -> np.ndarray:
        t = np.array([stamp for stamp, _ in self._frames(decode=False)], float)
        if t.size > 1 and not (np.diff(t) > 0).all():
            reason = f"time stamps do not increase; give them in {self._path.stem}.csv (column t)"
            raise InputError(reason, self._path)
        return t

    def _frames(self, decode: bool = True) -> Iterator[tuple[float, Any]]:
        """Yield stamps [s] and frames."""
        cv2 = opencv()
        video = cv2.VideoCapture(str(self._path), cv2.CAP_FFMPEG)
        try:
            size = [video.get(k) for k in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)]
            if not video.isOpened() or not 0 < size[0] * size[1] <= MAX_PIXELS:
                raise InputError("not a readable video", self._path)
            while video.grab():
                yield (
                    video.get(cv2.CAP_PROP_POS_MSEC) / 1e3,
                    video.retrieve()[1] if decode else None,
                )
        finally:
            video.release()


def see_recording(
    path: Path,
    on_progress: Callable[[float], None] | None = None,
    on_ready: Callable[[], None] | None = None,
    *,
    tags: str | None = None,
    topics: Path | None = None,
    force: bool = False,
) -> Drive:
    """Return the drive from images of one or several cameras, a video, or a log with pictures.

    Videos, logs and several cameras need `tags`, the family to detect instead of natural features;
    None: that in images.yaml. `topics` is for a log, as in `read_log`; the others are as in
    `see_folder`. `InputError` if it is none of these, or as in `see_folder` and `see_tags`.
    """
    video = path.suffix.lower() in VIDEOS
    if not video and is_log(path):
        if tags is None:
            raise InputError("pictures in a log are only used with tags: add --tags 36h11", path)
        if on_ready is not None:
            on_ready()
        # The camera comes from CameraInfo or the topics file, as for tags detected before.
        return read_log(path, topics, on_progress, tag_eye(tags))
    if topics is not None:
        raise InputError("topics apply only to logs, not to images: omit them", path)
    if video or cameras_in(path) or tags or settings_in(path).tags:
        if on_ready is not None:
            on_ready()
        return see_tags(path, tags, on_progress)
    return see_folder(path, on_progress, on_ready, force)


def see_tags(
    path: Path, family: str | None = None, on_progress: Callable[[float], None] | None = None
) -> Drive:
    """Turn the pictures of one or several cameras into a drive.

    `path` is a folder with images.csv, a video, or a folder of cameras as in `cameras_in`. The
    camera (images.yaml) and its home image are next to images.csv or the video. odometry.csv,
    drive.yaml and truth.csv are there, too, but those of several cameras in the folder of cameras;
    so is home.csv, which replaces home images. Without either, the drive has no home bearings:
    drive.yaml may specify when the robot was at home, or a place may contain its home.

    `family` is that of the tags; None: that in images.yaml. Landmarks are the numbers of the tags;
    `on_progress` receives the fraction done, in [0, 1]. `InputError` if a file is missing or cannot
    be used, or pictures and odometry do not overlap.
    """
    places = {} if path.suffix.lower() in VIDEOS else cameras_in(path)
    cameras = [TagCamera(place, family, name) for name, place in places.items()]
    cameras = cameras or [TagCamera(path, family)]
    folder = path if places else cameras[0].folder
    stamps = {f"the images{camera.suffix}": camera.frames.t for camera in cameras}
    remarks: dict[str, int] = {}
    blind = drive_without_images(folder, stamps, remarks)
    home = _home(cameras, folder, remarks) if blind.settings.home is None else {}
    total, done, parts = sum(t.size for t in stamps.values()), 0, list[Sightings]()
    for camera in cameras:
        rows, ranges = list[tuple[float, str, float, float]](), list[float]()
        for t, seen in camera.seen():
            rows += [(t, name, b, seen.sigmas[name]) for name, b in seen.bearings.items()]
            ranges += seen.ranges.values()
            done += 1
            if on_progress is not None:
                on_progress(done / total)
        names = np.full(len(rows), camera.name, object)
        parts.append(replace(Sightings.of_rows(rows), range=np.array(ranges), camera=names))
        remarks |= {f"{what}{camera.suffix}": n for what, n in camera.remarks.items()}
    found = Sightings.joined(parts)
    found = found.rows(np.argsort(found.t, kind="stable"))
    return replace(blind, name=path.resolve().stem, sightings=found, home=home)


class TagCamera:
    """The pictures of one camera along a drive, and at home, in which tags are detected.

    `path` is a folder with images.csv, or a video; `name` is empty for the only camera of a robot.
    `InputError` as in `see_tags`.
    """

    def __init__(self, path: Path, family: str | None, name: str = "") -> None:
        video = path.suffix.lower() in VIDEOS
        self.folder, self.name = path.parent if video else path, name
        self.settings, self.remarks = settings_in(self.folder), dict[str, int]()
        family = family or self.settings.tags
        if name and family is None:
            reason = "pictures of several cameras are only used with tags: add --tags 36h11"
            raise InputError(f"{reason}, or tags: 36h11 to {IMAGE_SETTINGS}", self.folder)
        if name and "camera" not in self.settings.model_fields_set:
            reason = "no calibration of this camera; set camera: {file: FILE} in it"
            raise InputError(reason, self.folder / IMAGE_SETTINGS)
        size = self.settings.tag_size
        self._family = family or "36h11"
        self._eye = TagFrontEnd(self.settings.camera, self._family, size)
        self._shape: tuple[int, ...] | None = None
        """Height and width of the first image [px]: a calibration is of one size."""
        self.frames = Video(path) if video else PictureFiles(path, self.remarks)
        if not self.frames.t.size:
            raise InputError("it contains no pictures", path)

    @property
    def suffix(self) -> str:
        """The name as the end of messages; empty for the only camera."""
        return f" of camera {quoted(self.name)}" if self.name else ""

    @property
    def home_image(self) -> Path | None:
        """The file of the home image; None without one."""
        found = home_images(self.folder, self.settings)
        return home_image(self.folder, self.settings) if found else None

    def home(self, place: Path) -> dict[str, HomeBearing]:
        """Return the home bearings from the home image `place`."""
        with naming_file(place):
            seen = self._see(read_grey(place)).home
        return {name: replace(bearing, camera=self.name) for name, bearing in seen.items()}

    def seen(self) -> Iterator[tuple[float, TagBearings]]:
        """Yield the stamp [s] and the tags of each picture; `remarks` counts those left out."""
        counts: Counter[str] = Counter()
        number, without = len(self.frames.t), list[np.ndarray]()
        for k, (t, frame) in enumerate(zip(self.frames.t.tolist(), self.frames, strict=True)):
            with naming_file(Path(f"picture{self.suffix} at {t:g} s")):
                seen = self._see(frame)
            counts[DUPLICATE] += len(seen.tags.twice)
            counts[NO_TAGS] += not seen.bearings
            if counts[NO_TAGS] > k and k % (1 + number // NUM_EXAMINED) == 0:
                without.append(frame)
            yield t, seen
        if counts[NO_TAGS] == number and (why := self.why_no_tags(without)):
            counts[f"{NO_TAGS}: {why}"] = counts.pop(NO_TAGS)
        self.remarks |= {reason: count for reason, count in counts.items() if count}

    def _see(self, image: np.ndarray) -> TagBearings:
        """Return the tags of an image; `InputError` if its size is not that of the others."""
        shape = image.shape[:2]
        self._shape = self._shape or shape
        if shape != self._shape:
            (height, width), (first_height, first_width) = shape, self._shape
            raise InputError(
                f"{width}x{height} pixels, but the image before has {first_width}x{first_height}:"
                " a camera and its calibration have one size"
            )
        return self._eye.see(image)

    def why_no_tags(self, images: Iterable[np.ndarray]) -> str | None:
        """Return why there is no tag in some images, and what to do; None if it is not evident."""
        reasons = (why_no_tags(image, self.settings.camera, self._family) for image in images)
        return next(filter(None, reasons), None)


def _home(
    cameras: Sequence[TagCamera], folder: Path, remarks: dict[str, int]
) -> dict[str, HomeBearing]:
    """Return the home bearings from the home images or else from home.csv; empty without both.

    Of a landmark in the home images of several cameras, the most accurate bearing counts.
    """
    images = {image: camera for camera in cameras if (image := camera.home_image) is not None}
    if not images:
        return read_home(folder / HOME, remarks) if is_there(folder / HOME) else {}
    home = dict[str, HomeBearing]()
    for image, camera in images.items():
        for name, seen in camera.home(image).items():
            if name not in home or seen.sigma < home[name].sigma:
                home[name] = seen
    if not home:
        why = camera.why_no_tags(map(read_grey, images))
        raise InputError("no tag in the home image", image, advice=why)
    for camera in cameras:
        if camera not in images.values():
            remarks[f"camera without a home image: {quoted(camera.name)}"] = 1
    return home
