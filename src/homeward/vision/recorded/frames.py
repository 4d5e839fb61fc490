"""The frames of a record, one after the other: picture files, or a video."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from homeward.drives.images import Images, read_images
from homeward.drives.text.files import is_there, naming, opened
from homeward.drives.text.table import numbers, read_csv
from homeward.errors import InputError
from homeward.vision.cameras.grey import MOST_PIXELS
from homeward.vision.cameras.image_files import read_grey
from homeward.vision.opencv import opencv

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
            if not video.isOpened() or not 0 < size[0] * size[1] <= MOST_PIXELS:
                raise InputError("not a video that can be read", self._path)
            while video.grab():
                yield (
                    video.get(cv2.CAP_PROP_POS_MSEC) / 1e3,
                    video.retrieve()[1] if decode else None,
                )
        finally:
            video.release()
