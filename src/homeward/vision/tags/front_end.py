"""Front-end for tags: AprilTags and ArUco markers of an image, their corners and bearings.

Folders, videos, logs, the ROS node and rendered drives all use it. Corners are located to
hundredths of a pixel: each edge is a plane through the camera. A straight edge in space spans a
plane with the camera's centre, for any lens distortion. At points along each edge the step from
black to white is located, the plane is fitted to these points, and neighbouring planes intersect in
the rays of the corners. The scatter of the points about their planes gives the corners' standard
deviation.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.integrate import trapezoid

from homeward.drives.cameras.camera import (
    Camera,
    TagSize,
    angles,
    sizes_of,
    tag_bearings,
    tag_ranges,
    unit_vectors,
)
from homeward.drives.cameras.lens import Lens
from homeward.drives.drive import HomeBearing
from homeward.errors import InputError
from homeward.io.table import quoted
from homeward.vision.cameras.grey import as_grey
from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.opencv import opencv

ALONG, ACROSS = 32, 13
"""Number of points along an edge, and of samples across it at each point."""
ENDS = 0.08
"""Share of an edge that is left out at each end, where the other edge is near."""
REACH = 0.5
"""Distance of samples to each side, in cells of the tag: its bits are beyond the border."""
MIN_REACH, MAX_REACH = 1.0, 4.0
"""Limits of this distance [px]."""
ITERATIONS = 3
"""The samples approach the edge with each iteration."""
MIN_CONTRAST = 12.0
"""Minimum contrast between the two sides of an edge [grey levels]."""
SYSTEMATIC = 0.03
"""Systematic error of any corner, from the size of pixels and blooming [px]."""


def refine_corners(
    image: np.ndarray, corners: np.ndarray, cells: int, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Refine the corners of tags; return them with the standard deviations of their coordinates.

    Of a grey image, or panorama, of `camera`: corners (n, 4, 2), columns and rows [px], to a pixel
    or two and clockwise in the image; `cells` is the number of cells along a tag's edge, with its
    border. Refined corners are NaN where an edge has no contrast; standard deviations are (n,)
    [px].
    """
    shape = image.shape[0], image.shape[1]
    rays = _rays(corners, camera, shape)
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=-1)
    reach = np.clip(REACH * sides.min(axis=1) / cells, MIN_REACH, MAX_REACH)
    for _ in range(ITERATIONS):
        places, off = _steps(image, rays, reach, camera)
        planes, scatter = _planes(_rays(places + off, camera, shape))
        meet = np.cross(np.roll(planes, 1, axis=1), planes)
        meet /= np.linalg.norm(meet, axis=-1, keepdims=True)
        rays = meet * np.sign(np.sum(meet * rays, axis=-1, keepdims=True))
    out = np.stack(camera.pixels(*angles(rays), shape), axis=-1)
    length = np.linalg.norm(np.diff(places, axis=2), axis=-1).sum(axis=2)
    span = np.arccos(np.clip(np.sum(rays * np.roll(rays, -1, axis=1), axis=-1), -1, 1))
    # Errors of neighbouring pixels are correlated: one point per pixel counts. A line fitted to m
    # points has, at its end, a standard deviation of twice their scatter over the root of m.
    noise = 2 * scatter * length / (span * (1 - 2 * ENDS)) / np.sqrt(np.clip(length, 4, ALONG))
    return out, np.hypot(np.sqrt(np.mean(noise**2, axis=1)), SYSTEMATIC)


def _rays(pixels: np.ndarray, camera: Camera, shape: tuple[int, int]) -> np.ndarray:
    """Return rays (..., 3) of pixels (..., 2)."""
    return unit_vectors(*camera.directions(pixels[..., 0], pixels[..., 1], shape))


def _steps(
    image: np.ndarray, rays: np.ndarray, reach: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """Return points along edges and the vector from each to the step, (n, 4, ALONG, 2) [px].

    The step is located from the area under the profile, from black 0 to white 1: without bias for
    any symmetric blur, and averaging the noise of all samples.
    """
    shape = image.shape[0], image.shape[1]
    share = np.linspace(ENDS, 1 - ENDS, ALONG)[:, None]
    along = (1 - share) * rays[:, :, None] + share * np.roll(rays, -1, axis=1)[:, :, None]
    places = np.stack(camera.pixels(*angles(along), shape), axis=-1)
    way = np.gradient(places, axis=2)
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    outwards = np.stack([way[..., 1], -way[..., 0]], axis=-1)
    step = np.linspace(-1, 1, ACROSS)
    at = (
        places[..., None, :]
        + (reach[:, None, None, None] * step)[..., None] * outwards[..., None, :]
    )
    # OpenCV's remap needs two-dimensional maps of limited size.
    sheet = at.reshape(-1, ACROSS, 2).astype(np.float32)
    rows = np.array_split(sheet, range(16384, len(sheet), 16384))
    cv2 = opencv()
    seen = [cv2.remap(image, part, None, cv2.INTER_LINEAR) for part in rows]
    values = np.concatenate(seen).astype(float).reshape(at.shape[:-1])
    # Both levels are means over the whole edge.
    dark, bright = (values[..., k].mean(axis=2)[..., None, None] for k in (0, -1))
    with np.errstate(divide="ignore", invalid="ignore"):
        level = (values - dark) / np.where(bright - dark > MIN_CONTRAST, bright - dark, np.nan)
    area = trapezoid(level, step, axis=-1)
    return places, (reach[:, None, None] * (1 - area))[..., None] * outwards


def _planes(rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit normals (n, 4, 3) of planes fitted to rays (n, 4, m, 3), and their scatter."""
    whole = np.isfinite(rays).all(axis=(2, 3))
    rays = np.where(whole[..., None, None], rays, 0.0)
    values, vectors = np.linalg.eigh(np.swapaxes(rays, -1, -2) @ rays)
    scatter = np.sqrt(np.maximum(values[..., 0], 0) / (rays.shape[2] - 2))
    return np.where(whole[..., None], vectors[..., 0], np.nan), scatter


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


OTHER_FAMILIES = "36h11", "36h10", "25h9", "6x6_250", "5x5_250", "aruco_mip_36h12"
"""Families in which chance detections are rare."""
MIN_BRIGHTNESS = 40
"""Minimum of the brightest hundredth of an image's pixels that is not dark [grey levels]."""


def why_no_tags(image: np.ndarray, camera: Camera | None, family: str) -> str:
    """Return why an image in any format of `as_grey` has no tag of a family, and what to do.

    Empty if that is not evident from the image.
    """
    grey = as_grey(image)
    if TagFrontEnd(camera, family).see(np.ascontiguousarray(grey[:, ::-1])).bearings:
        return "the images are mirrored; mirror them back"
    for other in OTHER_FAMILIES:
        if TagFrontEnd(camera, other).see(grey).bearings:
            return f"the tags are of family {other}; use --tags {other}"
    if np.quantile(grey, 0.99) < MIN_BRIGHTNESS:
        return "the images are dark; use a longer exposure, or scale their values"
    return ""


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
