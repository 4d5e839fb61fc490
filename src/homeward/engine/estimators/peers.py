"""Filters that readers of the paper would name as its peers, ready to run.

Each is made of what home saw, what is known of the robot, its settings, and how many samples are
coming, and raises `InputError` where home is empty or there is no start prior.
"""

from __future__ import annotations

import numpy as np

from homeward.drives.drive import DriveSettings
from homeward.engine.estimators.adaptive import AdaptiveRunner
from homeward.engine.estimators.online import OnlineFilter
from homeward.engine.estimators.told import (
    Seen,
    bearing_sigma,
    first,
    input_density,
    online,
    places,
    polar_filter,
    polar_runner,
    prior_sigmas,
    start_prior,
    stored,
)
from homeward.filters.ekf import ExtendedKalmanFilter
from homeward.filters.invariant import CartesianPrior, InvariantFilter, SensorNoise
from homeward.filters.particle import ParticleFilter, ParticlePrior
from homeward.filters.schmidt import SchmidtFilter
from homeward.filters.settings import (
    CartesianSettings,
    FilterSettings,
    ParticleSettings,
    SchmidtSettings,
)
from homeward.filters.unscented import UnscentedFilter
from homeward.frames import from_polar, polar_covariance_to_pose
from homeward.model import PolarModel


def adaptive(home: Seen, known: DriveSettings, told: FilterSettings, samples: int) -> OnlineFilter:
    """Return the EKF that identifies its noise."""
    kind = ExtendedKalmanFilter(PolarModel(len(home), guard=told.guard), told.integration)
    runner = polar_runner("adaptive", kind, home, known, told, samples)
    return online("adaptive", AdaptiveRunner(runner), home, known)


def schmidt(home: Seen, known: DriveSettings, told: SchmidtSettings, samples: int) -> OnlineFilter:
    """Return the EKF that considers doubtful home bearings."""
    model = PolarModel(len(home), places("doubtful", told.doubtful, home), told.guard)
    kind, doubt = SchmidtFilter(model, told.integration), told.doubt_sigma**2
    return polar_filter("schmidt", kind, home, known, told, samples, parameter_variance=doubt)


def ukf(home: Seen, known: DriveSettings, told: FilterSettings, samples: int) -> OnlineFilter:
    """Return the UKF."""
    kind = UnscentedFilter(PolarModel(len(home), guard=told.guard), told.integration)
    return polar_filter("ukf", kind, home, known, told, samples)


def invariant(home: Seen, known: DriveSettings, told: CartesianSettings, _: int) -> OnlineFilter:
    """Return the invariant EKF."""
    start, expected = start_prior("invariant", home, known), 1 / (2 * told.nearest)
    spread = np.diag(np.square(prior_sigmas(start)))
    prior = CartesianPrior(
        from_polar(start.polar),
        polar_covariance_to_pose(start.polar, spread),
        stored(home, known),
        _home_sigma(home, known, told),
        expected,
        expected,
    )
    carrier = InvariantFilter(prior, _sensor_noise(known, told), told.minimum_visible)
    return online("invariant", carrier, home, known)


def particle(home: Seen, known: DriveSettings, told: ParticleSettings, _: int) -> OnlineFilter:
    """Return the particle filter."""
    start = start_prior("particle", home, known)
    prior = ParticlePrior(
        start.polar,
        prior_sigmas(start),
        stored(home, known),
        _home_sigma(home, known, told),
        1 / (2 * told.nearest),
    )
    count, share, seed = told.particles, told.outliers, told.seed
    noise = _sensor_noise(known, told)
    carrier = ParticleFilter(prior, noise, count, share, seed, told.minimum_visible)
    return online("particle", carrier, home, known)


def _home_sigma(home: Seen, known: DriveSettings, settings: CartesianSettings) -> np.ndarray:
    default = first(settings.home_sigma, bearing_sigma(known, settings))
    own = np.array([b.sigma for b in home.values()])
    return np.where(own > 0, own, default)


def _sensor_noise(known: DriveSettings, settings: CartesianSettings) -> SensorNoise:
    sigma = bearing_sigma(known, settings)
    return SensorNoise(input_density(known, settings), sigma, settings.gate_threshold)
