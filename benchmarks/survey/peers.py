"""The peers in a surveyed map: resection, RANSAC resection with memory, gated EKF, particles."""

import math
from collections.abc import Callable

import numpy as np

from benchmarks.peers.online import Baseline
from benchmarks.peers.surveyed import residuals
from homeward.drives.drive import Drive
from homeward.localizer.resection import poses_from_triples

STEPS = 8


class Resection:
    """Least squares of all bearings of a frame, from its best triple, without outlier rejection."""

    def __init__(self, survey: dict[str, tuple[float, float]]) -> None:
        self._survey = survey

    def odometry(self, dt: float, v: float, omega: float) -> None:
        """Do nothing."""

    def look(self, seen: dict[str, float]) -> np.ndarray | None:
        seen = {n: b for n, b in seen.items() if n in self._survey}
        if len(seen) < 3:
            return None
        places = np.array([self._survey[n] for n in seen])
        bearings = np.array(list(seen.values()))
        poses = poses_from_triples(places, bearings)
        if not len(poses):
            return None
        costs = np.abs(residuals(poses[:, None], places, bearings)).sum(axis=1)
        pose = poses[int(np.argmin(costs))]
        for _ in range(STEPS):
            d = places - pose[:2]
            square = (d**2).sum(axis=1)
            jacobian = np.column_stack([d[:, 1] / square, -d[:, 0] / square, -np.ones(len(d))])
            step = np.linalg.lstsq(jacobian, residuals(pose, places, bearings), rcond=None)[0]
            pose = pose + step
        return pose


class Follower:
    """A baseline of the leaderboard in this hall; `start` as its settings require."""

    def __init__(self, make: Callable[[Drive], Baseline], drive: Drive) -> None:
        self._estimator, self._t = make(drive), 0.0

    def odometry(self, dt: float, v: float, omega: float) -> None:
        self._estimator.odometry(self._t, v, omega)
        self._t += dt

    def look(self, seen: dict[str, float]) -> np.ndarray | None:
        pose = self._estimator.bearings(self._t, seen).pose
        return None if pose is None else np.array(pose)


class ParticleFilter:
    """Monte Carlo localisation with the equations of Beluga, from a known start.

    Its bearing model weighs a particle by 1 + sum p^3, p = exp(-error^2 / (2 sigma^2)); its
    differential drive adds noise to rotation, translation and rotation in proportion to them
    (Thrun, Burgard and Fox, 2005); it resamples when the effective number falls below a half.
    """

    def __init__(
        self,
        survey: dict[str, tuple[float, float]],
        start: np.ndarray,
        sigma: float,
        seed: int,
        particles: int = 2000,
        alpha: float = 0.1,
    ) -> None:
        self._survey, self._sigma, self._alpha = survey, sigma, alpha
        self._rng = np.random.default_rng(seed)
        self._poses = start + self._rng.normal(size=(particles, 3)) * [0.2, 0.2, 0.1]
        self._weights = np.full(particles, 1.0 / particles)

    def odometry(self, dt: float, v: float, omega: float) -> None:
        """Process a twist; a robot at rest is not moved."""
        if not v and not omega:
            return
        half, shift, alpha = 0.5 * omega * dt, v * dt, self._alpha
        turning = math.sqrt(alpha * half**2 + alpha / 2 * shift**2)
        n = len(self._poses)
        first, last = half + turning * self._rng.normal(size=(2, n))
        moved = shift + math.sqrt(alpha * shift**2 + alpha / 2 * half**2) * self._rng.normal(size=n)
        self._poses[:, 2] += first
        self._poses[:, 0] += moved * np.cos(self._poses[:, 2])
        self._poses[:, 1] += moved * np.sin(self._poses[:, 2])
        self._poses[:, 2] += last

    def look(self, seen: dict[str, float]) -> np.ndarray | None:
        places = np.array([self._survey[n] for n in seen])
        error = residuals(self._poses[:, None], places, np.array(list(seen.values())))
        weight = 1.0 + np.exp(-1.5 * (error / self._sigma) ** 2).sum(axis=1)
        self._weights *= weight
        self._weights /= self._weights.sum()
        mean = np.average(self._poses, axis=0, weights=self._weights)
        mean[2] = np.angle((self._weights * np.exp(1j * self._poses[:, 2])).sum())
        if 1.0 / (self._weights**2).sum() < 0.5 * len(self._weights):
            steps = (np.arange(len(self._weights)) + self._rng.random()) / len(self._weights)
            chosen = np.searchsorted(self._weights.cumsum(), steps).clip(0, len(self._weights) - 1)
            self._poses = self._poses[chosen]
            self._weights[:] = 1.0 / len(self._weights)
        return mean
