"""Constructors of the paper's three filters and their peers.

A filter's own settings take precedence over the drive's, and these over defaults. All are made from
a `FilterConfig` by the functions in `MAKERS`, which raise `InputError` where home is empty or there
is no start prior.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, Literal, TypeVar, Unpack

import numpy as np

from homeward.drives.drive import Drive, HomeBearing
from homeward.drives.robot import Home, known_home, known_robot, known_settings
from homeward.drives.settings import DriveSettings, Robot
from homeward.errors import InputError, needs_start_prior
from homeward.geometry.angles import wrap
from homeward.lab.engine.estimators.adaptive import AdaptiveRunner
from homeward.lab.engine.estimators.online import OnlineFilter
from homeward.lab.engine.estimators.runner import FilterRunner, Tuning
from homeward.lab.filters.backend import FilterBackend, Setup
from homeward.lab.filters.ekf import (
    ExtendedKalmanFilter,
    ProportionalIntegralFilter,
    SchmidtFilter,
    UnscentedFilter,
    augmented_ekf,
)
from homeward.lab.filters.invariant import InvariantFilter
from homeward.lab.filters.particle import ParticleFilter
from homeward.lab.filters.settings import (
    BEARING_WALK,
    DEFAULT_BEARING_SIGMA,
    DEFAULT_SPEED_SIGMA,
    DEFAULT_TURN_SIGMA,
    AugmentedSettings,
    CartesianSettings,
    FilterSettings,
    Matrix,
    NoiseSettings,
    ParticleSettings,
    ProportionalIntegralSettings,
    SchmidtSettings,
)
from homeward.lab.model import POLAR, PolarModel
from homeward.sighting_keys import is_unlabelled

Settings = TypeVar("Settings", bound=NoiseSettings, covariant=True)


@dataclass(frozen=True)
class FilterConfig(Generic[Settings]):
    """Home, robot and settings of a filter."""

    name: str
    """Name of the filter."""
    home: Mapping[str, HomeBearing]
    """Home bearings of q landmarks."""
    known: DriveSettings
    settings: Settings
    samples: int
    """Number of samples to come, 0 where unknown; many samples pay for compiling."""

    @property
    def setup(self) -> Setup:
        """What every filter is given; `InputError` where home is empty or has no start prior."""
        own, known, start = self.settings, self.known, self.known.start
        if not self.home:
            raise InputError(f"home saw no landmark: {self.name} needs home bearings")
        if start is None:
            raise needs_start_prior(self.name)
        bearing = own.bearing_sigma, known.sensor.bearing_sigma, DEFAULT_BEARING_SIGMA
        speed = own.speed_sigma, known.odometry.speed_sigma, DEFAULT_SPEED_SIGMA
        turn = own.turn_sigma, known.odometry.turn_sigma, DEFAULT_TURN_SIGMA
        yaw = known.home_mount.yaw
        return Setup(
            polar=start.polar,
            sigmas=np.array([start.sigma_R, start.sigma_theta, start.sigma_alpha]),
            stored=np.array([float(wrap(b.bearing + yaw)) for b in self.home.values()]),
            bearing_sigma=first_given(*bearing),
            input_density=np.square([first_given(*speed), first_given(*turn)]),
            gate=own.gate_threshold,
            minimum_visible=own.minimum_visible,
        )

    def indices(self, key: str, chosen: Literal["all"] | tuple[str, ...]) -> tuple[int, ...]:
        """Return the indices of the landmarks that a setting names.

        Raises `InputError` when a landmark is named twice or has no home bearing.
        """
        ids = list(self.home)
        named = ids if chosen == "all" else list(chosen)
        if unknown := [i for i in named if i not in self.home]:
            raise InputError(f"{key}: home has no bearing of landmark {unknown[0]!r}")
        if len(set(named)) != len(named):
            raise InputError(f"{key}: a landmark is named twice")
        return tuple(ids.index(i) for i in named)

    def model(self: FilterConfig[FilterSettings], estimated: tuple[int, ...] = ()) -> PolarModel:
        """Return the paper's model with some home bearings as states."""
        return PolarModel(len(self.home), estimated, self.settings.guard)

    def filter(
        self: FilterConfig[FilterSettings],
        kind: ExtendedKalmanFilter,
        make: type[FilterRunner] = FilterRunner,
        **numbers: Any,
    ) -> OnlineFilter:
        """Return a filter in the paper's state as an estimator; `numbers` as for `tuning`."""
        tuning = self.tuning(kind, **numbers)
        return self.online(make(kind, tuning, self.settings.engine, self.samples))

    def tuning(
        self: FilterConfig[FilterSettings],
        kind: ExtendedKalmanFilter,
        *,
        parameter_variance: float = 0.0,
        parameter_density: float = 0.0,
        proportional: np.ndarray | None = None,
        integral_gain: np.ndarray | None = None,
    ) -> Tuning:
        """Return the tuning of a filter in the paper's state; errors as of `setup`."""
        q, parameters = kind.model.q, np.ones(len(kind.model.estimated))
        setup, walk, nothing = self.setup, BEARING_WALK**2, np.zeros((0, 0))
        before = [np.square(setup.sigmas), np.ones(q), parameter_variance * parameters]
        density = [np.zeros(POLAR), np.full(q, walk), parameter_density * parameters]
        return Tuning(
            **vars(setup),
            variance=np.concatenate(before),
            state_density=np.concatenate(density),
            proportional=nothing if proportional is None else proportional,
            integral_gain=nothing if integral_gain is None else integral_gain,
        )

    def online(self, backend: FilterBackend) -> OnlineFilter:
        """Return a backend as an estimator."""
        yaw = self.known.sensor.yaw
        return OnlineFilter(self.name, backend, list(self.home), yaw, tuple(self._notes()))

    def _notes(self) -> list[str]:
        """Return the assumptions of the paper that are not met."""
        mounts = self.known.sensor, self.known.home_mount
        off, notes = max(math.hypot(mount.x, mount.y) for mount in mounts), []
        if off > 0:
            notes.append(
                f"{self.name} assumes the camera at the robot's centre; here it is {off:.2f} m "
                "away, which biases every bearing."
            )
        if self.name == "pi-ekf":
            notes.append(
                "pi-ekf integrates innovations without decay, as in the paper; on long drives the "
                "integral grows. Use integral_gain=0 (EKF) for these."
            )
        return notes


def first_given(*values: float | None) -> float:
    """Return the first value that is not None."""
    return next(v for v in values if v is not None)


def ekf(
    home: Home,
    *,
    settings: FilterSettings | dict[str, Any] | None = None,
    samples: int = 0,
    **robot: Unpack[Robot],
) -> OnlineFilter:
    """Return the paper's EKF.

    Parameters
    ----------
    home : dict of str to float or HomeBearing
        Home bearings by landmark [rad]; their sigmas are not used.
    settings : FilterSettings or dict, optional
        Settings of the filter.
    samples : int
        Number of samples to come, 0 where unknown; many samples pay for compiling.
    **robot : Robot
        The robot: `start`, which is required, `sensor`, `home_sensor`, `odometry`.

    Raises
    ------
    InputError
        When a value is invalid, home is empty, or there is no start prior.
    """
    return _made("ekf", home, known_settings(FilterSettings, settings), robot, samples)


def a_ekf(
    home: Home,
    *,
    settings: AugmentedSettings | dict[str, Any] | None = None,
    samples: int = 0,
    **robot: Unpack[Robot],
) -> OnlineFilter:
    """Return the paper's A-EKF; parameters and errors as of `ekf`."""
    return _made("a-ekf", home, known_settings(AugmentedSettings, settings), robot, samples)


def pi_ekf(
    home: Home,
    *,
    settings: ProportionalIntegralSettings | dict[str, Any] | None = None,
    samples: int = 0,
    **robot: Unpack[Robot],
) -> OnlineFilter:
    """Return the paper's PI-EKF; parameters and errors as of `ekf`."""
    checked = known_settings(ProportionalIntegralSettings, settings)
    return _made("pi-ekf", home, checked, robot, samples)


def filter_for(name: str, drive: Drive, settings: Any) -> OnlineFilter:
    """Return a filter by its name for a drive."""
    samples = drive.odometry.t.size + drive.sightings.t.size
    return _made(name, drive.home, settings, drive.settings.robot, samples)


def _made(
    name: str, home: Home, settings: NoiseSettings, robot: Robot, samples: int
) -> OnlineFilter:
    known = known_home(home)
    if any(map(is_unlabelled, known)):
        raise InputError(f"home has landmarks without ids, and {name} needs an id for each")
    return MAKERS[name](FilterConfig(name, known, known_robot(robot), settings, samples))


def _extended(
    config: FilterConfig[FilterSettings], make: type[FilterRunner] = FilterRunner
) -> OnlineFilter:
    kind = ExtendedKalmanFilter(config.model(), config.settings.integration)
    return config.filter(kind, make)


def _augmented(config: FilterConfig[AugmentedSettings]) -> OnlineFilter:
    own = config.settings
    indices = config.indices("parameters", own.parameters)
    return config.filter(
        augmented_ekf(len(config.home), indices, own.integration, own.guard),
        parameter_variance=own.parameter_sigma**2,
        parameter_density=own.parameter_walk**2,
    )


def _proportional_integral(config: FilterConfig[ProportionalIntegralSettings]) -> OnlineFilter:
    own, model = config.settings, config.model()
    n, q = model.n, model.q
    # The paper's R is in cm: one unit of an innovation moves it by 1 cm, not 1 m.
    scale = np.diag([0.01, *[1.0] * (n - 1)])
    pi = _matrix("proportional", own.proportional, (n, n), scale)
    return config.filter(
        ProportionalIntegralFilter(model, own.integration),
        proportional=pi / own.sample_time,
        integral_gain=_matrix("integral_gain", own.integral_gain, (n, q), np.ones((n, q))),
    )


def _matrix(
    name: str, value: float | Matrix, shape: tuple[int, int], unit: np.ndarray
) -> np.ndarray:
    if isinstance(value, float):
        return value * unit
    if len(value) != shape[0] or any(len(row) != shape[1] for row in value):
        raise InputError(f"{name} must be a number or have {shape[0]} rows of {shape[1]}")
    return np.array(value)


def _considered(config: FilterConfig[SchmidtSettings]) -> OnlineFilter:
    own = config.settings
    kind = SchmidtFilter(config.model(config.indices("doubtful", own.doubtful)), own.integration)
    return config.filter(kind, parameter_variance=own.doubt_sigma**2)


def _unscented(config: FilterConfig[FilterSettings]) -> OnlineFilter:
    return config.filter(UnscentedFilter(config.model(), config.settings.integration))


def _invariant(config: FilterConfig[CartesianSettings]) -> OnlineFilter:
    return config.online(InvariantFilter(*_cartesian(config)))


def _particle(config: FilterConfig[ParticleSettings]) -> OnlineFilter:
    own = config.settings
    sampling = own.particles, own.outliers, own.seed
    return config.online(ParticleFilter(*_cartesian(config), *sampling))


def _cartesian(
    config: FilterConfig[CartesianSettings],
) -> tuple[Setup, np.ndarray, tuple[float, float]]:
    """Return the arguments of a `CartesianFilter`."""
    setup, own, expected = config.setup, config.settings, 1 / (2 * config.settings.nearest)
    sigmas = np.array([b.sigma for b in config.home.values()])
    usual = first_given(own.home_sigma, setup.bearing_sigma)
    return setup, np.where(sigmas > 0, sigmas, usual), (expected, expected)


MAKERS: dict[str, Callable[[FilterConfig[Any]], OnlineFilter]] = {
    "ekf": _extended,
    "a-ekf": _augmented,
    "pi-ekf": _proportional_integral,
    "adaptive": partial(_extended, make=AdaptiveRunner),
    "invariant": _invariant,
    "particle": _particle,
    "schmidt": _considered,
    "ukf": _unscented,
}
"""By name."""
