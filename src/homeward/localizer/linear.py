"""Home bearings, linear around a point in what is known and in home."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from homeward.angles import wrap
from homeward.localizer.compiled import address, compiled
from homeward.localizer.problem import HEAD, HomeProblem


@dataclass(frozen=True)
class Linear:
    """The home bearings of a problem, linear around a home and a map."""

    problem: HomeProblem
    at: np.ndarray
    """(3,): the home that they are linear around."""
    residual: np.ndarray
    """(q,): measured minus expected there, the map at its mean [rad]."""
    by_known: np.ndarray
    """(q, 4 + 2 q): Jacobian of the expected home bearings by what is known ..."""
    by_home: np.ndarray
    """(q, 3): ... and by home."""
    correlated: np.ndarray
    """(q, 4 + 2 q): covariance of the expected home bearings with what is known."""
    spread: np.ndarray
    """(q, q): of the residuals, were home known."""

    def carried(self, problem: HomeProblem) -> Linear:
        """Return them around the same point after what is known has changed a little."""
        residual = self.residual - self.by_known @ (problem.mean - self.problem.mean)
        return _linear(problem, self.at, residual, self.by_known, self.by_home)


def linearised(problem: HomeProblem, home: np.ndarray, known: np.ndarray) -> Linear:
    """Return the home bearings around `home` (3,) and what is known (4 + 2 q,)."""
    q = problem.bearings.size
    c, s = math.cos(home[2]), math.sin(home[2])
    mx, my, yaw = problem.mount
    ox, oy = c * mx - s * my, s * mx + c * my
    points = known[HEAD:].reshape(-1, 2)
    dx, dy = points[:, 0] - home[0] - ox, points[:, 1] - home[1] - oy
    square = np.maximum(dx * dx + dy * dy, 1e-4)
    gx, gy = -dy / square, dx / square
    unknown_yaw = known[3] if problem.same_camera else 0.0
    residual = wrap(problem.bearings - np.arctan2(dy, dx) + home[2] + yaw + unknown_yaw)
    by_home = np.stack([-gx, -gy, gx * oy - gy * ox - 1.0], axis=1)
    by_known = np.zeros((q, problem.mean.size))
    if problem.same_camera:
        by_known[:, 3] = -1.0
    rows = np.arange(q)
    by_known[rows, HEAD + 2 * rows], by_known[rows, HEAD + 1 + 2 * rows] = gx, gy
    residual = residual + by_known @ (known - problem.mean)
    return _linear(problem, home, residual, by_known, by_home)


def _linear(
    problem: HomeProblem,
    home: np.ndarray,
    residual: np.ndarray,
    by_known: np.ndarray,
    by_home: np.ndarray,
) -> Linear:
    """Return it with the covariances that follow."""
    q, size = by_known.shape
    correlated, spread = np.empty((q, size)), np.empty((q, q))
    native = compiled()
    if native is None:
        correlated[:] = by_known @ problem.covariance
        spread[:] = correlated @ by_known.T + np.diag(problem.sigmas**2)
    else:
        given = (problem.covariance, by_known, problem.sigmas)
        native.spread_home(q, size, *map(address, (*given, correlated, spread)))
    return Linear(problem, home, residual, by_known, by_home, correlated, spread)
