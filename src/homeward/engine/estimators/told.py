"""What is known of home and robot as a filter's numbers: its settings first, then the robot's."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from homeward.angles import wrap
from homeward.drives.drive import DriveSettings, HomeBearing, Start
from homeward.engine.estimators.online import OnlineFilter
from homeward.engine.estimators.runner import FilterRunner, Tuning
from homeward.errors import InputError
from homeward.filters.carrier import Carrier
from homeward.filters.ekf import ExtendedKalmanFilter
from homeward.filters.settings import (
    DEFAULT_BEARING_SIGMA,
    DEFAULT_SPEED_SIGMA,
    DEFAULT_TURN_SIGMA,
    FilterSettings,
    NoiseSettings,
)
from homeward.model import POLAR

Seen = Mapping[str, HomeBearing]
"""What home saw, by landmark."""


def polar_runner(
    name: str,
    kind: ExtendedKalmanFilter,
    home: Seen,
    known: DriveSettings,
    settings: FilterSettings,
    samples: int,
    *,
    parameter_variance: float = 0.0,
    parameter_density: float = 0.0,
    proportional: np.ndarray | None = None,
    integral_gain: np.ndarray | None = None,
) -> FilterRunner:
    """Return a filter in the paper's state with all its numbers.

    Raises
    ------
    InputError
        When home is empty, or there is no start prior.
    """
    model, start = kind.model, start_prior(name, home, known)
    parameters = len(model.estimated)
    tuning = Tuning(
        polar=start.polar,
        variance=np.concatenate(
            [
                np.square(prior_sigmas(start)),
                np.ones(model.q),
                np.full(parameters, parameter_variance),
            ]
        ),
        stored=stored(home, known),
        bearing_sigma=bearing_sigma(known, settings),
        input_density=input_density(known, settings),
        state_density=np.concatenate(
            [
                np.zeros(POLAR),
                np.full(model.q, settings.bearing_walk**2),
                np.full(parameters, parameter_density),
            ]
        ),
        gate=settings.gate_threshold,
        minimum_visible=settings.minimum_visible,
        proportional=np.zeros((0, 0)) if proportional is None else proportional,
        integral_gain=np.zeros((0, 0)) if integral_gain is None else integral_gain,
    )
    return FilterRunner(kind, tuning, settings.engine, samples)


def polar_filter(
    name: str,
    kind: ExtendedKalmanFilter,
    home: Seen,
    known: DriveSettings,
    settings: FilterSettings,
    samples: int,
    **numbers: Any,
) -> OnlineFilter:
    """Return a filter in the paper's state, ready to run; see `polar_runner`."""
    return online(
        name, polar_runner(name, kind, home, known, settings, samples, **numbers), home, known
    )


def online(name: str, carrier: Carrier, home: Seen, known: DriveSettings) -> OnlineFilter:
    """Return what carries a belief as an estimator."""
    return OnlineFilter(name, carrier, list(home), known.sensor.yaw, _notes(name, known))


def start_prior(name: str, home: Seen, known: DriveSettings) -> Start:
    """Return the start prior, or raise InputError where a filter lacks something."""
    if not home:
        raise InputError(f"home saw no landmark, so {name} has nothing to go by")
    if known.start is None:
        raise InputError(
            f"{name} needs a start prior: start in drive.yaml, or --start R,THETA,ALPHA"
        )
    return known.start


def prior_sigmas(start: Start) -> np.ndarray:
    """Return the deviations of R [m], theta, alpha [rad]: (3,)."""
    return np.array([start.sigma_R, start.sigma_theta, start.sigma_alpha])


def stored(home: Seen, known: DriveSettings) -> np.ndarray:
    """Return beta* in the robot's home frame [rad], (q,)."""
    return np.array([float(wrap(b.bearing + known.home_mount.yaw)) for b in home.values()])


def bearing_sigma(known: DriveSettings, settings: NoiseSettings) -> float:
    """Return the deviation of a bearing that comes without one [rad]."""
    return first(settings.bearing_sigma, known.sensor.bearing_sigma, DEFAULT_BEARING_SIGMA)


def input_density(known: DriveSettings, settings: NoiseSettings) -> np.ndarray:
    """Return variance densities of speed [(m/s)^2/Hz] and turn rate [(rad/s)^2/Hz], (2,)."""
    speed = first(settings.speed_sigma, known.odometry.speed_sigma, DEFAULT_SPEED_SIGMA)
    turn = first(settings.turn_sigma, known.odometry.turn_sigma, DEFAULT_TURN_SIGMA)
    return np.square([speed, turn])


def places(key: str, chosen: Literal["all"] | tuple[str, ...], home: Seen) -> tuple[int, ...]:
    """Return where in the state the landmarks stand that a setting names.

    Raises
    ------
    InputError
        When one is named twice, or home has no bearing of it.
    """
    ids = list(home)
    named = ids if chosen == "all" else list(chosen)
    if unknown := [i for i in named if i not in home]:
        raise InputError(f"{key}: home has no bearing of landmark {unknown[0]!r}")
    if len(set(named)) != len(named):
        raise InputError(f"{key}: a landmark is named twice")
    return tuple(ids.index(i) for i in named)


def first(*values: float | None) -> float:
    """Return the first of some values that is one."""
    return next(v for v in values if v is not None)


def _notes(name: str, known: DriveSettings) -> tuple[str, ...]:
    """Say which assumptions of the paper are not met."""
    offsets = [math.hypot(mount.x, mount.y) for mount in (known.sensor, known.home_mount)]
    notes = []
    if max(offsets) > 0:
        notes.append(
            f"{name} takes the camera to be at the robot's centre; here it is "
            f"{max(offsets):.2f} m from it, which bends every bearing."
        )
    if name == "pi-ekf":
        notes.append(
            "pi-ekf integrates innovations for ever, as printed; on long drives that winds up "
            "(integral_gain=0 leaves the EKF)."
        )
    return tuple(notes)
