"""Measurement model of home bearings, linearised around a home and a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.angles import wrap
from homeward.localizer.geometry import compose, lever, sight
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
    eye = compose(home, problem.mount)
    if problem.same_camera:
        eye[2] += camera_yaw
    bearing, by_place, _ = sight(eye, places)
    by_eye = np.full((len(places), 3), -1.0)
    np.negative(by_place, out=by_eye[:, :2])
    return bearing, by_place, by_eye @ lever(eye - home)


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
    (gx, gy), known = by_place.T, problem.covariance
    # Each bearing knows one landmark: a product of full matrices were mostly zeros.
    correlated = gx[:, None] * known[POSE_AND_YAW::2] + gy[:, None] * known[POSE_AND_YAW + 1 :: 2]
    if problem.same_camera:
        correlated -= known[YAW]
    covariance = correlated[:, POSE_AND_YAW::2] * gx + correlated[:, POSE_AND_YAW + 1 :: 2] * gy
    if problem.same_camera:
        covariance -= correlated[:, YAW, None]
    covariance.ravel()[:: len(gx) + 1] += problem.sigmas**2
    return Linear(problem, home, residual, by_place, by_home, correlated, covariance)
