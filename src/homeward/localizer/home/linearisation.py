"""Measurement model of home bearings, linearised around a home and a map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from homeward.angles import wrap
from homeward.localizer.compiled import compiled
from homeward.localizer.home.problem import POSE_AND_YAW, YAW, HomeProblem


@dataclass(frozen=True)
class Linear:
    """The home bearings of a problem, linear around a home and a map."""

    problem: HomeProblem
    at: np.ndarray
    """(3,): the home that they are linear around."""
    residual: np.ndarray
    """(q,): measured minus expected there, the map at its mean [rad]."""
    by_place: np.ndarray
    """(q, 2): Jacobian of each expected home bearing by its landmark's place ..."""
    by_home: np.ndarray
    """(q, 3): ... and by home."""
    correlated: np.ndarray
    """(q, 4 + 2 q): covariance of the expected home bearings with what is known."""
    residual_covariance: np.ndarray
    """(q, q): of the residuals, were home known."""

    @staticmethod
    def room(problem: HomeProblem, at: np.ndarray) -> Linear:
        """Return room for what a compiled function fills in."""
        q, size = problem.bearings.size, problem.mean.size
        jacobians = np.empty((q, 2)), np.empty((q, 3))
        return Linear(problem, at, np.empty(q), *jacobians, np.empty((q, size)), np.empty((q, q)))

    def propagated(self, problem: HomeProblem) -> Linear:
        """Return them around the same point after what is known has changed a little."""
        change = expected_change(problem, self.by_place, problem.mean - self.problem.mean)
        return _linear(problem, self.at, self.residual - change, self.by_place, self.by_home)


def linearised(problem: HomeProblem, home: np.ndarray, known: np.ndarray) -> Linear:
    """Return the home bearings around `home` (3,) and what is known (4 + 2 q,)."""
    bearing, by_place, by_home = expected(
        problem, home, known[POSE_AND_YAW:].reshape(-1, 2), known[YAW]
    )
    residual = wrap(problem.bearings - bearing)
    residual = residual + expected_change(problem, by_place, known - problem.mean)
    return _linear(problem, home, residual, by_place, by_home)


def expected(
    problem: HomeProblem, home: np.ndarray, places: np.ndarray, camera_yaw: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the bearings (k,) of places (k, 2) from `home` (3,), and how they change.

    The latter by the place, (k, 2), and by home, (k, 3); `camera_yaw` [rad] is what the camera's
    yaw is off, if home's is the same.
    """
    c, s = math.cos(home[2]), math.sin(home[2])
    mx, my, yaw = problem.mount
    ox, oy = c * mx - s * my, s * mx + c * my
    dx, dy = places[:, 0] - home[0] - ox, places[:, 1] - home[1] - oy
    square = np.maximum(dx * dx + dy * dy, 1e-4)
    gx, gy = -dy / square, dx / square
    unknown_yaw = camera_yaw if problem.same_camera else 0.0
    bearing = np.arctan2(dy, dx) - home[2] - yaw - unknown_yaw
    by_home = np.stack([-gx, -gy, gx * oy - gy * ox - 1.0], axis=1)
    return bearing, np.stack([gx, gy], axis=1), by_home


def expected_change(problem: HomeProblem, by_place: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return how home bearings, expected (q,), change with what is known (4 + 2 q,)."""
    moved = (by_place * change[POSE_AND_YAW:].reshape(-1, 2)).sum(axis=1)
    return np.asarray(moved - change[YAW] if problem.same_camera else moved)


def _linear(
    problem: HomeProblem,
    home: np.ndarray,
    residual: np.ndarray,
    by_place: np.ndarray,
    by_home: np.ndarray,
) -> Linear:
    """Return it with the covariances that follow."""
    q, known = len(by_place), problem.covariance
    correlated, residual_covariance = np.empty((q, len(known))), np.empty((q, q))
    native = compiled()
    if native is None:
        gx, gy = by_place.T
        correlated[:] = (
            gx[:, None] * known[POSE_AND_YAW::2] + gy[:, None] * known[POSE_AND_YAW + 1 :: 2]
        )
        if problem.same_camera:
            correlated -= known[YAW]
        residual_covariance[:] = (
            correlated[:, POSE_AND_YAW::2] * gx + correlated[:, POSE_AND_YAW + 1 :: 2] * gy
        )
        if problem.same_camera:
            residual_covariance -= correlated[:, YAW, None]
        residual_covariance[np.arange(q), np.arange(q)] += problem.sigmas**2
    else:
        native.spread_home(problem.in_c, by_place, correlated, residual_covariance)
    return Linear(problem, home, residual, by_place, by_home, correlated, residual_covariance)
