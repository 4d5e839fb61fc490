"""Drives from camera recordings: folders of images, videos, and images in logs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from homeward.drives.drive import Drive, HomeBearing, Sightings
from homeward.drives.folder import HOME, read_home
from homeward.drives.images import Images, read_images
from homeward.drives.ros.log import is_log
from homeward.drives.ros.measurements.sighting_rows import DUPLICATE
from homeward.drives.ros.reading import read_log
from homeward.errors import InputError, naming_file
from homeward.io.reading import is_there, naming, opened
from homeward.io.table import numbers, read_csv
from homeward.vision.cameras.grey import MAX_PIXELS
from homeward.vision.cameras.image_files import read_grey
from homeward.vision.opencv import opencv
from homeward.vision.recorded.folder import (
    drive_without_images,
    home_image,
    home_images,
    see_folder,
)
from homeward.vision.recorded.settings import ImageSettings, settings_in
from homeward.vision.tags.front_end import TagFrontEnd
from homeward.vision.tags.messages import tag_eye

NO_TAGS = "pictures without a tag"
VIDEOS = (".mp4", ".mkv", ".avi", ".mov", ".m4v", ".webm")
"""File name endings of videos."""


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
    """Return the drive from a folder of images, a video, or a log that contains pictures.

    Videos and logs need `tags`, the family to detect instead of natural features; None: that in
    images.yaml. `topics` is for a log, as in `read_log`; the others are as in `see_folder`.
    `InputError` if it is none of these, or as in `see_folder` and `see_tags`.
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
    if video or tags or settings_in(path).tags:
        if on_ready is not None:
            on_ready()
        return see_tags(path, tags, on_progress)
    return see_folder(path, on_progress, on_ready, force)


def see_tags(
    path: Path, family: str | None = None, on_progress: Callable[[float], None] | None = None
) -> Drive:
    """Turn a folder of pictures, or a video in such a folder, into a drive.

    A folder has images.csv; next to it, or to a video, are odometry.csv, images.yaml with the
    camera, and a home image or home.csv. Without either, the drive has no home bearings: drive.yaml
    may specify when the robot was at home, or a place may contain its home. `family` is that of the
    tags; None: that in images.yaml. Landmarks are the numbers of the tags; `on_progress` receives
    the fraction done, in [0, 1]. `InputError` if a file is missing or cannot be used, or pictures
    and odometry do not overlap.
    """
    video = path.suffix.lower() in VIDEOS
    folder = path.parent if video else path
    settings = settings_in(folder)
    eye = TagFrontEnd(settings.camera, family or settings.tags or "36h11", settings.tag_size)
    remarks: dict[str, int] = {}
    frames = Video(path) if video else PictureFiles(folder, remarks)
    if not frames.t.size:
        raise InputError("it contains no pictures", path)
    blind = drive_without_images(folder, frames.t, remarks)
    home = _home(eye, folder, settings, remarks) if blind.settings.home is None else {}
    seen = _sightings(eye, frames, remarks, on_progress)
    return replace(blind, name=path.resolve().stem, sightings=seen, home=home)


def _home(
    eye: TagFrontEnd, folder: Path, settings: ImageSettings, remarks: dict[str, int]
) -> dict[str, HomeBearing]:
    """Return the home bearings from the home image or else from home.csv; empty without both."""
    if not home_images(folder, settings):
        return read_home(folder / HOME, remarks) if is_there(folder / HOME) else {}
    place = home_image(folder, settings)
    with naming_file(place):
        home = eye.see(read_grey(place)).home
    if not home:
        raise InputError("no tag in the home image", place)
    return home


def _sightings(
    eye: TagFrontEnd,
    frames: PictureFiles | Video,
    remarks: dict[str, int],
    on_progress: Callable[[float], None] | None,
) -> Sightings:
    """Return the sightings in all frames; `remarks` counts those left out."""
    rows, ranges = list[tuple[float, str, float, float]](), list[float]()
    counts: Counter[str] = Counter()
    for k, (t, frame) in enumerate(zip(frames.t.tolist(), frames, strict=True)):
        with naming_file(Path(f"picture at {t:g} s")):
            seen = eye.see(frame)
        rows += [(t, name, b, seen.sigmas[name]) for name, b in seen.bearings.items()]
        ranges += seen.ranges.values()
        counts[DUPLICATE] += len(seen.tags.twice)
        counts[NO_TAGS] += not seen.bearings
        if on_progress is not None:
            on_progress((k + 1) / frames.t.size)
    remarks |= {reason: count for reason, count in counts.items() if count}
    return replace(Sightings.of_rows(rows), range=np.array(ranges))
