"""The paper's three filters, ready to run: what is known of home and robot, put into numbers."""

from __future__ import annotations

from typing import Any, Unpack

import numpy as np

from homeward.drives.drive import Robot
from homeward.drives.known import Home, known_home, known_robot, known_settings
from homeward.engine.estimators.online import OnlineFilter
from homeward.engine.estimators.told import places, polar_filter
from homeward.errors import InputError
from homeward.filters.augmented import augmented_ekf
from homeward.filters.ekf import ExtendedKalmanFilter
from homeward.filters.proportional_integral import ProportionalIntegralFilter
from homeward.filters.settings import (
    AugmentedSettings,
    FilterSettings,
    Matrix,
    ProportionalIntegralSettings,
)
from homeward.model import PolarModel


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
    told = known_settings(FilterSettings, settings)
    seen = known_home(home)
    kind = ExtendedKalmanFilter(PolarModel(len(seen), guard=told.guard), told.integration)
    return polar_filter("ekf", kind, seen, known_robot(robot), told, samples)


def a_ekf(
    home: Home,
    *,
    settings: AugmentedSettings | dict[str, Any] | None = None,
    samples: int = 0,
    **robot: Unpack[Robot],
) -> OnlineFilter:
    """Return the paper's A-EKF; parameters and errors as of `ekf`."""
    told = known_settings(AugmentedSettings, settings)
    seen = known_home(home)
    indices = places("parameters", told.parameters, seen)
    kind = augmented_ekf(len(seen), indices, told.integration, told.guard)
    return polar_filter(
        "a-ekf",
        kind,
        seen,
        known_robot(robot),
        told,
        samples,
        parameter_variance=told.parameter_sigma**2,
        parameter_density=told.parameter_walk**2,
    )


def pi_ekf(
    home: Home,
    *,
    settings: ProportionalIntegralSettings | dict[str, Any] | None = None,
    samples: int = 0,
    **robot: Unpack[Robot],
) -> OnlineFilter:
    """Return the paper's PI-EKF; parameters and errors as of `ekf`."""
    told = known_settings(ProportionalIntegralSettings, settings)
    seen = known_home(home)
    q = len(seen)
    model = PolarModel(q, guard=told.guard)
    kind = ProportionalIntegralFilter(model, told.integration)
    scale = np.eye(model.n)
    # The paper counts R in cm: one unit of an innovation moves it by cm, not by m.
    scale[0, 0] = 0.01
    pi = _matrix("proportional", told.proportional, (model.n, model.n), scale)
    m = _matrix("integral_gain", told.integral_gain, (model.n, q), np.ones((model.n, q)))
    return polar_filter(
        "pi-ekf",
        kind,
        seen,
        known_robot(robot),
        told,
        samples,
        proportional=pi / told.sample_time,
        integral_gain=m,
    )


def _matrix(
    name: str, value: float | Matrix, shape: tuple[int, int], unit: np.ndarray
) -> np.ndarray:
    if isinstance(value, float):
        return value * unit
    if len(value) != shape[0] or any(len(row) != shape[1] for row in value):
        raise InputError(f"{name} must be a number or have {shape[0]} rows of {shape[1]}")
    return np.array(value)
