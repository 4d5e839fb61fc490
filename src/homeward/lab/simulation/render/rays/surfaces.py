"""Surfaces of a room: textured rectangles in space, as arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from homeward.drives.drive import Columns


@dataclass(frozen=True)
class Surfaces(Columns):
    """The n rectangles, visible from the side to which ``right x up`` points.

    A point of rectangle k is ``corner[k] + a right[k] + b up[k]``, a and b in [0, 1]; its texture
    coordinates are ``offset[k] + (a, b) tiles[k]``, in tiles.
    """

    corner: np.ndarray
    """(n, 3), in room coordinates [m]."""
    right: np.ndarray
    """(n, 3) [m]"""
    up: np.ndarray
    """(n, 3), perpendicular to `right` [m]."""
    texture: np.ndarray
    """(n,), index into the room's textures."""
    offset: np.ndarray
    """(n, 2), in tiles."""
    tiles: np.ndarray
    """(n, 2), number of tiles along each side."""
    thing: np.ndarray
    """(n,), index of the object that the surface belongs to."""

    @property
    def normal(self) -> np.ndarray:
        """(n, 3), unit vectors to the visible side."""
        out = np.cross(self.right, self.up)
        return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))


@dataclass(frozen=True)
class Skin:
    """Texture of a surface."""

    texture: int
    """Index into the room's textures."""
    tile: float | None
    """Width and height of a tile [m]; None: stretched over the whole surface."""
    offset: tuple[float, float] = (0.0, 0.0)
    """In tiles."""


def rectangle(
    corner: np.ndarray, right: np.ndarray, up: np.ndarray, skin: Skin, thing: int
) -> Surfaces:
    """Return one rectangle."""
    sides = np.array([math.hypot(*right), math.hypot(*up)])
    tiles = np.ones(2) if skin.tile is None else sides / skin.tile
    return Surfaces(
        np.array([corner], float),
        np.array([right], float),
        np.array([up], float),
        np.array([skin.texture]),
        np.array([skin.offset], float),
        tiles[None, :],
        np.array([thing]),
    )


def upright(
    a: np.ndarray, b: np.ndarray, bottom: float, top: float, skin: Skin, thing: int
) -> Surfaces:
    """Return the vertical rectangle above the ground line from `a` to `b` (2,) [m].

    It is visible from the right-hand side of the line, from the height `bottom` to `top` [m].
    """
    along = np.array([b[0] - a[0], b[1] - a[1], 0.0])
    up = np.array([0.0, 0.0, top - bottom])
    return rectangle(np.array([a[0], a[1], bottom]), along, up, skin, thing)


def block(
    centre: tuple[float, float],
    yaw: float,
    size: tuple[float, float, float],
    bottom: float,
    skin: Skin,
    thing: int,
    seed: int,
) -> list[Surfaces]:
    """Return the six faces of an upright box whose base is at the height `bottom` [m].

    Its centre is (x, y) [m], its size length, width and height [m], its length along `yaw` [rad].
    Each side shows a part of the texture drawn with `seed`.
    """
    base, top = footprint(centre, yaw, size[:2]), bottom + size[2]
    rng, faces = np.random.default_rng(seed), []
    for a, b in zip(base, np.roll(base, -1, axis=0), strict=True):
        cover = Skin(skin.texture, skin.tile, tuple(rng.random(2).tolist()))
        faces.append(upright(a, b, bottom, top, cover, thing))
    along, across = base[1] - base[0], base[3] - base[0]
    first = np.append(base[0], top)
    faces.append(rectangle(first, np.append(along, 0.0), np.append(across, 0.0), skin, thing))
    under = np.append(base[0], bottom)
    faces.append(rectangle(under, np.append(across, 0.0), np.append(along, 0.0), skin, thing))
    return faces


def footprint(centre: tuple[float, float], yaw: float, size: tuple[float, float]) -> np.ndarray:
    """Return the corners (4, 2) of a rectangle on the ground, anti-clockwise [m]."""
    half = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.asarray(size)
    c, s = math.cos(yaw), math.sin(yaw)
    return np.asarray(centre + half @ np.array([[c, s], [-s, c]]))
