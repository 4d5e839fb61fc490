"""Front-end for tags: AprilTags and ArUco markers of an image, their corners and bearings.

Folders, videos, logs, the ROS node and rendered drives all use it.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from homeward.drives.cameras.camera import Camera, TagSize, sizes_of, tag_bearings, tag_ranges
from homeward.drives.cameras.lens import Lens
from homeward.drives.drive import HomeBearing
from homeward.errors import InputError
from homeward.io.table import quoted
from homeward.vision.cameras.grey import as_grey
from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.opencv import opencv
from homeward.vision.tags.edges import refine_corners

MAX_SIGMA = 0.5
"""Maximum standard deviation of a tag's corners [px]: blurred tags are left out."""
AMBIGUOUS = 0.1
"""A cell nearer than this to the middle between black (0) and white (1) may be either."""


@dataclass(frozen=True)
class Tags:
    """The tags of one picture; arrays have n rows."""

    names: tuple[str, ...]
    """Their numbers."""
    corners: np.ndarray
    """(n, 4, 2), columns and rows, clockwise [px]."""
    sigma: np.ndarray
    """(n,), of each of their coordinates [px]."""
    twice: tuple[str, ...] = ()
    """Numbers that occur more than once in the picture, which are left out."""


@dataclass(frozen=True)
class TagBearings:
    """Bearings of tags in one picture."""

    bearings: dict[str, float]
    """Number of a tag to the bearing of its centre from the camera's axis [rad]."""
    sigmas: dict[str, float]
    """[rad]"""
    tags: Tags
    """The tags in the picture; those outside the lens model have no bearing."""
    ranges: dict[str, float] = field(default_factory=dict)
    """Horizontal distance of each tag with a bearing, from its size [m]; NaN: unknown."""

    @property
    def home(self) -> dict[str, HomeBearing]:
        """The bearings as home bearings, for a picture that was taken at home."""
        return {name: HomeBearing(b, self.sigmas[name]) for name, b in self.bearings.items()}


def family_of(family: str) -> Any:
    """Return OpenCV's dictionary of a family; names and errors as in `TagFrontEnd`."""
    aruco = opencv().aruco
    short = family.lower().removeprefix("tag").removeprefix("_")
    known = {n.lower(): n for n in dir(aruco) if n.startswith("DICT_")}
    name = known.get(f"dict_apriltag_{short}") or known.get(f"dict_{short}")
    if name is None:
        names = sorted({n.removeprefix("dict_").removeprefix("apriltag_") for n in known})
        raise InputError(f"unknown tag family {quoted(family)}; use one of {', '.join(names)}")
    return aruco.getPredefinedDictionary(getattr(aruco, name))


class TagFrontEnd:
    """Turns images into bearings of the tags of one family.

    OpenCV proposes tags and corrects some wrong bits. Then the edges are fitted, and the code is
    read again between them: a tag counts if its code has no error and every cell is black or white.

    >>> eye = TagFrontEnd(Lens(fx=600, fy=600, cx=320, cy=240), "36h11")
    >>> seen = eye.see(picture)
    >>> localizer.bearings(t, seen.bearings, seen.sigmas)

    Parameters
    ----------
    camera : Camera, optional
        The camera of the images; None: not known yet, and edges are assumed straight.
    family : str
        36h11, 25h9, 16h5 or 36h10 of AprilTag; 4x4_50 to 7x7_1000, aruco_original or
        aruco_mip_36h12 of ArUco.
    size : float or dict, optional
        Length of the sides of tags [m], of all or by number, for ranges.

    Raises
    ------
    InputError
        If there is no such family.
    """

    def __init__(
        self, camera: Camera | None, family: str = "36h11", size: TagSize | None = None
    ) -> None:
        aruco, self._dictionary = opencv().aruco, family_of(family)
        options = aruco.DetectorParameters()
        options.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
        self._cells = int(self._dictionary.markerSize) + 2 * options.markerBorderBits
        self._detector: Any = aruco.ArucoDetector(self._dictionary, options)
        self.camera, self.size = camera, size

    def see(self, image: np.ndarray) -> TagBearings:
        """Return the bearings of the tags in an image in any format of `as_grey`.

        Raises `InputError` if it is no image, or its size differs from that of the camera's
        calibration.
        """
        tags, camera, shape = self._find(image, self.camera)
        bearing, sigma = tag_bearings(tags.corners, tags.sigma, camera, shape)
        there = np.isfinite(bearing) & np.isfinite(sigma)
        names = [name for name, known in zip(tags.names, there, strict=True) if known]
        ranges = tag_ranges(tags.corners, sizes_of(tags.names, self.size), camera, shape)
        bearings, sigmas, far = (
            dict(zip(names, values[there].tolist(), strict=True))
            for values in (bearing, sigma, ranges)
        )
        return TagBearings(bearings, sigmas, tags, far)

    def tags(self, image: np.ndarray, camera: Camera | None) -> Tags:
        """Return the tags in an image of `camera`; errors as in `see`."""
        return self._find(image, camera)[0]

    def _find(
        self, image: np.ndarray, camera: Camera | None
    ) -> tuple[Tags, Camera, tuple[int, int]]:
        """Return the tags with the camera of their image and its height and width [px]."""
        grey = camera.panorama(image) if isinstance(camera, Panorama) else as_grey(image)
        height, width = grey.shape
        if camera is None:
            camera = Lens(fx=width, fy=width, cx=width / 2, cy=height / 2)
        if isinstance(camera, Lens):
            camera.require_shape((height, width))
        return self._detect(grey, camera), camera, (height, width)

    def _detect(self, grey: np.ndarray, camera: Camera) -> Tags:
        found, ids, _ = self._detector.detectMarkers(grey)
        if ids is None:
            return Tags((), np.empty((0, 4, 2)), np.empty(0))
        rough = np.concatenate(found).astype(float)
        corners, sigma = refine_corners(grey, rough, self._cells, camera)
        with np.errstate(invalid="ignore"):
            sharp = np.isfinite(corners).all(axis=(1, 2)) & (sigma < MAX_SIGMA)
        numbers = np.ravel(ids).tolist()
        names = [str(number) for number in numbers]
        for k in np.flatnonzero(sharp).tolist():
            sharp[k] = self._reads(grey, corners[k]) == numbers[k]
        times = Counter(names)
        rows = [k for k, name in enumerate(names) if sharp[k] and times[name] == 1]
        twice = tuple(name for name, count in times.items() if count > 1)
        return Tags(tuple(names[k] for k in rows), corners[rows], sigma[rows], twice)

    def _reads(self, grey: np.ndarray, corners: np.ndarray) -> int | None:
        """Return the number encoded between corners (4, 2), None if it is ambiguous."""
        cv2, n = opencv(), self._cells
        square = np.array([[0, 0], [n, 0], [n, n], [0, n]], np.float32)
        # Nine points in the inner half of each cell.
        place = (np.arange(n)[:, None] + np.array([0.25, 0.5, 0.75])).ravel()
        grid = np.stack(np.meshgrid(place, place), axis=-1).reshape(1, -1, 2)
        map_to = cv2.getPerspectiveTransform(square, corners.astype(np.float32))
        at = cv2.perspectiveTransform(grid, map_to).astype(np.float32)
        cells = cv2.remap(grey, at, None, cv2.INTER_LINEAR).astype(float)
        cells = cells.reshape(n, 3, n, 3).mean(axis=(1, 3))
        black = np.concatenate([cells[[0, -1]].ravel(), cells[1:-1, [0, -1]].ravel()])
        code = cells[1:-1, 1:-1]
        dark, bright = float(black.mean()), float(np.quantile(code, 0.9))
        level = (cells - dark) / max(bright - dark, 1.0)
        clear = np.abs(level - 0.5) > AMBIGUOUS
        clear[[0, -1]] = level[[0, -1]] < 0.5
        clear[:, [0, -1]] = level[:, [0, -1]] < 0.5
        bits = (level[1:-1, 1:-1] > 0.5).astype(np.uint8)
        found, number, _ = self._dictionary.identify(bits, 0.0)
        return int(number) if found and clear.all() else None
