"""Common parts of the filters in Cartesian form: prior, noise and constructor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.geometry.frames import Polar
from homeward.lab.filters.backend import Angles
from homeward.lab.filters.settings import Engine


@dataclass(frozen=True)
class CartesianPrior:
    """Start pose and home bearings of q landmarks, before the drive."""

    polar: Polar
    sigmas: np.ndarray
    """(3,), standard deviations of R [m], theta, alpha [rad]."""
    home: np.ndarray
    """(q,), stored home bearings beta* [rad]."""
    home_sigma: np.ndarray
    """(q,) [rad]"""
    inverse_distance: float
    """Expected inverse distance of a landmark from home [1/m]."""
    inverse_sigma: float
    """Its standard deviation [1/m]."""


@dataclass(frozen=True)
class SensorNoise:
    """Assumed noise of odometry and camera."""

    input_density: np.ndarray
    """(2,), of speed [(m/s)^2/Hz] and turn rate [(rad/s)^2/Hz]."""
    bearing_sigma: float
    """Standard deviation of a bearing without its own [rad]."""
    gate: float
    """Largest accepted innovation^2 / variance."""


class CartesianFilter:
    """Base of backends whose landmarks are a home bearing and an inverse distance from home."""

    engine: Engine = "interpreter"
    notes: tuple[str, ...] = ()
    diverged = 0

    def __init__(self, prior: CartesianPrior, noise: SensorNoise, minimum_visible: int = 1) -> None:
        self.prior, self.noise, self.minimum_visible = prior, noise, minimum_visible
        self.stored = prior.home

    def sighted(self, seen: Angles, sigmas: Angles) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return landmarks, bearings and sigmas [rad] of a stamp, (k,) each."""
        own = [sigmas.get(i, self.noise.bearing_sigma) for i in seen]
        return np.array(list(seen)), np.array(list(seen.values())), np.array(own)
