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
class Setup:
    """Start prior, home bearings and noise of a filter, in its order of q landmarks."""

    polar: Polar
    """Start prior: R [m], theta, alpha [rad]."""
    sigmas: np.ndarray
    """(3,), its standard deviations."""
    stored: np.ndarray
    """(q,), beta* in the robot's home frame [rad]."""
    bearing_sigma: float
    """Standard deviation of a bearing without its own [rad]."""
    input_density: np.ndarray
    """(2,), variance density of speed [(m/s)^2/Hz] and turn rate [(rad/s)^2/Hz]."""
    gate: float
    """Largest accepted innovation^2 / variance."""
    minimum_visible: int
    """A stamp with fewer landmarks in view is not used."""


class CartesianFilter:
    """Base of backends whose landmarks are a home bearing and an inverse distance from home.

    `home_sigma` (q,) [rad] are the standard deviations of the home bearings, `inverse` the expected
    inverse distance of a landmark and its standard deviation [1/m].
    """

    engine: Engine = "interpreter"
    notes: tuple[str, ...] = ()
    diverged = 0

    def __init__(self, setup: Setup, home_sigma: np.ndarray, inverse: tuple[float, float]) -> None:
        self.setup, self.home_sigma, self.inverse = setup, home_sigma, inverse
        self.stored, self.minimum_visible = setup.stored, setup.minimum_visible

    def sighted(self, seen: Angles, sigmas: Angles) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return landmarks, bearings and sigmas [rad] of a stamp, (k,) each."""
        own = [sigmas.get(i, self.setup.bearing_sigma) for i in seen]
        return np.array(list(seen)), np.array(list(seen.values())), np.array(own)
