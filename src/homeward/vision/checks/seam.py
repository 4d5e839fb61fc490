"""Seam test: whether left and right edge of an image continue each other, as a panorama's do.

The edges of a panorama are as alike as any two neighbouring columns, those of another image as
unlike as any two columns far apart. Both are learnt from the image itself. Their likelihood ratio
is an e-value: its mean over panoramas is one at most, so that it exceeds t once in t times at most,
and so does the mean over several images, however much alike these are
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
"""E-value from which an image is refused: one panorama in a hundred at most."""
SCALES = 360, 180
"""Images are reduced to so many columns, twice: stitched joints are off by parts of a degree, and
an edge may lie at the seam by chance."""
NOISE = 2.0
"""Standard deviation of noise [grey levels]: columns of less contrast tell nothing."""
NARROWEST_KERNEL = 0.02
"""Least bandwidth of the kernel density of correlations (Fisher's z) [1]."""
INSIST = "force: true in images.yaml uses it anyway; see and compare have --force, too"


def require_panoramas(pictures: Sequence[np.ndarray], camera: Panorama) -> None:
    """Raise InputError, which says why, when pictures of one camera are no panoramas.

    Parameters
    ----------
    pictures : sequence of ndarray
        As `Panorama.panorama` gives them, of any kind that `as_grey` takes.
    camera : Panorama
        That is said to have taken them.
    """
    greys = [as_grey(picture) for picture in pictures]
    if greys and all(map(_two_discs, greys)):
        raise InputError(
            "two discs side by side: a double fisheye image, no panorama; convert it to "
            f"an equirectangular one with the camera's software ({INSIST})"
        )
    if greys and np.mean([seam_evidence(grey, camera) for grey in greys]) >= MIN_EVIDENCE:
        raise InputError(
            "left and right edge do not continue each other, as those of a 360 deg panorama do; "
            f"is it an ordinary picture? ({INSIST})"
        )


def seam_evidence(grey: np.ndarray, camera: Panorama) -> float:
    """Return the e-value of a picture's seam: how much more it looks like no seam of a panorama.

    Parameters
    ----------
    grey : ndarray of uint8, shape (height, width)
        The picture.
    camera : Panorama
        That is said to have taken it: rows count by the solid angle that they span.
    """
    return float(np.mean([_evidence(_correlations(grey, camera, most)) for most in SCALES]))


def _evidence(alike: np.ndarray) -> float:
    """Return the e-value of a seam, of how alike any two columns are, (n, n)."""
    n = len(alike)
    left, right = np.indices(alike.shape)
    beside, apart = right - left == 1, np.abs(right - left - n / 2) < n / 4
    seam, within, far = alike[-1, 0], alike[beside], alike[apart]
    unlike = _density(far, seam)
    # As one pair among the others, so that nothing is rarer than once in as many.
    like = (within.size * _density(within, seam) + unlike) / (within.size + 1)
    return float(unlike / like) if like > 0.0 else 1.0


def _correlations(grey: np.ndarray, camera: Panorama, most: int) -> np.ndarray:
    """Return how alike any two columns are, (n, n), in Fisher's z; brightness is of no account.

    The picture is reduced to at most so many columns.
    """
    height, width = grey.shape
    if width > most:
        size = most, max(round(height * most / width), 2)
        grey = opencv().resize(grey, size, interpolation=opencv().INTER_AREA)
    height, width = grey.shape
    _, elevation = camera.directions(np.zeros(height), np.arange(height), (height, width))
    weight = np.maximum(np.cos(elevation), 0.0)[:, None]
    # What all columns have in common, bright sky and dark ground, is no likeness.
    parts = grey - np.median(grey, axis=1, keepdims=True)
    parts = (parts - (weight * parts).sum(axis=0) / weight.sum()) * np.sqrt(weight)
    parts /= np.sqrt((parts**2).sum(axis=0) + weight.sum() * NOISE**2)
    return np.asarray(np.arctanh(np.clip(parts.T @ parts, -0.999, 0.999)))


def _density(samples: np.ndarray, at: float) -> float:
    """Return a kernel's estimate of a density (Silverman's rule)."""
    quartiles = np.subtract(*np.percentile(samples, [75, 25])) / 1.34
    wide = max(0.9 * min(samples.std(), quartiles) * samples.size**-0.2, NARROWEST_KERNEL)
    near = np.exp(-0.5 * ((at - samples) / wide) ** 2).mean()
    return float(near / (wide * math.sqrt(2.0 * math.pi)))


def _two_discs(grey: np.ndarray) -> bool:
    """Say whether a picture is two discs side by side, of its height, with nothing round them."""
    height, width = grey.shape
    radius = height / 2
    if abs(width / height - 2.0) > 0.1:
        return False
    row, column = np.indices(grey.shape)
    across = (column + 0.5) % (width / 2) - width / 4
    out = np.hypot(across / (width / 4), (row + 0.5 - radius) / radius)
    beside = np.abs(row + 0.5 - radius) < 0.85 * radius
    without, within = beside & (out > 1.04), beside & (out > 0.75) & (out < 0.95)
    nothing = np.abs(grey - np.median(grey[without])) < 16.0
    rows = without.any(axis=1)
    outside, inside = (
        (nothing & part).sum(axis=1)[rows] / np.maximum(part.sum(axis=1)[rows], 1)
        for part in (without, within)
    )
    # So much of the edge has a picture within, and nothing without.
    return bool(np.mean(outside - inside) >= 0.8)
