"""Features of a panorama: SIFT with RootSIFT descriptors, and Shi-Tomasi corners."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from homeward.errors import InputError, naming_file
from homeward.vision.cameras.grey import Mask, as_grey, require_like_home
from homeward.vision.cameras.image_files import read_grey, read_mask
from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.features.patch_alignment import Pyramid, enlarged
from homeward.vision.opencv import opencv

CONTRAST = 0.02
"""SIFT's contrast threshold: lower than OpenCV's 0.04, since bare rooms have weak corners."""
MAX_FEATURES = 5000
"""Only the strongest features are kept, since matching time grows with their square. Rooms have up
to 2,000 with 2048 columns; noise has ten times as many."""
MIN_COLUMNS = 360
"""Smaller panoramas are enlarged, since SIFT needs some pixels around a feature: at 3 deg per pixel
it finds twenty times as many in the enlargement."""
CORNER_SIZE, CORNER_APART = 3.0, 5.0
"""Diameter of a corner's patch, and minimum distance of two corners [px of the enlargement]."""
MIN_CORNER = 0.01
"""Minimum corner response (smaller eigenvalue), as a share of that of the strongest corner."""


@dataclass(frozen=True)
class Features:
    """The features of one panorama, and its image pyramid. All arrays have n rows."""

    shape: tuple[int, int]
    """Height and width of the panorama [px]."""
    axis: float
    """Position of azimuth 0, as a share of the width from the left edge."""
    column: np.ndarray
    row: np.ndarray
    size: np.ndarray
    """Diameter of a feature's patch [px]."""
    angle: np.ndarray
    """Orientation of the patch, clockwise from the right [rad]."""
    azimuth: np.ndarray
    """In the level camera's frame [rad]."""
    elevation: np.ndarray
    """[rad]"""
    sigma: np.ndarray
    """Standard deviation of either angle [rad]."""
    descriptor: np.ndarray
    """(n, 128) float32, unit length (RootSIFT)."""
    pyramid: Pyramid
    """The panorama itself, for patch alignment."""
    mask: Mask | None
    """Usable pixels; None: all of them."""

    def __len__(self) -> int:
        return self.column.size

    @cached_property
    def patches(self) -> tuple[np.ndarray, np.ndarray]:
        """Patches that can be aligned: features and corners, one at each position.

        Column, row and diameter of each (k, 3) [px], and the index of the patch of each feature
        (n,).
        """
        every = np.vstack([np.column_stack([self.column, self.row, self.size]), self.corners()])
        place = every[:, :2].round() @ [1, 1j]
        _, first, of = np.unique(place, return_index=True, return_inverse=True)
        return every[first], of[: len(self)]

    def corners(self) -> np.ndarray:
        """Return corners: column, row and diameter, (m, 3) [px].

        Their patches can be located accurately in another panorama (Shi and Tomasi, "Good features
        to track", CVPR 1994), but have no descriptor for matching.
        """
        grey, times = self.pyramid.levels[0], self.pyramid.times
        pad = self.pyramid.margin // times
        used = None
        if self.mask is not None:
            # The strongest corner, to which others are compared, must not be a masked one.
            clear = np.pad(self.mask.clear(CORNER_SIZE / times), [(0, 0), (pad, pad)], mode="wrap")
            used = np.kron(clear, np.ones((times, times), np.uint8))
        found = opencv().goodFeaturesToTrack(
            grey, 0, MIN_CORNER, CORNER_APART, mask=used, blockSize=5
        )
        if found is None:
            return np.zeros((0, 3))
        place, inside = _on_panorama(found[:, 0].astype(float), times, pad, self.shape[1])
        return np.insert(place[inside], 2, CORNER_SIZE / times, axis=1)


def extract(image: np.ndarray, camera: Panorama, mask: Mask | None = None) -> Features:
    """Find the features of a panorama, an image in any format of `as_grey`.

    `mask` excludes pixels that show the robot. `InputError` if it is no picture, or the mask has
    another shape.
    """
    image = as_grey(image)
    height, width = image.shape
    times = math.ceil(MIN_COLUMNS / width)
    if mask is not None and mask.room.shape != image.shape:
        (rows, columns), whole = mask.room.shape, f"{width}x{height}"
        raise InputError(f"a mask of {columns}x{rows} pixels for a panorama of {whole}")
    found = _detect(image, times)
    if mask is not None:
        kept = mask.clear_at(*found[:3])
        found = tuple(part[kept] for part in found)
    column, row, size, angle, descriptor = found
    azimuth, elevation = camera.directions(column, row, (height, width))
    sigma = pixel_sigma(size) * camera.column_angle(width)
    return Features(
        (height, width),
        camera.axis,
        column,
        row,
        size,
        angle,
        azimuth,
        elevation,
        sigma,
        descriptor,
        Pyramid.of(image, times),
        mask,
    )


def read_features(
    path: Path, camera: Panorama, like: Features | None = None, mask: Path | None = None
) -> tuple[np.ndarray, Features]:
    """Read an image as `read_grey`; return its panorama, uint8 (height, width), and the features.

    With the features of home, `like`, the panorama must have the same size and gets the same mask;
    `mask` is the file for home's picture. Raises `InputError` if a file cannot be read, or its size
    does not suit the camera, home or the picture.
    """
    grey = read_grey(path)
    with naming_file(path):
        panorama = camera.panorama(grey)
        if like is not None:
            require_like_home((panorama.shape[0], panorama.shape[1]), like.shape)
    masked = like.mask if like is not None else camera.seen
    if mask is not None:
        masked = read_mask(mask, camera, grey.shape)
    return panorama, extract(panorama, camera, masked)


def pixel_sigma(size: np.ndarray) -> np.ndarray:
    """Return the standard deviation of the position of a SIFT feature of diameter `size` [px]."""
    return 0.14 + 0.04 * size


def _detect(image: np.ndarray, times: int) -> tuple[np.ndarray, ...]:
    """Return columns, rows, sizes [px], angles and descriptors; the panorama wraps round."""
    cv2, width = opencv(), image.shape[1]
    pad = max(16, width // 32)
    padded = cv2.copyMakeBorder(image, 0, 0, pad, pad, cv2.BORDER_WRAP)
    # Without the precise upscale every keypoint has an error of a quarter of a pixel.
    sift = cv2.SIFT_create(
        nfeatures=MAX_FEATURES, contrastThreshold=CONTRAST, enable_precise_upscale=True
    )
    points, found = sift.detectAndCompute(enlarged(padded, times), None)
    if not points:
        return *np.zeros((4, 0)), np.zeros((0, 128), np.float32)
    # Arandjelovic and Zisserman, "Three things everyone should know ...", CVPR 2012.
    found = np.sqrt(found / np.maximum(found.sum(axis=1, keepdims=True), 1e-9))
    rows = np.array([(*p.pt, p.size, p.angle) for p in points])
    rows[:, :2], inside = _on_panorama(rows[:, :2], times, pad, width)
    rows[:, 2] /= times
    column, row, size, degrees = rows[inside].T
    return column, row, size, np.radians(degrees), found[inside]


def _on_panorama(
    places: np.ndarray, times: int, pad: int, width: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return column and row [px] of positions, (n, 2), in the padded, then enlarged image.

    And which of them, (n,), are not in the padding, which repeats other columns.
    """
    on = (places + 0.5) / times - [0.5 + pad, 0.5]
    return on, (on[:, 0] >= -0.5) & (on[:, 0] < width - 0.5)
