"""Resection problem: the map, the home bearings, and perhaps a start prior."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from homeward.drives.settings import DriveSettings
from homeward.geometry.angles import TWO_PI, wrap
from homeward.geometry.frames import from_polar
from homeward.geometry.se2 import between, lever, rotation
from homeward.localizer.map.bodies import Bodies
from homeward.localizer.reference.sets import POSE_AND_YAW, HomeArrays
from homeward.localizer.tunables import (
    EXCHANGED,
    FIXED_SIGMA,
    GIVEN_WRONG,
    HOME_DISTANCE,
    MAX_HOME_STEP,
    MAX_HOME_TURN,
    MAX_RANGE,
    MINIMAL,
    NOISE_SCALES,
)


class Assumption(NamedTuple):
    """Assumption on the given noise of home bearings and the given start."""

    noise_scale: float = 1.0
    """Factor of the standard deviations of the home bearings [1]."""
    start: bool = True
    """Whether the start prior, if there is one, is right."""
    exchanged: tuple[str, str] | None = None
    """Two landmarks whose home bearings are exchanged."""


USUAL = Assumption()
"""Everything is as it was given."""


@dataclass(frozen=True)
class HomeProblem:
    """Resection problem of home; q landmarks that home saw are mapped."""

    mean: np.ndarray
    """(4 + 2 q,): newest pose, camera yaw, landmarks, in the odometry frame."""
    covariance: np.ndarray
    """(4 + 2 q, 4 + 2 q)"""
    bearings: np.ndarray
    """(q,): stored home bearings, from the camera's axis [rad]."""
    sigmas: np.ndarray
    """(q,): their standard deviations [rad]."""
    mount: np.ndarray
    """(3,): pose of the camera on the robot, at home."""
    same_camera: bool
    """Whether the drive's camera was used at home, with the same unknown yaw."""
    moved_prior: float
    offsets: np.ndarray | None = None
    """(q, 3): poses of the bearings' cameras in the frame of the first one; None: all are of it."""
    prior: np.ndarray | None = None
    """(3,): home's pose in the odometry frame by the start prior."""
    prior_information: np.ndarray | None = None
    """(3, 3)"""
    assumed: Assumption = USUAL
    """The assumption; without the start, there is no prior."""

    walk_excess: np.ndarray | None = None
    """(q, 2, 2): covariance of landmarks that may walk, beyond that in `covariance`."""

    bodies: Bodies = field(default_factory=lambda: Bodies.none(0))
    """Bodies among the landmarks."""

    surveyed: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    """(k, 2): surveyed landmarks that determine home without its bearings [m]; see `at_origin`."""
    names: tuple[str, ...] = ()
    """Names of the landmarks."""

    @cached_property
    def is_exchanged(self) -> np.ndarray:
        """(q,), bool: which home bearings are assumed to be exchanged."""
        found = np.zeros(self.bearings.size, bool)
        if self.assumed.exchanged is not None:
            found[[self.names.index(n) for n in self.assumed.exchanged]] = True
        return found

    def at_origin(self, surveyed: np.ndarray) -> HomeProblem:
        """Return it with home at the origin, from which `surveyed` (k, 2) were surveyed."""
        exactly = np.eye(3) * FIXED_SIGMA**-2
        return replace(self, prior=np.zeros(3), prior_information=exactly, surveyed=surveyed)

    def under(self, assumed: Assumption) -> HomeProblem:
        """Return it under an assumption; one that rejected the start does not get it back."""
        if assumed == self.assumed:
            return self
        order = np.arange(self.bearings.size)
        for pair in (self.assumed.exchanged, assumed.exchanged):
            if pair is not None:
                i, j = map(self.names.index, pair)
                order[[i, j]] = order[[j, i]]
        sigmas = assumed.noise_scale / self.assumed.noise_scale * self.sigmas[order]
        offsets = None if self.offsets is None else self.offsets[order]
        prior = (self.prior, self.prior_information) if assumed.start else (None, None)
        return replace(
            self,
            bearings=self.bearings[order],
            sigmas=sigmas,
            offsets=offsets,
            prior=prior[0],
            prior_information=prior[1],
            assumed=assumed,
        )

    @property
    def assumptions(self) -> list[Assumption]:
        """All assumptions to be tried, the usual one first."""
        noisy = [Assumption(scale) for scale in (1.0, *NOISE_SCALES)]
        doubtful = self.prior is not None and not self.surveyed.size
        return [*noisy, Assumption(start=False)] if doubtful else noisy

    @property
    def log_assumption_prior(self) -> float:
        """Log prior of the assumption."""
        noisy = self.assumed.noise_scale != 1.0
        noise = math.log(GIVEN_WRONG / len(NOISE_SCALES) if noisy else 1.0 - GIVEN_WRONG)
        if self.assumed.exchanged:
            noise += math.log(EXCHANGED / math.comb(self.bearings.size, 2))
        if self.assumed.start:
            return noise + (0.0 if self.prior is None else math.log1p(-GIVEN_WRONG))
        return noise + math.log(GIVEN_WRONG)

    @property
    def landmarks(self) -> np.ndarray:
        """Positions of the landmarks [m], shape (q, 2)."""
        return self.mean[POSE_AND_YAW:].reshape(-1, 2)

    @cached_property
    def _box(self) -> tuple[float, float, float]:
        # Of so few numbers, lists are quicker than arrays.
        x, y = self.landmarks.T.tolist()
        return max(max(x) - min(x), max(y) - min(y)), sum(x) / len(x), sum(y) / len(y)

    @property
    def extent(self) -> float:
        """Longer side of the box around the landmarks [m]."""
        return self._box[0]

    @property
    def centre(self) -> tuple[float, float]:
        """Mean of the landmarks' positions [m]."""
        return self._box[1:]

    @cached_property
    def range(self) -> float:
        """Distance of the landmarks from where they are seen, as far as known [m]."""
        if not self.bearings.size:
            return 1.0
        (x, y), robot = self.centre, self.mean[:2].tolist()
        return max(self.extent, math.hypot(x - robot[0], y - robot[1]), 1e-3)

    def step_length(self, step: np.ndarray) -> float:
        """Return the length of a step of home (3,), over the longest one that is allowed."""
        dx, dy, turn = np.abs(step).tolist()
        return float(max(max(dx, dy) / (MAX_HOME_STEP * self.range), turn / MAX_HOME_TURN))

    def log_density(self, home: np.ndarray) -> float:
        """Return the log prior density of a home (3,), but for its offset from a start prior.

        Home saw its landmarks, and so is hardly farther from them than they are from each other, or
        from the robot, which sees them too. How much farther is unknown, so the density falls off
        slowly: a Cauchy distribution in two dimensions. Without it, homes a hundred metres away
        that explain a few bearings would count as much as near ones.
        """
        if self.prior_information is not None:
            return 0.5 * float(np.linalg.slogdet(self.prior_information / TWO_PI)[1])
        if not self.bearings.size:
            return 0.0
        (x, y), near = self.centre, HOME_DISTANCE * self.range
        away = math.hypot(float(home[0]) - x, float(home[1]) - y) / near
        return -1.5 * math.log1p(away**2) - 2.0 * math.log(TWO_PI * near)

    def is_plausible(self, home: np.ndarray) -> bool:
        """Return whether a home (3,) may be within sight of its landmarks."""
        if self.prior is not None or not self.bearings.size:
            return True
        x, y = self.centre
        off = max(abs(float(home[0]) - x), abs(float(home[1]) - y))
        return off < MAX_RANGE * self.extent

    @cached_property
    def weak_prior(self) -> np.ndarray:
        """(3, 3): weak prior information on home: in sight of its landmarks."""
        if self.prior_information is not None or not self.bearings.size:
            return np.zeros((3, 3))
        near = (0.5 * MAX_RANGE * max(self.extent, 1e-3)) ** -2
        return np.array([[near, 0.0, 0.0], [0.0, near, 0.0], [0.0, 0.0, math.pi**-2]])

    @property
    def initial_information(self) -> np.ndarray:
        """(3, 3): information on home before its bearings."""
        prior = self.prior_information
        return self.weak_prior if prior is None else prior

    @cached_property
    def arrays(self) -> HomeArrays:
        """The arrays that fits and evidence depend on."""
        q = self.bearings.size
        return HomeArrays(
            self.mean,
            self.covariance,
            self.bearings,
            self.sigmas,
            self.mount,
            self.offsets,
            self.prior,
            self.initial_information,
            np.zeros((q, 2, 2)) if self.walk_excess is None else self.walk_excess,
            self.bodies.members.reshape(self.bodies.one_body.size, q),
            self.bodies.one_body,
            self.same_camera,
            self.moved_prior,
            MAX_HOME_STEP * self.range,
        )

    @property
    def min_inliers(self) -> int:
        """Home bearings that determine home."""
        return MINIMAL if self.prior is None else 0


def home_from_start(drive: DriveSettings) -> tuple[np.ndarray, np.ndarray] | None:
    """Return home's pose in the odometry frame and its information, by a start prior."""
    start = drive.start
    if start is None:
        return None
    pose, polar = np.array(from_polar(start.polar), float), start.polar
    sigmas = np.array([start.sigma_R, polar.R * start.sigma_theta, start.sigma_alpha])
    # At home itself the direction from home is undefined.
    root = rotation(float(polar.theta)) / np.sqrt(sigmas**2 + FIXED_SIGMA**2)
    home = between(pose, np.zeros(3))
    home[2] = wrap(home[2])
    # A product, since a covariance of such different numbers may be singular by rounding.
    root = rotation(pose[2]).T @ lever(pose).T @ root
    return home, root @ root.T
