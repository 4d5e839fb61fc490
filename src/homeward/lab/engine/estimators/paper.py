"""The paper's three filters and their peers, ready to run: home and robot, put into numbers.

The settings of a filter come first, then what is known of the robot, then defaults. A peer is made
of a `FilterConfig`, and raises `InputError` where home is empty or there is no start prior.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar, Unpack

import numpy as np

from homeward.drives.drive import Drive, HomeBearing
from homeward.drives.known import Home, known_home, known_robot, known_settings
from homeward.drives.settings import DriveSettings, Robot, Start
from homeward.errors import InputError, needs_start_prior
from homeward.geometry.angles import wrap
from homeward.geometry.frames import from_polar, polar_covariance_to_pose
from homeward.lab.engine.estimators.adaptive import AdaptiveRunner
from homeward.lab.engine.estimators.online import OnlineFilter
from homeward.lab.engine.estimators.runner import FilterRunner, Tuning
from homeward.lab.filters.carrier import FilterBackend
from homeward.lab.filters.ekf import (
    ExtendedKalmanFilter,
    ProportionalIntegralFilter,
    SchmidtFilter,
    UnscentedFilter,
    augmented_ekf,
)
from homeward.lab.filters.invariant import CartesianPrior, InvariantFilter, SensorNoise
from homeward.lab.filters.particle import ParticleFilter, ParticlePrior
from homeward.lab.filters.settings import (
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

Settings = TypeVar("Settings", bound=NoiseSettings, covariant=True)


@dataclass(frozen=True)
class FilterConfig(Generic[Settings]):
    """What a filter is given about home and robot."""

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

    def model(self: FilterConfig[FilterSettings], estimated: tuple[int, ...] = ()) -> PolarModel:
        """Return the paper's model of the landmarks, some of whose home bearings are states."""
        return PolarModel(len(self.home), estimated, self.settings.guard)

    def runner(
        self: FilterConfig[FilterSettings],
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
        self: FilterConfig[FilterSettings], kind: ExtendedKalmanFilter, **numbers: Any
    ) -> OnlineFilter:
        """Return a filter in the paper's state, ready to run; `numbers` are those of `runner`."""
        return self.online(self.runner(kind, **numbers))

    def online(self, carrier: FilterBackend) -> OnlineFilter:
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


Checked = TypeVar("Checked", bound=FilterSettings)


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
        What the camera saw at home, by landmark [rad]; deviations are not used.
    settings : FilterSettings or dict, optional
        Everything else.
    samples : int
        How many are coming, as far as that is known: many are worth compiling for.
    **robot : Robot
        What is known of the robot: `start`, which is needed, `sensor`, `home_sensor`, `odometry`.

    Raises
    ------
    InputError
        When something of it cannot be used, home is empty, or there is no start prior.
    """
    config = _config("ekf", home, known_settings(FilterSettings, settings), robot, samples)
    return config.filter(ExtendedKalmanFilter(config.model(), config.settings.integration))


def a_ekf(
    home: Home,
    *,
    settings: AugmentedSettings | dict[str, Any] | None = None,
    samples: int = 0,
    **robot: Unpack[Robot],
) -> OnlineFilter:
    """Return the paper's A-EKF; parameters and errors as of `ekf`."""
    config = _config("a-ekf", home, known_settings(AugmentedSettings, settings), robot, samples)
    own, q = config.settings, len(config.home)
    indices = config.places("parameters", own.parameters)
    return config.filter(
        augmented_ekf(q, indices, own.integration, own.guard),
        parameter_variance=own.parameter_sigma**2,
        parameter_density=own.parameter_walk**2,
    )


def pi_ekf(
    home: Home,
    *,
    settings: ProportionalIntegralSettings | dict[str, Any] | None = None,
    samples: int = 0,
    **robot: Unpack[Robot],
) -> OnlineFilter:
    """Return the paper's PI-EKF; parameters and errors as of `ekf`."""
    checked = known_settings(ProportionalIntegralSettings, settings)
    config = _config("pi-ekf", home, checked, robot, samples)
    own, model = config.settings, config.model()
    n, q = model.n, model.q
    # The paper counts R in cm: one unit of an innovation moves it by cm, not by m.
    scale = np.diag([0.01, *[1.0] * (n - 1)])
    pi = _matrix("proportional", own.proportional, (n, n), scale)
    return config.filter(
        ProportionalIntegralFilter(model, own.integration),
        proportional=pi / own.sample_time,
        integral_gain=_matrix("integral_gain", own.integral_gain, (n, q), np.ones((n, q))),
    )


def _config(
    name: str, home: Home, settings: Checked, robot: Robot, samples: int
) -> FilterConfig[Checked]:
    return FilterConfig(name, known_home(home), known_robot(robot), settings, samples)


def _matrix(
    name: str, value: float | Matrix, shape: tuple[int, int], unit: np.ndarray
) -> np.ndarray:
    if isinstance(value, float):
        return value * unit
    if len(value) != shape[0] or any(len(row) != shape[1] for row in value):
        raise InputError(f"{name} must be a number or have {shape[0]} rows of {shape[1]}")
    return np.array(value)


def adaptive(config: FilterConfig[FilterSettings]) -> OnlineFilter:
    """Return the EKF that identifies its noise."""
    kind = ExtendedKalmanFilter(config.model(), config.settings.integration)
    return config.online(AdaptiveRunner(config.runner(kind)))


def schmidt(config: FilterConfig[SchmidtSettings]) -> OnlineFilter:
    """Return the EKF that considers doubtful home bearings."""
    own = config.settings
    kind = SchmidtFilter(config.model(config.places("doubtful", own.doubtful)), own.integration)
    return config.filter(kind, parameter_variance=own.doubt_sigma**2)


def ukf(config: FilterConfig[FilterSettings]) -> OnlineFilter:
    """Return the UKF."""
    return config.filter(UnscentedFilter(config.model(), config.settings.integration))


def invariant(config: FilterConfig[CartesianSettings]) -> OnlineFilter:
    """Return the invariant EKF."""
    start, expected = config.start, 1 / (2 * config.settings.nearest)
    spread = np.diag(np.square(config.start_sigmas))
    prior = CartesianPrior(
        from_polar(start.polar),
        polar_covariance_to_pose(start.polar, spread),
        *(config.stored, _home_sigma(config), expected, expected),
    )
    return config.online(
        InvariantFilter(prior, _sensor_noise(config), config.settings.minimum_visible)
    )


def particle(config: FilterConfig[ParticleSettings]) -> OnlineFilter:
    """Return the particle filter."""
    own, landmarks = config.settings, (config.stored, _home_sigma(config))
    prior = ParticlePrior(
        config.start.polar, config.start_sigmas, *landmarks, 1 / (2 * own.nearest)
    )
    noise, chance = _sensor_noise(config), (own.particles, own.outliers, own.seed)
    return config.online(ParticleFilter(prior, noise, *chance, own.minimum_visible))


def _home_sigma(config: FilterConfig[CartesianSettings]) -> np.ndarray:
    own = np.array([b.sigma for b in config.home.values()])
    return np.where(own > 0, own, first(config.settings.home_sigma, config.bearing_sigma))


def _sensor_noise(config: FilterConfig[CartesianSettings]) -> SensorNoise:
    return SensorNoise(config.input_density, config.bearing_sigma, config.settings.gate_threshold)


PEERS: dict[str, Callable[[FilterConfig[Any]], OnlineFilter]] = {
    "adaptive": adaptive,
    "invariant": invariant,
    "particle": particle,
    "schmidt": schmidt,
    "ukf": ukf,
}


def filter_for(name: str, drive: Drive, settings: Any) -> OnlineFilter:
    """Return a filter by its name for a drive; for many samples it is worth compiling."""
    samples = drive.odometry.t.size + drive.sightings.t.size
    if name in PEERS:
        home = known_home(drive.home)
        return PEERS[name](FilterConfig(name, home, drive.settings, settings, samples))
    make = {"ekf": ekf, "a-ekf": a_ekf, "pi-ekf": pi_ekf}[name]
    return make(drive.home, settings=settings, samples=samples, **drive.settings.robot)
