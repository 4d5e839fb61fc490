"""Light on surfaces: a share from everywhere, lamps by Lambert's law, and the shadows they cast."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from homeward.simulation.render.rays.raycast import Viewpoint, trace
from homeward.simulation.render.rays.surfaces import Surfaces
from homeward.simulation.render.room.settings import Light

GRID = 16
"""Light is known at so many places along each side of a surface, and smooth between them."""
AMBIENT = 0.45
"""Light from everywhere, beside which one lamp gives up to about 1."""
REACH = 2.5
"""A lamp's light has fallen to half at this distance [m]."""


def bake(surfaces: Surfaces, lights: Sequence[Light]) -> np.ndarray:
    """Return the light on surfaces with the shadows that they cast on each other.

    Returns
    -------
    ndarray, shape (n, GRID, GRID), float32
        Rows along `up`, columns along `right`.
    """
    return _light(surfaces, lights, surfaces)


def shine(surfaces: Surfaces, lights: Sequence[Light]) -> np.ndarray:
    """Return the light on surfaces as if nothing cast shadows; as `bake`."""
    return _light(surfaces, lights, None)


def _light(surfaces: Surfaces, lights: Sequence[Light], casting: Surfaces | None) -> np.ndarray:
    b, a = np.mgrid[0 : 1 : GRID * 1j, 0 : 1 : GRID * 1j].reshape(2, -1)
    places, normal = surfaces.at(a, b), surfaces.normal
    total = np.full(places.shape[:2], AMBIENT)
    for light in lights:
        towards = np.asarray(light.at) - places
        distance = np.maximum(np.linalg.norm(towards, axis=-1), 1e-6)
        slant = np.maximum(np.einsum("nmi,ni->nm", towards, normal) / distance, 0.0)
        lit = light.power * slant / (1.0 + (distance / REACH) ** 2)
        if casting is not None:
            lamp = Viewpoint(np.asarray(light.at, float), np.eye(3))
            # Just short of the place itself, which is on a surface.
            lit *= trace(casting, lamp, -towards).distance > 0.999
        total += lit
    return total.reshape(-1, GRID, GRID).astype(np.float32)
