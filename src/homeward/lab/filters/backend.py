"""Interface of the filters, which turn one belief into the next, and the Cartesian ones' base."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from homeward.geometry.frames import Polar, Pose
from homeward.lab.filters.settings import Engine

LOST_SIGMA = 0.5
"""White noise of speed [m/s/sqrt(Hz)] and turn rate [rad/s/sqrt(Hz)] without odometry."""

MaybeTwist = tuple[float, float] | None
"""v [m/s] and omega [rad/s]; None where the motion is unknown."""
Angles = Mapping[int, float]
"""Angles [rad] by the index of the landmark."""
Outputs = Mapping[str, np.ndarray]
"""Of an update, (q,) each: innovation [rad], innovation_variance [rad^2], accepted (0 or 1)."""


def empty_outputs(q: int) -> dict[str, np.ndarray]:
    """Return the `Outputs` of an update that compared no landmark."""
    return {name: np.zeros(q) for name in ("innovation", "innovation_variance", "accepted")}


class LandmarkBelief(NamedTuple):
    """Estimates of the landmarks; all have shape (q,)."""

    home: np.ndarray
    """Estimated home bearings [rad]."""
    distance: np.ndarray
    """Distance from home [m]; negative or infinite where it is unknown."""
    sigma_distance: np.ndarray
    """Standard deviation of the distance [m]."""


class FilterBackend(Protocol):
    """Computes new beliefs from old ones, which it never changes.

    A belief has an attribute `active`, (q,), 1 where the landmark has been seen.
    """

    engine: Engine
    """What executes it: native or interpreter."""
    notes: tuple[str, ...]
    """Sentences about the engine for the user."""
    minimum_visible: int
    """A stamp with fewer landmarks in view is not used."""
    stored: np.ndarray
    """(q,), beta* in the robot's home frame [rad]."""

    @property
    def diverged(self) -> int:
        """Number of steps dropped because their result diverged."""

    def start(self) -> Any:
        """Return the belief of the start prior, before any landmark is seen."""

    def predict(self, belief: Any, interval: float, twist: MaybeTwist) -> Any:
        """Return the belief `interval` [s] later.

        Without a twist the robot is assumed at rest, with noise `LOST_SIGMA`.
        """

    def update(self, belief: Any, seen: Angles, sigmas: Angles) -> tuple[Any, Outputs]:
        """Return the belief after the sightings of one stamp, and the outputs of the update.

        `seen` has the bearing of each landmark from the robot's heading, `sigmas` the standard
        deviations of sightings that have their own.
        """

    def pose(self, belief: Any) -> tuple[Pose, np.ndarray]:
        """Return the pose in the home frame and its covariance (3, 3): x, y [m], heading [rad]."""

    def landmarks(self, belief: Any) -> LandmarkBelief:
        """Return the estimates of the landmarks."""


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
