"""Seam test: whether the left and right edges of an image continue each other, as in a panorama.

The edges of a panorama are as similar as any two neighbouring columns, those of another image as
different as any two distant columns. Both distributions are learnt from the image itself. Their
likelihood ratio is an e-value: its mean over panoramas is at most 1, so that it exceeds t at most
once in t panoramas. The same holds for the mean over several images, even if they are dependent
(Vovk and Wang, "E-values: calibration, combination and applications", Annals of Statistics 2021).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from homeward.errors import InputError
from homeward.vision.cameras.grey import as_grey
from homeward.vision.cameras.panoramic import Panorama
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
