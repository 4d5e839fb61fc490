"""Drives of what a camera recorded: folders of images, videos, and images in logs."""

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
from homeward.drives.ros.measurements.bearings import TWICE
from homeward.drives.ros.reading import read_log
from homeward.errors import InputError, naming_file
from homeward.io.reading import is_there, naming, opened
from homeward.io.table import numbers, read_csv
from homeward.vision.cameras.grey import MAX_PIXELS
from homeward.vision.cameras.image_files import read_grey
from homeward.vision.opencv import opencv
from homeward.vision.recorded.folder import (
    drive_beside,
    home_image,
    home_images,
    see_folder,
)
from homeward.vision.recorded.settings import ImageSettings, settings_in
from homeward.vision.tags.front_end import TagFrontEnd
from homeward.vision.tags.messages import tag_eye

NO_TAGS = "pictures without a tag"
VIDEOS = (".mp4", ".mkv", ".avi", ".mov", ".m4v", ".webm")
"""Endings of the names of videos."""


class PictureFiles:
    """The pictures that a folder's images.csv names."""

    def __init__(self, folder: Path, remarks: dict[str, int]) -> None:
        self._images: Images = read_images(folder, remarks)
        self.t = self._images.t

    def __iter__(self) -> Iterator[np.ndarray]:
        return map(read_grey, self._images.files)


class Video:
    """The frames of a video file, decoded one by one.

    Their stamps [s] are a column `t` of the CSV file that is called as the video is, a row a frame;
    or what the container tells.

    Raises
    ------
    InputError
        When it cannot be read, or has other frames than stamps.
    """

    def __init__(self, path: Path) -> None:
        # FFmpeg would take an address or a pattern for a name, too.
        with naming(path, "cannot be read"), opened(path):
            self._path = path.resolve()
        beside = path.with_suffix(".csv")
        self.t = self._told(beside) if is_there(beside) else self._container()

    def __iter__(self) -> Iterator[np.ndarray]:
        count = 0
        for count, (_, frame) in enumerate(self._frames(), 1):
            if count > self.t.size:
                break
            yield frame
        if count != self.t.size:
            rows = self.t.size
            raise InputError(f"{count} frames or more, but {rows} stamps", self._path)

    def _told(self, path: Path) -> np.ndarray:
        table = read_csv(path, {"t": numbers})
        table.require_order()
        return table["t"]

    def _container(self) -> np.ndarray:
        """Return what the container tells; from its first frame on, stamps must rise."""
        t = np.array([stamp for stamp, _ in self._frames(decode=False)], float)
        if t.size > 1 and not (np.diff(t) > 0).all():
            reason = f"stamps that do not rise; give them in {self._path.stem}.csv (t)"
            raise InputError(reason, self._path)
        return t

    def _frames(self, decode: bool = True) -> Iterator[tuple[float, Any]]:
        """Yield stamps [s] and frames."""
        cv2 = opencv()
        video = cv2.VideoCapture(str(self._path), cv2.CAP_FFMPEG)
        try:
            size = [video.get(k) for k in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)]
            if not video.isOpened() or not 0 < size[0] * size[1] <= MAX_PIXELS:
                raise InputError("not a video that can be read", self._path)
            while video.grab():
                yield (
                    video.get(cv2.CAP_PROP_POS_MSEC) / 1e3,
                    video.retrieve()[1] if decode else None,
                )
        finally:
            video.release()


def see_recording(
    path: Path,
    tell: Callable[[float], None] | None = None,
    ready: Callable[[], None] | None = None,
    *,
    tags: str | None = None,
    topics: Path | None = None,
    force: bool = False,
) -> Drive:
    """Return the drive of a folder of images, a video, or a log with pictures in it.

    Parameters
    ----------
    path : Path
        Videos and logs need tags.
    tell, ready, force
        As in `see_folder`.
    tags : str, optional
        Family of the tags that are looked for, instead of what panoramas show; None: as
        images.yaml says.
    topics : Path, optional
        Of a log, as in `read_log`.

    Raises
    ------
    InputError
        When it is none of these, or as `see_folder` and `see_tags` say.
    """
    video = path.suffix.lower() in VIDEOS
    if not video and is_log(path):
        if tags is None:
            raise InputError("of pictures in a log only tags are read: --tags 36h11", path)
        if ready is not None:
            ready()
        # The camera comes from CameraInfo or topics, as for tags that a log has already.
        return read_log(path, topics, tell, tag_eye(tags))
    if topics is not None:
        raise InputError("there are no topics to choose in images", path)
    if video or tags or settings_in(path).tags:
        if ready is not None:
            ready()
        return see_tags(path, tags, tell)
    return see_folder(path, tell, ready, force)


def see_tags(
    path: Path, family: str | None = None, tell: Callable[[float], None] | None = None
) -> Drive:
    """Turn a folder of pictures, or a video in such a folder, into a drive.

    Parameters
    ----------
    path : Path
        A folder with images.csv, or a video; next to it odometry.csv, images.yaml with the camera,
        and a home image or home.csv. Without either, the drive has no home bearings: drive.yaml
        may specify when the robot was at home, or a place has its home.
    family : str, optional
        Of the tags; None: images.yaml's.
    tell : callable, optional
        Told the fraction done, in [0, 1].

    Returns
    -------
    Drive
        Its landmarks are the numbers of the tags.

    Raises
    ------
    InputError
        When a file is missing or cannot be used, or pictures and odometry do not overlap.
    """
    video = path.suffix.lower() in VIDEOS
    folder = path.parent if video else path
    settings = settings_in(folder)
    eye = TagFrontEnd(settings.camera, family or settings.tags or "36h11")
    remarks: dict[str, int] = {}
    frames = Video(path) if video else PictureFiles(folder, remarks)
    if not frames.t.size:
        raise InputError("no pictures in it", path)
    blind = drive_beside(folder, frames.t, remarks)
    home = _home(eye, folder, settings, remarks) if blind.settings.home is None else {}
    seen = _sightings(eye, frames, remarks, tell)
    return replace(blind, name=path.resolve().stem, sightings=seen, home=home)


def _home(
    eye: TagFrontEnd, folder: Path, settings: ImageSettings, remarks: dict[str, int]
) -> dict[str, HomeBearing]:
    """Return the home bearings of the home image or, without one, of home.csv; or none."""
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
    tell: Callable[[float], None] | None,
) -> Sightings:
    """Return what all frames show; `remarks` counts what was left out."""
    rows: list[tuple[float, str, float, float]] = []
    counts: Counter[str] = Counter()
    for k, (t, frame) in enumerate(zip(frames.t.tolist(), frames, strict=True)):
        with naming_file(Path(f"picture at {t:g} s")):
            seen = eye.see(frame)
        rows += [(t, name, b, seen.sigmas[name]) for name, b in seen.bearings.items()]
        counts[TWICE] += len(seen.tags.twice)
        counts[NO_TAGS] += not seen.bearings
        if tell is not None:
            tell((k + 1) / frames.t.size)
    remarks |= {reason: count for reason, count in counts.items() if count}
    return Sightings.of_rows(rows)
