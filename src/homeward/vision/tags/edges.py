"""Corners of tags to hundredths of a pixel: each edge is a plane through the camera.

A straight edge in space spans a plane with the camera's centre, for any lens distortion. At points
along each edge the step from black to white is located, the plane is fitted to these points, and
neighbouring planes intersect in the rays of the corners. The scatter of the points about their
planes gives the corners' standard deviation.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import trapezoid

from homeward.drives.cameras.camera import Camera, angles, unit_vectors
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
