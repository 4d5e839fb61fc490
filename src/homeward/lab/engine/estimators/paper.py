"""The paper's three filters, ready to run: what is known of home and robot, put into numbers."""

from __future__ import annotations

from typing import Any, TypeVar, Unpack

import numpy as np

from homeward.drives.drive import Robot
from homeward.drives.known import Home, known_home, known_robot, known_settings
from homeward.errors import InputError
from homeward.lab.engine.estimators.online import OnlineFilter
from homeward.lab.engine.estimators.told import Told
from homeward.lab.filters.augmented import augmented_ekf
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.filters.proportional_integral import ProportionalIntegralFilter
from homeward.lab.filters.settings import (
    AugmentedSettings,
    FilterSettings,
    Matrix,
    ProportionalIntegralSettings,
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
