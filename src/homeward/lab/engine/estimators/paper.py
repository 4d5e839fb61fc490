"""The paper's three filters and their peers, ready to run: home and robot, put into numbers.

A peer is made of a `Told`, and raises `InputError` where home is empty or there is no start prior.
"""

from __future__ import annotations

from typing import Any, TypeVar, Unpack

import numpy as np

from homeward.drives.drive import Robot
from homeward.drives.known import Home, known_home, known_robot, known_settings
from homeward.errors import InputError
from homeward.geometry.frames import from_polar, polar_covariance_to_pose
from homeward.lab.engine.estimators.adaptive import AdaptiveRunner
from homeward.lab.engine.estimators.online import OnlineFilter
from homeward.lab.engine.estimators.told import Told, first
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
    AugmentedSettings,
    CartesianSettings,
    FilterSettings,
    Matrix,
    ParticleSettings,
    ProportionalIntegralSettings,
    SchmidtSettings,
)

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
    told = _told("ekf", home, known_settings(FilterSettings, settings), robot, samples)
    return told.filter(ExtendedKalmanFilter(told.model(), told.settings.integration))


def a_ekf(
    home: Home,
    *,
    settings: AugmentedSettings | dict[str, Any] | None = None,
    samples: int = 0,
    **robot: Unpack[Robot],
) -> OnlineFilter:
    """Return the paper's A-EKF; parameters and errors as of `ekf`."""
    told = _told("a-ekf", home, known_settings(AugmentedSettings, settings), robot, samples)
    own, q = told.settings, len(told.home)
    indices = told.places("parameters", own.parameters)
    return told.filter(
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
    told = _told("pi-ekf", home, checked, robot, samples)
    own, model = told.settings, told.model()
    n, q = model.n, model.q
    # The paper counts R in cm: one unit of an innovation moves it by cm, not by m.
    scale = np.diag([0.01, *[1.0] * (n - 1)])
    pi = _matrix("proportional", own.proportional, (n, n), scale)
    return told.filter(
        ProportionalIntegralFilter(model, own.integration),
        proportional=pi / own.sample_time,
        integral_gain=_matrix("integral_gain", own.integral_gain, (n, q), np.ones((n, q))),
    )


def _told(name: str, home: Home, settings: Checked, robot: Robot, samples: int) -> Told[Checked]:
    return Told(name, known_home(home), known_robot(robot), settings, samples)


def _matrix(
    name: str, value: float | Matrix, shape: tuple[int, int], unit: np.ndarray
) -> np.ndarray:
    if isinstance(value, float):
        return value * unit
    if len(value) != shape[0] or any(len(row) != shape[1] for row in value):
        raise InputError(f"{name} must be a number or have {shape[0]} rows of {shape[1]}")
    return np.array(value)


def adaptive(told: Told[FilterSettings]) -> OnlineFilter:
    """Return the EKF that identifies its noise."""
    kind = ExtendedKalmanFilter(told.model(), told.settings.integration)
    return told.online(AdaptiveRunner(told.runner(kind)))


def schmidt(told: Told[SchmidtSettings]) -> OnlineFilter:
    """Return the EKF that considers doubtful home bearings."""
    own = told.settings
    kind = SchmidtFilter(told.model(told.places("doubtful", own.doubtful)), own.integration)
    return told.filter(kind, parameter_variance=own.doubt_sigma**2)


def ukf(told: Told[FilterSettings]) -> OnlineFilter:
    """Return the UKF."""
    return told.filter(UnscentedFilter(told.model(), told.settings.integration))


def invariant(told: Told[CartesianSettings]) -> OnlineFilter:
    """Return the invariant EKF."""
    start, expected = told.start, 1 / (2 * told.settings.nearest)
    spread = np.diag(np.square(told.start_sigmas))
    prior = CartesianPrior(
        from_polar(start.polar),
        polar_covariance_to_pose(start.polar, spread),
        *(told.stored, _home_sigma(told), expected, expected),
    )
    return told.online(InvariantFilter(prior, _sensor_noise(told), told.settings.minimum_visible))


def particle(told: Told[ParticleSettings]) -> OnlineFilter:
    """Return the particle filter."""
    own, landmarks = told.settings, (told.stored, _home_sigma(told))
    prior = ParticlePrior(told.start.polar, told.start_sigmas, *landmarks, 1 / (2 * own.nearest))
    noise, chance = _sensor_noise(told), (own.particles, own.outliers, own.seed)
    return told.online(ParticleFilter(prior, noise, *chance, own.minimum_visible))


def _home_sigma(told: Told[CartesianSettings]) -> np.ndarray:
    own = np.array([b.sigma for b in told.home.values()])
    return np.where(own > 0, own, first(told.settings.home_sigma, told.bearing_sigma))


def _sensor_noise(told: Told[CartesianSettings]) -> SensorNoise:
    return SensorNoise(told.input_density, told.bearing_sigma, told.settings.gate_threshold)
