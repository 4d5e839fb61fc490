"""Unit of headings without one in their name, from the direction of the path."""

from __future__ import annotations

import math

import numpy as np

MAX_POSES = 2000
"""Maximum number of poses that are compared; steps between fewer poses have less noise."""
MIN_FIT = 0.7
"""Minimum fit of a path along its headings [1]; random directions have 0."""


def heading_unit(x: np.ndarray, y: np.ndarray, heading: np.ndarray) -> str | None:
    """Return deg or rad, in which headings of poses, shape (n,), fit the path; None if unclear.

    The fit is the length of the mean of exp(2i (direction - heading)) over the path: driving
    backwards and a constant rotation of either frame do not change it.
    """
    kept = slice(None, None, 1 + x.size // MAX_POSES)
    step = np.diff(x[kept] + 1j * y[kept])
    length = np.abs(step).sum()
    if not length > 0:
        return None
    twice = step**2 / np.where(step == 0, 1.0, np.abs(step))
    fit = {
        unit: abs((twice * np.exp(-2j * scale * heading[kept][:-1])).sum()) / length
        for unit, scale in (("deg", math.radians(1.0)), ("rad", 1.0))
    }
    best, other = sorted(fit, key=lambda unit: -fit[unit])
    return best if fit[best] > MIN_FIT and fit[other] < fit[best] - 0.2 else None
