"""What a filter is told, as its numbers: its settings first, then what is known of the robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from homeward.drives.drive import DriveSettings, HomeBearing, Start
from homeward.errors import InputError, needs_start_prior
from homeward.geometry.angles import wrap
from homeward.lab.engine.estimators.online import OnlineFilter
from homeward.lab.engine.estimators.runner import FilterRunner, Tuning
from homeward.lab.filters.carrier import Carrier
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.filters.settings import (
    DEFAULT_BEARING_SIGMA,
    DEFAULT_SPEED_SIGMA,
    DEFAULT_TURN_SIGMA,
    FilterSettings,
    NoiseSettings,
)
from homeward.lab.model import POLAR, PolarModel

Settings = TypeVar("Settings", bound=NoiseSettings, covariant=True)


@dataclass(frozen=True)
class Told(Generic[Settings]):
    """What a filter is told of home and robot."""

    name: str
    """Of the filter."""
    home: Mapping[str, HomeBearing]
    """What home saw, by landmark; q of them."""
    known: DriveSettings
    settings: Settings
    samples: int
    """How many are coming, as far as that is known: many are worth compiling for."""

    @property
    def start(self) -> Start:
        """The start prior; `InputError` where there is none, or home is empty."""
        if not self.home:
            raise InputError(f"home saw no landmark, so {self.name} has nothing to go by")
        if self.known.start is None:
            raise needs_start_prior(self.name)
        return self.known.start

    @property
    def start_sigmas(self) -> np.ndarray:
        """The deviations of its R [m], theta, alpha [rad]: (3,)."""
        start = self.start
        return np.array([start.sigma_R, start.sigma_theta, start.sigma_alpha])

    @property
    def stored(self) -> np.ndarray:
        """beta* in the robot's home frame [rad], (q,)."""
        yaw = self.known.home_mount.yaw
        return np.array([float(wrap(b.bearing + yaw)) for b in self.home.values()])

    @property
    def bearing_sigma(self) -> float:
        """The deviation of a bearing that comes without one [rad]."""
        known = self.known.sensor.bearing_sigma
        return first(self.settings.bearing_sigma, known, DEFAULT_BEARING_SIGMA)

    @property
    def input_density(self) -> np.ndarray:
        """Variance densities of speed [(m/s)^2/Hz] and turn rate [(rad/s)^2/Hz], (2,)."""
        own, known = self.settings, self.known.odometry
        speed = first(own.speed_sigma, known.speed_sigma, DEFAULT_SPEED_SIGMA)
        turn = first(own.turn_sigma, known.turn_sigma, DEFAULT_TURN_SIGMA)
        return np.square([speed, turn])

    def places(self, key: str, chosen: Literal["all"] | tuple[str, ...]) -> tuple[int, ...]:
        """Return where in the state the landmarks stand that a setting names.

        Raises `InputError` when one is named twice, or home has no bearing of it.
        """
        ids = list(self.home)
        named = ids if chosen == "all" else list(chosen)
        if unknown := [i for i in named if i not in self.home]:
            raise InputError(f"{key}: home has no bearing of landmark {unknown[0]!r}")
        if len(set(named)) != len(named):
            raise InputError(f"{key}: a landmark is named twice")
        return tuple(ids.index(i) for i in named)

    def model(self: Told[FilterSettings], estimated: tuple[int, ...] = ()) -> PolarModel:
        """Return the paper's model of the landmarks, some of whose home bearings are states."""
        return PolarModel(len(self.home), estimated, self.settings.guard)

    def runner(
        self: Told[FilterSettings],
        kind: ExtendedKalmanFilter,
        *,
        parameter_variance: float = 0.0,
        parameter_density: float = 0.0,
        proportional: np.ndarray | None = None,
        integral_gain: np.ndarray | None = None,
    ) -> FilterRunner:
        """Return a filter in the paper's state with all its numbers; errors as of `start`."""
        q, parameters = kind.model.q, np.ones(len(kind.model.estimated))
        walk, nothing = self.settings.bearing_walk**2, np.zeros((0, 0))
        before = [np.square(self.start_sigmas), np.ones(q), parameter_variance * parameters]
        density = [np.zeros(POLAR), np.full(q, walk), parameter_density * parameters]
        tuning = Tuning(
            polar=self.start.polar,
            variance=np.concatenate(before),
            stored=self.stored,
            bearing_sigma=self.bearing_sigma,
            input_density=self.input_density,
            state_density=np.concatenate(density),
            gate=self.settings.gate_threshold,
            minimum_visible=self.settings.minimum_visible,
            proportional=nothing if proportional is None else proportional,
            integral_gain=nothing if integral_gain is None else integral_gain,
        )
        return FilterRunner(kind, tuning, self.settings.engine, self.samples)

    def filter(
        self: Told[FilterSettings], kind: ExtendedKalmanFilter, **numbers: Any
    ) -> OnlineFilter:
        """Return a filter in the paper's state, ready to run; `numbers` are those of `runner`."""
        return self.online(self.runner(kind, **numbers))

    def online(self, carrier: Carrier) -> OnlineFilter:
        """Return what carries a belief as an estimator."""
        yaw = self.known.sensor.yaw
        return OnlineFilter(self.name, carrier, list(self.home), yaw, tuple(self._notes()))

    def _notes(self) -> list[str]:
        """Say which assumptions of the paper are not met."""
        mounts = self.known.sensor, self.known.home_mount
        off, notes = max(math.hypot(mount.x, mount.y) for mount in mounts), []
        if off > 0:
            notes.append(
                f"{self.name} takes the camera to be at the robot's centre; here it is "
                f"{off:.2f} m from it, which bends every bearing."
            )
        if self.name == "pi-ekf":
            notes.append(
                "pi-ekf integrates innovations for ever, as printed; on long drives that winds up "
                "(integral_gain=0 leaves the EKF)."
            )
        return notes


def first(*values: float | None) -> float:
    """Return the first of some values that is one."""
    return next(v for v in values if v is not None)
