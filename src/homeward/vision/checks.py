"""Checks of a camera from its own pictures: seam, self-occlusion, mirrored pictures.

Seam: whether the left and right edges of an image continue each other, as in a panorama. The edges
of a panorama are as similar as any two neighbouring columns, those of another image as different as
any two distant columns. Both distributions are learnt from the image itself. Their likelihood ratio
is an e-value: its mean over panoramas is at most 1, so that it exceeds t at most once in t
panoramas. The same holds for the mean over several images, even if they are dependent (Vovk and
Wang, "E-values: calibration, combination and applications", Annals of Statistics 2021).

Self-occlusion: image regions that turn with the camera, such as a deck, a mast or a time stamp.
When the robot turns, static objects move in the image. Features that remain in the same position
belong to the robot, or to the image itself, and should be masked.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.vision.cameras.grey import as_grey
from homeward.vision.cameras.panoramic import Panorama
from homeward.vision.comparison import Comparison, compare
from homeward.vision.features.detection import Features, extract
from homeward.vision.features.matching import match
from homeward.vision.opencv import opencv

MIN_EVIDENCE = 100.0
"""E-value above which an image is refused: at most one panorama in a hundred."""
SCALES = 360, 180
"""Images are reduced to these numbers of columns: stitched joints have errors of parts of a degree,
and an edge may be at the seam by chance."""
NOISE = 2.0
"""Standard deviation of noise [grey levels]: columns of less contrast have no information."""
MIN_BANDWIDTH = 0.02
"""Minimum bandwidth of the kernel density of correlations (Fisher's z) [1]."""
FORCE_HINT = "to use it anyway: force: true in images.yaml, or --force of see"


def require_panoramas(pictures: Sequence[np.ndarray], camera: Panorama) -> None:
    """Raise InputError, with the reason, if pictures of one camera, as specified, are no panoramas.

    They are as `Panorama.panorama` returns them, in any format of `as_grey`.
    """
    greys = [as_grey(picture) for picture in pictures]
    if greys and all(map(_two_discs, greys)):
        raise InputError(
            "two discs side by side: a double fisheye image, not a panorama; convert it to "
            f"an equirectangular one with the camera's software ({FORCE_HINT})"
        )
    if greys and np.mean([seam_evidence(grey, camera) for grey in greys]) >= MIN_EVIDENCE:
        raise InputError(
            "left and right edge do not continue each other, as in a 360 deg panorama; "
            f"is it an ordinary picture? ({FORCE_HINT})"
        )


def seam_evidence(grey: np.ndarray, camera: Panorama) -> float:
    """Return the e-value against the hypothesis that a picture's edges are a panorama's seam.

    Rows of the picture, uint8 (height, width), are weighted with the solid angle that they span.
    """
    return float(np.mean([_evidence(_correlations(grey, camera, n)) for n in SCALES]))


def _evidence(correlation: np.ndarray) -> float:
    """Return the e-value of a seam, from the correlation of all pairs of columns, (n, n)."""
    n = len(correlation)
    left, right = np.indices(correlation.shape)
    adjacent, distant = right - left == 1, np.abs(right - left - n / 2) < n / 4
    seam, near, far = correlation[-1, 0], correlation[adjacent], correlation[distant]
    unlike = _density(far, seam)
    # The seam counts as one of the pairs, so that no density is below one in their number.
    like = (near.size * _density(near, seam) + unlike) / (near.size + 1)
    return float(unlike / like) if like > 0.0 else 1.0


def _correlations(grey: np.ndarray, camera: Panorama, max_columns: int) -> np.ndarray:
    """Return the correlation of all pairs of columns, (n, n), in Fisher's z.

    Brightness has no effect. The picture is reduced to at most `max_columns` columns.
    """
    height, width = grey.shape
    if width > max_columns:
        size = max_columns, max(round(height * max_columns / width), 2)
        grey = opencv().resize(grey, size, interpolation=opencv().INTER_AREA)
    height, width = grey.shape
    _, elevation = camera.directions(np.zeros(height), np.arange(height), (height, width))
    weight = np.maximum(np.cos(elevation), 0.0)[:, None]
    # Common to all columns, such as bright sky and dark ground, is the median of each row.
    parts = grey - np.median(grey, axis=1, keepdims=True)
    parts = (parts - (weight * parts).sum(axis=0) / weight.sum()) * np.sqrt(weight)
    parts /= np.sqrt((parts**2).sum(axis=0) + weight.sum() * NOISE**2)
    return np.asarray(np.arctanh(np.clip(parts.T @ parts, -0.999, 0.999)))


def _density(samples: np.ndarray, at: float) -> float:
    """Return a kernel density estimate (Silverman's rule)."""
    quartiles = np.subtract(*np.percentile(samples, [75, 25])) / 1.34
    wide = max(0.9 * min(samples.std(), quartiles) * samples.size**-0.2, MIN_BANDWIDTH)
    near = np.exp(-0.5 * ((at - samples) / wide) ** 2).mean()
    return float(near / (wide * math.sqrt(2.0 * math.pi)))


def _two_discs(grey: np.ndarray) -> bool:
    """Return whether a picture is two discs side by side, of its height, on a plain background."""
    height, width = grey.shape
    radius = height / 2
    if abs(width / height - 2.0) > 0.1:
        return False
    row, column = np.indices(grey.shape)
    across = (column + 0.5) % (width / 2) - width / 4
    out = np.hypot(across / (width / 4), (row + 0.5 - radius) / radius)
    middle = np.abs(row + 0.5 - radius) < 0.85 * radius
    without, within = middle & (out > 1.04), middle & (out > 0.75) & (out < 0.95)
    plain = np.abs(grey - np.median(grey[without])) < 16.0
    rows = without.any(axis=1)
    outside, inside = (
        (plain & part).sum(axis=1)[rows] / np.maximum(part.sum(axis=1)[rows], 1)
        for part in (without, within)
    )
    # The share of the edge with a picture inside and plain background outside.
    return bool(np.mean(outside - inside) >= 0.8)


MIN_TURN = math.radians(30.0)
"""Minimum rotation between two compared frames [rad]."""
SAME = math.radians(0.5)
"""A match that moved by less than this [rad], or less than a pixel, has turned with the camera."""
STATIC_TOLERANCE = MIN_TURN / 2
"""Maximum error of a static match's position predicted from the rotation [rad]."""
FRAMES = 6
"""Number of earlier frames that a frame is compared with: odometry errors grow with more."""
MIN_MATCHES, MIN_SHARE = 5, 0.01
"""Minimum number of matches that turn with the camera, and minimum share of static matches.
Rendered rooms without a robot had none among 30,000, with thin legs 2 % and more."""
MIN_STATIC = 0.1
"""Minimum ratio of static matches to matches that turn with the camera: with fewer, the robot is
stuck, and odometry is wrong."""


@dataclass(frozen=True)
class SelfOcclusion:
    """Matches that turn with the camera."""

    matches: int
    """Number of matches."""
    lowest: float
    """5th percentile of their elevation [rad]."""
    highest: float
    """95th percentile of their elevation [rad]."""

    @property
    def words(self) -> str:
        """Message that follows the number of matches."""
        low, high = math.floor(math.degrees(self.lowest)), math.ceil(math.degrees(self.highest))
        return (
            f"matches at elevations of {low} to {high} deg turn with the camera: they show "
            "the robot itself, or a time stamp; add a mask"
        )


class SelfOcclusionDetector:
    """Detects self-occlusion along a drive; the rotation is taken from odometry."""

    def __init__(self) -> None:
        self._before: deque[tuple[Features, float]] = deque(maxlen=FRAMES)
        """Frames `MIN_TURN` apart, and the heading of each [rad]."""
        self._elevations: list[np.ndarray] = []
        """Elevations of matches that turned with the camera [rad]."""
        self._static = 0
        """Number of static matches."""

    def see(self, view: Features, heading: float) -> None:
        """Process the features of the next frame, with the heading from odometry [rad]."""
        if self._before and abs(wrap(heading - self._before[-1][1])) < MIN_TURN:
            return
        for before, heading_then in self._before:
            turned = float(wrap(heading - heading_then))
            if abs(turned) >= MIN_TURN:
                self._compare(before, view, turned)
        self._before.append((view, heading))

    @property
    def found(self) -> SelfOcclusion | None:
        """Detected self-occlusion; None if nothing turns with the camera."""
        elevation = np.concatenate([np.empty(0), *self._elevations])
        return _significant(elevation, self._static)

    def _compare(self, before: Features, now: Features, turned: float) -> None:
        """Count the matches that turned with the camera and the static ones, after a turn [rad]."""
        i, j = match(before.descriptor, now.descriptor)[0].T
        then, here = (
            np.column_stack([view.azimuth[rows], view.elevation[rows]])
            for view, rows in ((before, i), (now, j))
        )
        pixel = 2 * math.pi / now.shape[1]
        along = _stays(then, here, max(SAME, pixel))
        off = np.abs(wrap(here - then + [turned, 0.0]))
        static = int((off < STATIC_TOLERANCE).all(axis=1).sum())
        if static < max(MIN_MATCHES, MIN_STATIC * along.sum()):
            return
        self._elevations.append(here[along, 1])
        self._static += static


def _stays(then: np.ndarray, now: np.ndarray, max_angle: float) -> np.ndarray:
    """Return which directions, (n, 2), differ by at most an angle [rad]."""
    return np.asarray((np.abs(wrap(now - then)) <= max_angle).all(axis=1))


def _significant(elevation: np.ndarray, num_static: int) -> SelfOcclusion | None:
    """Return the self-occlusion of matches at elevations, (n,) [rad]; None if it may be chance."""
    if elevation.size < max(MIN_MATCHES, MIN_SHARE * num_static):
        return None
    lowest, highest = np.percentile(elevation, [5, 95])
    return SelfOcclusion(elevation.size, float(lowest), float(highest))


def find_mirrored(
    seen: Comparison, picture: np.ndarray, views: tuple[Features, Features], camera: Panorama
) -> str | None:
    """Return a message if two panoramas only match where one of them is mirrored, or None.

    `seen` is the comparison of their `views`, home's first; `picture` is the other one, as
    `Panorama.panorama` returns it.
    """
    if seen.accepted:
        return None
    flipped = extract(np.ascontiguousarray(picture[:, ::-1]), camera)
    if not compare(views[0], flipped, camera).accepted:
        return None
    return "the pictures agree only if one of them is mirrored: mirror that one"
