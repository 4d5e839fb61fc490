"""Light on surfaces: a share from everywhere, lamps by Lambert's law, and the shadows they cast.

The sun is a lamp far away that shines through a window alone: from outside, walls are not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from homeward.lab.simulation.render.rays.raycast import Viewpoint, trace
from homeward.lab.simulation.render.rays.surfaces import Surfaces

GRID, SUN_GRID = 16, 64
"""Light is known at so many places along each side of a surface, and smooth between them; where the
sun draws edges, at so many."""
REACH = 2.5
"""A lamp's light has fallen to half at this distance [m]."""
FAR = 100.0
"""The sun is so far away [m]."""
FLAT = 0.005
"""What lies so flat on a surface, as posters and tags do, casts no shadow on it [m]: it hides what
it would darken, and between places of the grid that shadow would reach beyond its edges."""


@dataclass(frozen=True)
class Lamp:
    """A point that shines."""

    at: np.ndarray
    """(3,) [m]"""
    power: float
    window: Surfaces | None = None
    """The sun's: one rectangle, seen from outside; its light does not fall with the distance."""


def light_on(
    surfaces: Surfaces, lamps: Sequence[Lamp], ambient: float, casting: Surfaces | None = None
) -> np.ndarray:
    """Return the light on surfaces, with the shadows that others, or they themselves, cast.

    Returns
    -------
    ndarray, shape (n, g, g), float32
        Rows along `up`, columns along `right`.
    """
    grid = SUN_GRID if any(lamp.window is not None for lamp in lamps) else GRID
    b, a = np.mgrid[0 : 1 : grid * 1j, 0 : 1 : grid * 1j].reshape(2, -1)
    places, normal = surfaces.at(a, b), surfaces.normal
    total = np.full(places.shape[:2], ambient)
    for lamp in lamps:
        towards, seen = lamp.at - places, Viewpoint(lamp.at, np.eye(3))
        distance = np.maximum(np.linalg.norm(towards, axis=-1), 1e-6)
        above = np.maximum(np.einsum("nmi,ni->nm", towards, normal), 0.0)
        lit = lamp.power * above / distance
        if lamp.window is None:
            lit /= 1.0 + (distance / REACH) ** 2
        else:
            lit *= trace(lamp.window, seen, -towards).surface >= 0
        if casting is not None and lit.any():
            bright = lit > 0
            met = trace(casting, seen, -towards[bright]).distance
            lit[bright] *= (1.0 - met) * above[bright] < FLAT
        total += lit
    return total.reshape(-1, grid, grid).astype(np.float32)
