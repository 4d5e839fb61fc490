"""What carries a belief through a drive, whatever the belief is made of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from homeward.geometry.frames import Pose
from homeward.lab.filters.settings import Engine

LOST_SIGMA = 0.5
"""White noise of speed [m/s/sqrt(Hz)] and turn rate [rad/s/sqrt(Hz)] without odometry."""

Held = tuple[float, float] | None
"""What a robot drives by: v [m/s] and omega [rad/s]; None: nobody knows."""
Angles = Mapping[int, float]
"""By the landmarks' indices [rad]."""
Outputs = Mapping[str, np.ndarray]
"""Of an update, (q,) each: innovation [rad], innovation_variance [rad^2], accepted (0 or 1)."""


def nothing_said(q: int) -> dict[str, np.ndarray]:
    """Return the `Outputs` of an update that compared no landmark."""
    return {name: np.zeros(q) for name in ("innovation", "innovation_variance", "accepted")}


class LandmarkBelief(NamedTuple):
    """What a belief says of the landmarks; all have shape (q,)."""

    home: np.ndarray
    """Home bearings as they must be [rad]."""
    distance: np.ndarray
    """From home [m]; negative or infinite where nothing is said of it."""
    sigma_distance: np.ndarray
    """[m]"""


class FilterBackend(Protocol):
    """Makes new beliefs of old ones; a belief is never changed, and knows which are `active`."""

    engine: Engine
    """What executes it: native or interpreter."""
    notes: tuple[str, ...]
    """What the user must know of that, each a sentence."""
    minimum_visible: int
    """Fewer landmarks in sight, and a stamp is not used."""
    stored: np.ndarray
    """(q,), beta* in the robot's home frame [rad]."""

    @property
    def diverged(self) -> int:
        """Steps that were left out because their result had diverged."""

    def start(self) -> Any:
        """Return the belief of the start prior, before any landmark is seen."""

    def predict(self, belief: Any, interval: float, twist: Held) -> Any:
        """Return the belief `interval` [s] later.

        Without a twist the robot stands, with the noise `LOST_SIGMA`.
        """

    def update(self, belief: Any, seen: Angles, sigmas: Angles) -> tuple[Any, Outputs]:
        """Return the belief after the sightings of one stamp, and what the step said of them.

        `seen` has the bearing of each landmark from the robot's heading, `sigmas` the standard
        deviation of those that have one of their own.
        """

    def pose(self, belief: Any) -> tuple[Pose, np.ndarray]:
        """Return the pose in the home frame and its covariance (3, 3): x, y [m], heading [rad]."""

    def landmarks(self, belief: Any) -> LandmarkBelief:
        """Return what is known of the landmarks."""
