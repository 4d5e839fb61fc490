"""Range mixture along a ray, for landmarks whose initialisation is still delayed.

A sum of Gaussians in range, as of Sola et al. (2005); Civera et al. (2008) use inverse depth.

A robot that drives straight at a landmark never observes its range, only the ray on which it is.
Seen from home, the ray covers some bearings and not others, which may be enough to detect that the
landmark moved.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.se2 import MIN_DISTANCE
from homeward.localizer.tunables import (
    INLIER,
    MAJORITY,
    MAX_RANGE_RATIO,
    MIN_RANGE_RATIO,
    MIN_SIGHTINGS,
    NUM_RANGES,
    RANGE_STEPS,
)


@dataclass(frozen=True)
class RangeMixture:
    """k Gaussians along a ray, in the odometry frame."""

    places: np.ndarray
    """(k, 2) [m]"""
    covariances: np.ndarray
    """(k, 2, 2) [m^2]"""
    weights: np.ndarray
    """(k,), sum to one."""


def range_mixture(
    cameras: np.ndarray,
    bearings: np.ndarray,
    sigmas: np.ndarray,
    covariance: np.ndarray,
    scale: float,
) -> RangeMixture | None:
    """Return the range mixture of a landmark; None when its sight lines agree on no ray.

    Of camera poses (m, 3), the newest last: x [m], y [m], heading of its axis [rad]; bearings from
    the axis and their sigmas (m,) [rad]. `covariance` (3, 3) is of the newest pose, `scale` the
    median distance of mapped landmarks [m].
    """
    if len(bearings) < MIN_SIGHTINGS or not MIN_DISTANCE <= scale < math.inf:
        return None
    ratio = (MAX_RANGE_RATIO / MIN_RANGE_RATIO) ** (1.0 / (NUM_RANGES - 1))
    distances = scale * MIN_RANGE_RATIO * ratio ** np.arange(NUM_RANGES)
    lines = cameras[:, 2] + bearings
    directions = np.full(NUM_RANGES, lines[-1])
    for _ in range(RANGE_STEPS):
        off, lever = _residuals(cameras, lines, distances, directions)
        weight = lever / (sigmas * np.maximum(1.0, np.abs(off) / (INLIER * sigmas))) ** 2
        directions = directions + (weight * off).sum(axis=1) / (weight * lever).sum(axis=1)
    share = np.abs(_residuals(cameras, lines, distances, directions)[0]) / (INLIER * sigmas)
    if (share < 1.0).mean(axis=1).max() < MAJORITY:
        return None
    cost = 0.5 * INLIER**2 * MIN_SIGHTINGS * np.minimum(share**2, 1.0).mean(axis=1)
    weights = np.exp(cost.min() - cost)
    along = np.stack([np.cos(directions), np.sin(directions)], axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    swing = np.median(sigmas) ** 2 + covariance[2, 2]
    apart = (0.5 * math.log(ratio)) ** 2
    return RangeMixture(
        places=cameras[-1, :2] + distances[:, None] * along,
        covariances=covariance[:2, :2]
        + apart * _outer(distances[:, None] * along)
        + swing * _outer(distances[:, None] * across),
        weights=weights / weights.sum(),
    )


def _residuals(
    cameras: np.ndarray, lines: np.ndarray, distances: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return residuals of lines by place (k, m), and their derivative by its direction."""
    x, y = distances * np.cos(directions), distances * np.sin(directions)
    dx = x[:, None] + cameras[-1, 0] - cameras[:, 0]
    dy = y[:, None] + cameras[-1, 1] - cameras[:, 1]
    square = np.maximum(dx**2 + dy**2, 1e-6)
    return wrap(lines - np.arctan2(dy, dx)), (dx * x[:, None] + dy * y[:, None]) / square


def _outer(vectors: np.ndarray) -> np.ndarray:
    """Return the outer products of vectors (k, 2) with themselves, shape (k, 2, 2)."""
    return np.asarray(vectors[:, :, None] * vectors[:, None, :])
