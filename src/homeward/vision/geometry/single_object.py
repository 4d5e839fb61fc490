"""Single-object support: whether a motion rests on one object, such as a tripod.

All matches on one object err together: where it was moved, or moves along, they agree on a motion
as well as any.
"""

from __future__ import annotations

import math

import numpy as np

from homeward.vision.cameras.panoramic import SECTORS, WINDOW
from homeward.vision.geometry.a_contrario import Acceptance, assess
from homeward.vision.geometry.epipolar import Pairs
from homeward.vision.geometry.refinement import Fit

REACH = WINDOW * math.pi / SECTORS
"""What lies within this of one direction may be one object [rad]."""


def dominant_object(fit: Fit, pairs: Pairs, heading: float | None = None) -> np.ndarray:
    """Return which inliers, (n,) bool, are on one object that the motion rests on.

    None of them, where no object has most of them, or the others suffice by themselves.

    Parameters
    ----------
    fit, pairs, heading
        As for `homeward.vision.geometry.a_contrario.assess`.
    """
    rows = np.flatnonzero(fit.inlier)
    thing = np.zeros(len(pairs), bool)
    if not rows.size:
        return thing
    near = pairs.home_vectors[rows] @ pairs.home_vectors[rows].T > math.cos(REACH)
    thing[rows[near[near.sum(axis=1).argmax()]]] = True
    if 2 * thing.sum() <= rows.size:
        return np.zeros(len(pairs), bool)
    others = Fit(fit.motion, fit.inlier & ~thing, fit.information, fit.parallax, fit.scale)
    return np.zeros(len(pairs), bool) if assess(others, pairs, heading).accepted else thing


def covariance_factor(thing: np.ndarray, fit: Fit) -> float:
    """Return the factor of the covariance where all inliers on one object, (n,), count once."""
    agree, on_it = int(fit.inlier.sum()), int(thing.sum())
    return agree / (agree - on_it + 1) if on_it else 1.0


def explain(acceptance: Acceptance, thing: np.ndarray, pairs: Pairs) -> str:
    """Return the reason of an acceptance, with where the object is that the motion rests on."""
    if not thing.any():
        return acceptance.reason
    x, y, z = pairs.home_vectors[thing].mean(axis=0)
    up = math.degrees(math.atan2(z, math.hypot(x, y)))
    where = "overhead" if up > 45.0 else f"{math.degrees(math.atan2(y, x)):.0f} deg from its axis"
    return (
        f"{acceptance.reason}; {int(thing.sum())} of them lie on one object ({where} at home): "
        "if it was moved, or moves with the robot, this answer is wrong"
    )
