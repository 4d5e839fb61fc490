"""Images: ray intersections, textured, and exposed by a sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from homeward.drives.cameras.camera import unit_vectors
from homeward.lab.simulation.render.rays.raycast import Viewpoint, trace
from homeward.lab.simulation.render.rays.surfaces import Surfaces
from homeward.lab.simulation.render.room.settings import RoomCamera
from homeward.lab.simulation.render.scene import RoomScene
from homeward.lab.simulation.render.shading.textures import LEVELS, SIZE, Atlas
from homeward.vision.opencv import opencv

SHEET = 1024
"""Number of samples in a row of a lookup."""
_SIZES = (SIZE / 2.0 ** np.arange(LEVELS)).astype(np.float32)
MEAN_GREY = 115.0
"""Target mean of the exposure [grey levels of 255]."""


CONTRAST = np.array([0.10, 0.16, 0.25])
"""Change of brightness with the direction that a surface faces."""
NOTHING = 65535
"""Object index of pixels without a ray."""


@lru_cache(maxsize=2)
def rays_of(
    camera: RoomCamera, oversampling: int = 1, dtype: type[np.floating] = np.float64
) -> np.ndarray:
    """Return the directions (rows, columns, 3) of the rays of a camera's pixels, n x n each."""
    rows, columns = np.indices((camera.height * oversampling, camera.width * oversampling))
    middle = [(part + 0.5) / oversampling - 0.5 for part in (columns, rows)]
    vectors = unit_vectors(*camera.directions(*middle))
    # One component after the other in memory, as the compiled code takes them.
    return np.moveaxis(np.moveaxis(vectors, -1, 0).astype(dtype, order="C"), 0, -1)


def pixel_things(scene: RoomScene, view: Viewpoint, camera: RoomCamera) -> np.ndarray:
    """Return the object at the centre of every pixel, in double precision: (height, width).

    These are indices into the scene's `things`; `NOTHING` where there is no ray.
    """
    met = trace(scene.surfaces, view, rays_of(camera)).surface
    return np.where(met >= 0, scene.surfaces.thing[met], NOTHING)


def picture(
    scene: RoomScene,
    view: Viewpoint,
    camera: RoomCamera,
    rng: np.random.Generator | None = None,
) -> np.ndarray:
    """Render the image from a viewpoint: (height, width, 3), uint8, blue, green, red.

    Noise and exposure are drawn with `rng`; None: without both.
    """
    rays = _samples(scene.surfaces, view, camera)
    colour = _textured(rays, scene.surfaces, view, scene.atlas, camera.pixel_angle)
    colour *= _grey(brightness(scene.surfaces).take(rays.surface))
    colour[rays.surface < 0] = 0.0
    seen = np.mean(rays.surface[: camera.width * camera.height] >= 0)
    return _exposed(_gathered(rays, colour, camera), camera, float(seen), rng)


@dataclass(frozen=True)
class _Samples:
    """The n samples to shade: the centre of each pixel, then four parts of each edge pixel.

    A pixel whose four rays meet one surface needs only one sample, since the mip level fits its
    size.
    """

    across: np.ndarray
    along: np.ndarray
    distance: np.ndarray
    """From the camera [m]."""
    surface: np.ndarray
    edge: np.ndarray
    """(m,), flat indices of the edge pixels; the last 4 m samples are theirs."""


def _samples(surfaces: Surfaces, view: Viewpoint, camera: RoomCamera) -> _Samples:
    """Cast four rays a pixel, and average those that meet one surface."""
    cv2 = opencv()

    hits = trace(surfaces, view, rays_of(camera, 2, np.float32))
    # Without a ray the distance is not used.
    distance = np.where(hits.surface < 0, np.float32(1.0), hits.distance)
    four = [(rows, columns) for rows in (0, 1) for columns in (0, 1)]
    met = [hits.surface[i::2, j::2] for i, j in four]
    one = (met[0] == met[1]) & (met[0] == met[2]) & (met[0] == met[3])
    edge = np.flatnonzero(~one)
    row, column = np.divmod(edge, camera.width)
    on_edges = np.concatenate([2 * (2 * row + i) * camera.width + 2 * column + j for i, j in four])
    size = (camera.width, camera.height)

    def gathered(values: np.ndarray) -> np.ndarray:
        middle = cv2.resize(values, size, interpolation=cv2.INTER_AREA).ravel()
        return np.concatenate([middle, values.ravel().take(on_edges)])

    surface = np.concatenate([met[0].ravel(), hits.surface.ravel().take(on_edges)])
    return _Samples(
        gathered(hits.across),
        gathered(hits.along),
        gathered(distance),
        surface.astype(np.intp),
        edge,
    )


def _gathered(rays: _Samples, colour: np.ndarray, camera: RoomCamera) -> np.ndarray:
    """Return the image of shaded samples (n, 3), float32."""
    image = colour[: camera.width * camera.height]
    parts = colour[camera.width * camera.height :]
    image[rays.edge] = parts.reshape(4, -1, 3).mean(axis=0)
    return image.reshape(camera.height, camera.width, 3)


def _textured(
    rays: _Samples, surfaces: Surfaces, view: Viewpoint, atlas: Atlas, step: float
) -> np.ndarray:
    """Return the colour of each sample, blended from the two mip levels next to its size."""
    level = _level(rays, surfaces, view, step)
    fine = np.clip(level, 0.0, LEVELS - 1.001).astype(np.intp)
    texture = (surfaces.texture * LEVELS).take(rays.surface) + fine
    across = rays.across - np.floor(rays.across)
    down = np.ceil(rays.along) - rays.along
    size = _SIZES.take(fine)
    samples = []
    for step in (0, 1):
        x = atlas.left.ravel().take(texture + step) + across * size - np.float32(0.5)
        y = atlas.top.ravel().take(texture + step) + down * size - np.float32(0.5)
        samples.append(_looked_up(atlas.image, x, y).astype(np.float32))
        size *= np.float32(0.5)
    samples[1] -= samples[0]
    samples[1] *= _grey(np.clip(level - fine.astype(np.float32), 0.0, 1.0))
    return np.asarray(samples[0] + samples[1])


def _level(rays: _Samples, surfaces: Surfaces, view: Viewpoint, step: float) -> np.ndarray:
    """Return the mip level at which a texel is as large as a sample's footprint, float32.

    The footprint at distance rho on a plane at distance h is ``step rho`` across and
    ``step rho^2 / h`` along; it is replaced by a square of the same area.
    """
    plane = np.abs(np.einsum("ni,ni->n", surfaces.normal, surfaces.corner - view.position))
    side = np.linalg.norm(surfaces.right, axis=1) / surfaces.tiles[:, 0]
    constant = np.log2(step * SIZE / side) - 0.5 * np.log2(np.maximum(plane, 1e-3))
    level = np.float32(1.5) * np.log2(rays.distance)
    return np.asarray(level + constant.astype(np.float32).take(rays.surface))


def brightness(surfaces: Surfaces) -> np.ndarray:
    """Return the brightness of each surface (n,), float32, so that the edges of objects show."""
    return np.asarray(1.0 + surfaces.normal @ CONTRAST, np.float32)


def _looked_up(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Interpolate an image at pixel positions x, y (n,); return (n,) or (n, channels)."""
    cv2 = opencv()
    # OpenCV requires a two-dimensional map with sides below 2^15.
    n = x.size
    sheet = np.zeros((2, -(-n // SHEET), SHEET), np.float32)
    sheet.reshape(2, -1)[:, :n] = x, y
    found = np.asarray(cv2.remap(image, *sheet, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
    return np.asarray(found.reshape(-1, *image.shape[2:])[:n])


def _exposed(
    image: np.ndarray, camera: RoomCamera, seen: float, rng: np.random.Generator | None
) -> np.ndarray:
    """Return the exposed image with noise; `seen` is the share of pixels with light."""
    cv2 = opencv()

    gain = MEAN_GREY * seen / max(float(np.mean(cv2.mean(image)[:3])), 1e-6)
    if rng is None:
        return np.asarray(cv2.convertScaleAbs(image, alpha=gain))
    gain *= math.exp(camera.exposure_sigma * rng.standard_normal())
    image *= np.float32(gain)
    grain = np.float32(camera.noise) * rng.standard_normal(image.shape[:2], np.float32)
    # Rounds, and clips to 0 and 255.
    return np.asarray(cv2.add(image, _grey(grain), dtype=cv2.CV_8U))


def _grey(values: np.ndarray) -> np.ndarray:
    """Return values (...) as three equal channels, (..., 3)."""
    # Three times as fast as broadcasting along an axis of three.
    return np.asarray(opencv().merge([values] * 3)).reshape(*values.shape, 3)


def png(image: np.ndarray) -> bytes:
    """Return an image as a PNG file; higher compression levels do not reduce noise."""
    cv2 = opencv()

    return bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])
