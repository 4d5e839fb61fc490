"""A landmark's position from sight lines with outliers, or a mixture of positions along one ray."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from statistics import median

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import position_sigma
from homeward.geometry.se2 import MIN_DISTANCE
from homeward.localizer.tunables import (
    CLOSE,
    INFINITY_RATIO,
    INLIER,
    LINEAR,
    MAJORITY,
    MARGIN,
    MAX_FIT_STEPS,
    MAX_LINES,
    MAX_RANGE_RATIO,
    MIN_LINES,
    MIN_RANGE_RATIO,
    MIN_SIGHTINGS,
    NUM_RANGES,
    RANGE_STEPS,
    RIVAL_SHARE,
)


def triangulate(
    cameras: np.ndarray, bearings: np.ndarray, sigmas: np.ndarray, parallax: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the position on which most sight lines agree (2,) [m], and which do (m,), bool.

    Pairs of at most `MAX_LINES` lines are intersected; the point of least truncated squares is
    refined by Gauss-Newton on its inliers. An outlier crosses nearly parallel lines close to the
    robot and makes a position by itself; so where there may be outliers, no single line may decide.

    `cameras` (m, 3) are poses of the camera: x [m], y [m], heading of its axis [rad]; `bearings`
    and `sigmas` (m,) are from the axis [rad], and `parallax` is the smallest angle between two of
    the lines that agree [rad]. None instead of both if the lines do not (yet) determine the
    position.
    """
    if len(bearings) < MIN_LINES:
        return None
    lines = cameras[:, 2] + bearings
    if not _spread(lines, np.ones(lines.size, bool), parallax):
        return None
    chosen = spaced(lines.size)
    points = _intersections(cameras[chosen, :2], lines[chosen], 0.5 * parallax)
    if not len(points):
        return None
    position = points[int(_truncated(points, cameras, lines, sigmas).sum(axis=1).argmin())]
    agree = np.abs(_residuals(position[None], cameras, lines)[0]) < INLIER * sigmas
    try:
        for _ in range(MAX_FIT_STEPS):
            if agree.sum() < MIN_LINES:
                return None
            position, information = _refine(position, cameras[agree], lines[agree], sigmas[agree])
            agree = np.abs(_residuals(position[None], cameras, lines)[0]) < INLIER * sigmas
        covariance = np.linalg.inv(information)
    except np.linalg.LinAlgError:  # the lines that agree are parallel
        return None
    enough = agree.sum() >= max(MIN_LINES, MAJORITY * lines.size)
    if not enough or not _spread(lines, agree, parallax):
        return None
    distance = np.hypot(*(position - cameras[agree, :2].mean(axis=0)))
    if not _is_linear(covariance, distance):
        return None
    none_wrong = agree.all() and not _is_next_to_camera(position, cameras)
    if not none_wrong:
        far = INFINITY_RATIO * (distance + np.hypot(*np.ptp(cameras[:, :2], axis=0)))
        ends = cameras[chosen, :2] + far * unit_vectors(lines[chosen])
        middle = cameras[agree, :2].mean(axis=0)
        rivals = _rivals(np.concatenate([points, ends]), position, middle)
        either = np.concatenate([position[None], rivals])
        costs = _truncated(either, cameras, lines, sigmas).sum(axis=1)
        if (costs[1:] < costs[0] + MARGIN).any():
            return None
    return position, agree


def is_determined(position: np.ndarray, cameras: np.ndarray, sigmas: np.ndarray) -> bool:
    """Return whether sight lines determine a position (2,) to within the linear range.

    They are from cameras (m, 3), with standard deviations `sigmas` (m,) [rad].
    """
    try:
        covariance = np.linalg.inv(_by_position(position, cameras, sigmas)[1])
    except np.linalg.LinAlgError:
        return False
    return _is_linear(covariance, np.hypot(*(position - cameras[:, :2].mean(axis=0))))


def _is_linear(covariance: np.ndarray, distance: float) -> bool:
    """Return whether a position with a covariance (2, 2) is known to within the linear range."""
    is_positive = (covariance.diagonal() > 0.0).all()  # parallel lines give garbage
    return bool(is_positive and position_sigma(covariance) < LINEAR * distance)


def unexplained(
    cameras: np.ndarray, bearings: np.ndarray, sigmas: np.ndarray, places: np.ndarray
) -> np.ndarray:
    """Return to what share positions do not explain sight lines (m,), in [0, 1], shape (k, m).

    The positions are `places` (2,) each [m] and intersections of pairs of lines; the rest as in
    `triangulate`.
    """
    lines = cameras[:, 2] + bearings
    chosen = spaced(lines.size)
    points = _intersections(cameras[chosen, :2], lines[chosen], 0.0)
    return _truncated(np.concatenate([places, points]), cameras, lines, sigmas)


@cache
def spaced(count: int) -> np.ndarray:
    """Return the indices of at most `MAX_LINES` of a number of lines."""
    return np.unique(np.linspace(0, count - 1, MAX_LINES).astype(int))


@cache
def _pairs(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices of both lines of each pair."""
    return np.triu_indices(count, 1)


def _spread(lines: np.ndarray, use: np.ndarray, parallax: float) -> bool:
    """Return whether the lines span at least the angle `parallax`."""
    around = wrap(lines[use] - lines[use][0])
    return bool(np.ptp(around) >= parallax) if around.size else False


def _is_next_to_camera(position: np.ndarray, cameras: np.ndarray) -> bool:
    """Return whether a camera is so near to a position that its line fits any bearing."""
    apart = np.hypot(*np.ptp(cameras[:, :2], axis=0))
    return bool(np.hypot(*(cameras[:, :2] - position).T).min() < CLOSE * apart)


def _rivals(points: np.ndarray, position: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Return the points (k, 2) that are, from `eye`, at another place than `position`."""
    off, distance = np.hypot(*(points - position).T), np.hypot(*(points - eye).T)
    return np.asarray(points[off > RIVAL_SHARE * distance])


def _intersections(centres: np.ndarray, lines: np.ndarray, least: float) -> np.ndarray:
    """Return intersections of pairs of sight lines in front of both cameras, shape (k, 2)."""
    i, j = _pairs(lines.size)
    sine = np.sin(lines[j] - lines[i])
    good = np.abs(sine) > np.sin(min(least, 1.5))
    i, j, sine = i[good], j[good], sine[good]
    d = centres[j] - centres[i]
    along_i = (d[:, 0] * np.sin(lines[j]) - d[:, 1] * np.cos(lines[j])) / sine
    along_j = (d[:, 0] * np.sin(lines[i]) - d[:, 1] * np.cos(lines[i])) / sine
    front = (along_i > 0) & (along_j > 0)
    i, along = i[front], along_i[front]
    return np.asarray(centres[i] + along[:, None] * unit_vectors(lines[i]))


def unit_vectors(lines: np.ndarray) -> np.ndarray:
    """Return unit vectors along directions, shape (k, 2)."""
    return np.stack([np.cos(lines), np.sin(lines)], axis=1)


def _truncated(
    points: np.ndarray, cameras: np.ndarray, lines: np.ndarray, sigmas: np.ndarray
) -> np.ndarray:
    """Return truncated squared residuals of lines by point, shape (k, m)."""
    residuals = _residuals(points, cameras, lines)
    return np.asarray(np.minimum((residuals / (INLIER * sigmas)) ** 2, 1.0))


def _residuals(points: np.ndarray, cameras: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Return residuals of lines by point, shape (k, m) [rad]."""
    dx = points[:, 0, None] - cameras[None, :, 0]
    dy = points[:, 1, None] - cameras[None, :, 1]
    return np.asarray(wrap(lines - np.arctan2(dy, dx)))


def _refine(
    position: np.ndarray, cameras: np.ndarray, lines: np.ndarray, sigmas: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the position after one Gauss-Newton step, and its information (2, 2)."""
    jacobian, information = _by_position(position, cameras, sigmas)
    residual = _residuals(position[None], cameras, lines)[0] / sigmas
    step = np.linalg.solve(information, jacobian.T @ residual)
    reach = 0.5 * max(float(np.hypot(*(position - cameras[:, :2]).T).min()), 1e-3)
    size = float(np.hypot(*step))
    return position + step * min(1.0, reach / max(size, 1e-12)), information


def _by_position(
    position: np.ndarray, cameras: np.ndarray, sigmas: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return normalised Jacobians of lines by the position (m, 2), and its information (2, 2)."""
    d = position - cameras[:, :2]
    square = np.maximum((d**2).sum(axis=1), 1e-6)
    jacobian = np.stack([-d[:, 1], d[:, 0]], axis=1) / square[:, None] / sigmas[:, None]
    return jacobian, jacobian.T @ jacobian + 1e-9 * np.eye(2)


@dataclass(frozen=True)
class RangeMixture:
    """Range mixture: k Gaussians along a ray, in the odometry frame (Sola et al., 2005).

    A robot that drives straight at a landmark never observes its range, only the ray on which it
    is. Seen from home, the ray covers some bearings and not others, which may be enough to detect
    that the landmark moved.
    """

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
        off, lever = _ray_residuals(cameras, lines, distances, directions)
        weight = lever / (sigmas * np.maximum(1.0, np.abs(off) / (INLIER * sigmas))) ** 2
        directions = directions + (weight * off).sum(axis=1) / (weight * lever).sum(axis=1)
    share = np.abs(_ray_residuals(cameras, lines, distances, directions)[0]) / (INLIER * sigmas)
    if (share < 1.0).mean(axis=1).max() < MAJORITY:
        return None
    cost = 0.5 * INLIER**2 * MIN_SIGHTINGS * np.minimum(share**2, 1.0).mean(axis=1)
    weights = np.exp(cost.min() - cost)
    along = unit_vectors(directions)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    swing = median(sigmas.tolist()) ** 2 + covariance[2, 2]
    apart = (0.5 * math.log(ratio)) ** 2
    return RangeMixture(
        places=cameras[-1, :2] + distances[:, None] * along,
        covariances=covariance[:2, :2]
        + apart * _outer(distances[:, None] * along)
        + swing * _outer(distances[:, None] * across),
        weights=weights / weights.sum(),
    )


def _ray_residuals(
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
