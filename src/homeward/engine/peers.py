"""Filters that readers of the paper would name as its peers, ready to run."""

from __future__ import annotations

from typing import Any, Unpack

import numpy as np

from homeward.drives.drive import DriveSettings, Robot
from homeward.drives.known import Home, known_home, known_robot, known_settings
from homeward.engine.adaptive import AdaptiveRunner
from homeward.engine.online import OnlineFilter
from homeward.engine.told import (
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


def adaptive(
    home: Home,
    *,
    settings: FilterSettings | dict[str, Any] | None = None,
    samples: int = 0,
    **robot: Unpack[Robot],
) -> OnlineFilter:
    """Return the EKF that identifies its noise; see `homeward.engine.paper.ekf`."""
    told, seen, known = (
        known_settings(FilterSettings, settings),
        known_home(home),
        known_robot(robot),
    )
    kind = ExtendedKalmanFilter(PolarModel(len(seen), guard=told.guard), told.integration)
    runner = polar_runner("adaptive", kind, seen, known, told, samples)
    return online("adaptive", AdaptiveRunner(runner), seen, known)


def schmidt(
    home: Home,
    *,
    settings: SchmidtSettings | dict[str, Any] | None = None,
    samples: int = 0,
    **robot: Unpack[Robot],
) -> OnlineFilter:
    """Return the EKF that considers doubtful home bearings; see `homeward.engine.paper.ekf`."""
    told, seen = known_settings(SchmidtSettings, settings), known_home(home)
    model = PolarModel(len(seen), places("doubtful", told.doubtful, seen), told.guard)
    kind, doubt = SchmidtFilter(model, told.integration), told.doubt_sigma**2
    known = known_robot(robot)
    return polar_filter("schmidt", kind, seen, known, told, samples, parameter_variance=doubt)


def ukf(
    home: Home,
    *,
    settings: FilterSettings | dict[str, Any] | None = None,
    samples: int = 0,
    **robot: Unpack[Robot],
) -> OnlineFilter:
    """Return the UKF; see `homeward.engine.paper.ekf`."""
    told, seen = known_settings(FilterSettings, settings), known_home(home)
    kind = UnscentedFilter(PolarModel(len(seen), guard=told.guard), told.integration)
    return polar_filter("ukf", kind, seen, known_robot(robot), told, samples)


def invariant(
    home: Home,
    *,
    settings: CartesianSettings | dict[str, Any] | None = None,
    samples: int = 0,
    **robot: Unpack[Robot],
) -> OnlineFilter:
    """Return the invariant EKF; see `homeward.engine.paper.ekf`. `samples` changes nothing."""
    told, seen, known = (
        known_settings(CartesianSettings, settings),
        known_home(home),
        known_robot(robot),
    )
    start, expected = start_prior("invariant", seen, known), 1 / (2 * told.nearest)
    spread = np.diag(np.square(prior_sigmas(start)))
    prior = CartesianPrior(
        from_polar(start.polar),
        polar_covariance_to_pose(start.polar, spread),
        stored(seen, known),
        _home_sigma(seen, known, told),
        expected,
        expected,
    )
    carrier = InvariantFilter(prior, _sensor_noise(known, told), told.minimum_visible)
    return online("invariant", carrier, seen, known)


def particle(
    home: Home,
    *,
    settings: ParticleSettings | dict[str, Any] | None = None,
    samples: int = 0,
    **robot: Unpack[Robot],
) -> OnlineFilter:
    """Return the particle filter; see `homeward.engine.paper.ekf`. `samples` changes nothing."""
    told, seen, known = (
        known_settings(ParticleSettings, settings),
        known_home(home),
        known_robot(robot),
    )
    start = start_prior("particle", seen, known)
    prior = ParticlePrior(
        start.polar,
        prior_sigmas(start),
        stored(seen, known),
        _home_sigma(seen, known, told),
        1 / (2 * told.nearest),
    )
    count, share, seed = told.particles, told.outliers, told.seed
    noise = _sensor_noise(known, told)
    carrier = ParticleFilter(prior, noise, count, share, seed, told.minimum_visible)
    return online("particle", carrier, seen, known)


def _home_sigma(home: Seen, known: DriveSettings, settings: CartesianSettings) -> np.ndarray:
    default = first(settings.home_sigma, bearing_sigma(known, settings))
    own = np.array([b.sigma for b in home.values()])
    return np.where(own > 0, own, default)


def _sensor_noise(known: DriveSettings, settings: CartesianSettings) -> SensorNoise:
    sigma = bearing_sigma(known, settings)
    return SensorNoise(input_density(known, settings), sigma, settings.gate_threshold)
