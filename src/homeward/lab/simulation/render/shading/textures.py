"""Procedural textures, and their atlas with all mip levels.

Every texture is a square tile that repeats without a seam: noise is made in the frequency domain,
and painted shapes wrap around.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from homeward.errors import InputError
from homeward.vision.opencv import opencv
from homeward.vision.tags.front_end import family_of

SIZE = 256
"""Texels along one side of a tile at the finest level."""
LEVELS = 8
"""Mip levels; the coarsest tile has SIZE / 2^(LEVELS - 1) texels a side."""
PAD = 2
"""Texels repeated round each tile, so that interpolation wraps."""
TAG = "tag "
"""Prefix of the kind of a tag's texture, before the family."""
ACROSS = 4
"""Textures side by side in the atlas."""


class Texture(NamedTuple):
    """Key of a texture: one of `KINDS` with a seed, or a tag of a family (see `tag_texture`)."""

    kind: str
    seed: int


@lru_cache(maxsize=256)
def paint(texture: Texture) -> np.ndarray:
    """Return a tile, shape (SIZE, SIZE, 3), blue green red in [0, 1]; cached, do not modify."""
    if texture.kind.startswith(TAG):
        return _tag(texture.kind.removeprefix(TAG), texture.seed)
    # The kind's place in the table separates kinds that share a seed.
    rng = np.random.default_rng([texture.seed, list(KINDS).index(texture.kind)])
    return np.asarray(np.clip(KINDS[texture.kind](rng), 0.0, 1.0), np.float32)


def tag_texture(family: str, number: int) -> Texture:
    """Return the texture of a tag: its code with a black and a white border."""
    return Texture(TAG + family, number)


def _tag(family: str, number: int) -> np.ndarray:
    """Print a tag on white; texels on cell borders are averaged."""
    cv2, dictionary = opencv(), family_of(family)
    if number >= len(dictionary.bytesList):
        raise InputError(
            f"tags: {family} has only {len(dictionary.bytesList)} tags; use another family"
        )
    cells = int(dictionary.markerSize) + 2
    fine = SIZE * (cells + 2)
    code = cv2.aruco.generateImageMarker(dictionary, number, cells)
    paper = np.pad(code, 1, constant_values=255)
    large = cv2.resize(paper, (fine, fine), interpolation=cv2.INTER_NEAREST)
    grey = cv2.resize(large, (SIZE, SIZE), interpolation=cv2.INTER_AREA)
    return np.asarray(0.05 + 0.85 * grey[..., None].repeat(3, axis=2) / 255.0, np.float32)


def noise(rng: np.random.Generator, slope: float) -> np.ndarray:
    """Return seamless noise with mean 0 and standard deviation 1, shape (SIZE, SIZE).

    The amplitude falls with the power `slope` of the frequency; 0 is white.
    """
    f = np.hypot(np.fft.fftfreq(SIZE)[:, None], np.fft.rfftfreq(SIZE)) * SIZE
    f[0, 0] = 1.0
    gain = f**-slope
    gain[0, 0] = 0.0
    field = np.fft.irfft2(gain * np.fft.rfft2(rng.standard_normal((SIZE, SIZE))), (SIZE, SIZE))
    return np.asarray(field / field.std())


def _grey(rng: np.random.Generator, level: float) -> np.ndarray:
    """Return a colour near a grey of this level."""
    return level + rng.uniform(-0.03, 0.03, 3)


def _plaster(rng: np.random.Generator) -> np.ndarray:
    """Paint a wall with very little contrast."""
    relief = 0.6 * noise(rng, 1.4) + 0.4 * noise(rng, 0.3)
    return _grey(rng, 0.72) + 0.010 * relief[..., None]


def _carpet(rng: np.random.Generator) -> np.ndarray:
    """Paint a carpet: fine noise with faint stains."""
    return _grey(rng, 0.36) + (0.03 * noise(rng, 0.2) + 0.012 * noise(rng, 1.8))[..., None]


def _wood(rng: np.random.Generator) -> np.ndarray:
    """Paint boards: brown stripes with grain along them."""
    boards = 32
    across = np.arange(SIZE) * boards // SIZE
    shade = rng.uniform(-0.06, 0.06, boards)[across]
    grain = np.apply_along_axis(_smooth, 1, noise(rng, 0.4))
    joint = np.where(np.diff(across, prepend=across[-1]) != 0, -0.12, 0.0)
    value = 0.03 * grain + (shade + joint)[:, None]
    return np.array([0.27, 0.40, 0.52]) + value[..., None]


def _smooth(line: np.ndarray) -> np.ndarray:
    """Smooth a line with wrap-around."""
    kernel = np.hanning(21)
    wide = np.convolve(np.tile(line, 3), kernel / kernel.sum(), "same")[line.size : 2 * line.size]
    return np.asarray(wide / max(wide.std(), 1e-9))


def _tiles(rng: np.random.Generator) -> np.ndarray:
    """Paint tiles: a regular grid with little contrast."""
    many = 16
    each = SIZE // many
    joint = (np.arange(SIZE) % each) < 1
    shade = np.kron(rng.normal(0.0, 0.015, (many, many)), np.ones((each, each)))
    value = np.where(joint[:, None] | joint, -0.12, shade) + 0.008 * noise(rng, 1.0)
    return _grey(rng, 0.55) + value[..., None]


def _cardboard(rng: np.random.Generator) -> np.ndarray:
    """Paint packaging: brown, a band of tape, and a few printed marks."""
    image = np.array([0.34, 0.50, 0.64]) * rng.uniform(0.7, 1.15) + np.zeros((SIZE, SIZE, 1))
    image = image + 0.02 * noise(rng, 1.0)[..., None]
    _rectangle(image, rng, (0.10, 1.0), (0.06, 0.10), _grey(rng, 0.75))
    for _ in range(5):
        _rectangle(image, rng, (0.05, 0.2), (0.04, 0.15), rng.uniform(0.1, 0.9, 3))
    return image


def _painted(rng: np.random.Generator) -> np.ndarray:
    """Paint furniture: one colour, slightly worn, with seams and handles."""
    image = rng.uniform(0.25, 0.75) + rng.uniform(-0.1, 0.1, 3) + np.zeros((SIZE, SIZE, 1))
    image = image + 0.012 * noise(rng, 1.2)[..., None]
    for _ in range(2):
        _rectangle(image, rng, (0.01, 0.01), (1.0, 1.0), image.mean() - 0.15)
    for _ in range(2):
        _rectangle(image, rng, (0.12, 0.2), (0.02, 0.04), rng.uniform(0.1, 0.3))
    return image


def _print(rng: np.random.Generator) -> np.ndarray:
    """Paint a poster: shapes, lines of text, a border."""
    image = rng.uniform(0.5, 0.95, 3) + np.zeros((SIZE, SIZE, 1))
    rows, columns = np.arange(SIZE)[:, None] / SIZE, np.arange(SIZE) / SIZE
    for _ in range(rng.integers(4, 9)):
        x, y, size = *rng.uniform(0.15, 0.85, 2), rng.uniform(0.05, 0.22)
        colour, stretch = rng.uniform(0.0, 1.0, 3), rng.uniform(0.5, 2.0)
        inside = np.hypot((columns - x) / stretch, (rows - y) * stretch) < size
        if rng.random() < 0.5:
            inside = np.maximum(abs(columns - x) / stretch, abs(rows - y) * stretch) < size
        image[inside] = colour
    for line in range(rng.integers(0, 6)):
        _text(image, rng, 0.72 + 0.04 * line)
    edge = (np.abs(rows - 0.5) > 0.48) | (np.abs(columns - 0.5) > 0.48)
    image[edge] = rng.uniform(0.05, 0.3)
    return image + 0.008 * noise(rng, 0.8)[..., None]


def _text(image: np.ndarray, rng: np.random.Generator, at: float) -> None:
    """Paint a line of words as dark dashes."""
    top, x = int(at * SIZE), int(0.1 * SIZE)
    while x < int(0.85 * SIZE):
        length = int(rng.integers(3, 15))
        image[top : top + 4, x : x + length] = 0.12
        x += length + int(rng.integers(3, 5))


def _rectangle(
    image: np.ndarray,
    rng: np.random.Generator,
    width: tuple[float, float],
    height: tuple[float, float],
    colour: np.ndarray | float,
) -> None:
    """Paint a rectangle of random position and size (in parts of the tile), with wrap-around."""
    w, h = (max(1, int(rng.uniform(*span) * SIZE)) for span in (width, height))
    top, left = rng.integers(0, SIZE, 2)
    rows, columns = (top + np.arange(h)) % SIZE, (left + np.arange(w)) % SIZE
    image[np.ix_(rows, columns)] = colour


KINDS: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    "plaster": _plaster,
    "carpet": _carpet,
    "wood": _wood,
    "tiles": _tiles,
    "cardboard": _cardboard,
    "painted": _painted,
    "print": _print,
}
"""Textures by name."""


@dataclass(frozen=True)
class Atlas:
    """All textures with all their levels in one image.

    Texel (i, j) of texture k at level l is at row ``top[k, l] + i``, column ``left[k, l] + j``.
    """

    image: np.ndarray
    """(rows, columns, 3), uint8."""
    left: np.ndarray
    """(textures, LEVELS), float32."""
    top: np.ndarray
    """(textures, LEVELS), float32."""


@lru_cache(maxsize=4)
def build_atlas(textures: tuple[Texture, ...]) -> Atlas:
    """Paint textures and stack their levels: the finest on the left, the others to its right."""
    width, height = SIZE + SIZE // 2 + 4 * PAD, SIZE + 2 * LEVELS * PAD
    down = -(-len(textures) // ACROSS)
    image = np.zeros((down * height, min(len(textures), ACROSS) * width, 3), np.uint8)
    left = np.zeros((len(textures), LEVELS), np.float32)
    top = np.zeros_like(left)
    for k, texture in enumerate(textures):
        row, column = (k // ACROSS) * height, (k % ACROSS) * width
        level, y, x = paint(texture), row + PAD, column + PAD
        for each in range(LEVELS):
            n = level.shape[0]
            tile = np.pad(level, ((PAD, PAD), (PAD, PAD), (0, 0)), "wrap")
            image[y - PAD : y + n + PAD, x - PAD : x + n + PAD] = np.round(tile * 255)
            left[k, each], top[k, each] = x, y
            level = 0.25 * (
                level[::2, ::2] + level[1::2, ::2] + level[::2, 1::2] + level[1::2, 1::2]
            )
            if each == 0:
                x += n + 2 * PAD
            else:
                y += n + 2 * PAD
    return Atlas(image, left, top)
