"""Filters that readers of the paper would name as its peers, ready to run.

Each is made of what it is told, and raises `InputError` where home is empty or there is no start
prior.
"""

from __future__ import annotations

import numpy as np

from homeward.geometry.frames import from_polar, polar_covariance_to_pose
from homeward.lab.engine.estimators.adaptive import AdaptiveRunner
from homeward.lab.engine.estimators.online import OnlineFilter
from homeward.lab.engine.estimators.told import Told, first
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.filters.invariant import CartesianPrior, InvariantFilter, SensorNoise
from homeward.lab.filters.particle import ParticleFilter, ParticlePrior
from homeward.lab.filters.schmidt import SchmidtFilter
from homeward.lab.filters.settings import (
    CartesianSettings,
    FilterSettings,
    ParticleSettings,
    SchmidtSettings,
)
from homeward.lab.filters.unscented import UnscentedFilter


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
