"""The paper's three filters, ready to run: what is known of home and robot, put into numbers."""

from __future__ import annotations

import math
from typing import Any, Unpack

import numpy as np

from homeward.angles import wrap
from homeward.drives.drive import DriveSettings, HomeBearing, Robot
from homeward.drives.known import Home, known_home, known_robot, known_settings
from homeward.engine.online import OnlineFilter
from homeward.engine.runner import Tuning
from homeward.errors import InputError
from homeward.filters.augmented import augmented_ekf
from homeward.filters.ekf import ExtendedKalmanFilter
from homeward.filters.proportional_integral import ProportionalIntegralFilter
from homeward.filters.settings import (
    DEFAULT_BEARING_SIGMA,
    DEFAULT_SPEED_SIGMA,
    DEFAULT_TURN_SIGMA,
    AugmentedSettings,
    FilterSettings,
    Matrix,
    ProportionalIntegralSettings,
)
from homeward.model import POLAR, PolarModel


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
    return _online("ekf", kind, seen, known_robot(robot), told, samples)


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
    ids = list(seen)
    chosen = ids if told.parameters == "all" else list(told.parameters)
    if unknown := [i for i in chosen if i not in seen]:
        raise InputError(f"parameters: home has no bearing of landmark {unknown[0]!r}")
    if len(set(chosen)) != len(chosen):
        raise InputError("parameters: a landmark is named twice")
    indices = tuple(ids.index(i) for i in chosen)
    kind = augmented_ekf(len(ids), indices, told.integration, told.guard)
    return _online(
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
    return _online(
        "pi-ekf",
        kind,
        seen,
        known_robot(robot),
        told,
        samples,
        proportional=pi / told.sample_time,
        integral_gain=m,
    )


def _online(
    name: str,
    kind: ExtendedKalmanFilter,
    home: dict[str, HomeBearing],
    known: DriveSettings,
    settings: FilterSettings,
    samples: int,
    parameter_variance: float = 0.0,
    parameter_density: float = 0.0,
    proportional: np.ndarray | None = None,
    integral_gain: np.ndarray | None = None,
) -> OnlineFilter:
    """Put a filter's numbers together: its settings first, then the robot's, then defaults."""
    if not home:
        raise InputError(f"home saw no landmark, so {name} has nothing to go by")
    model, start = kind.model, known.start
    if start is None:
        raise InputError(
            f"{name} needs a start prior: start in drive.yaml, or --start R,THETA,ALPHA"
        )
    speed = _first(settings.speed_sigma, known.odometry.speed_sigma, DEFAULT_SPEED_SIGMA)
    turn = _first(settings.turn_sigma, known.odometry.turn_sigma, DEFAULT_TURN_SIGMA)
    parameters = len(model.estimated)
    tuning = Tuning(
        polar=start.polar,
        variance=np.concatenate(
            [
                np.square([start.sigma_R, start.sigma_theta, start.sigma_alpha]),
                np.ones(model.q),
                np.full(parameters, parameter_variance),
            ]
        ),
        stored=np.array([float(wrap(b.bearing + known.home_mount.yaw)) for b in home.values()]),
        bearing_sigma=_first(
            settings.bearing_sigma, known.sensor.bearing_sigma, DEFAULT_BEARING_SIGMA
        ),
        input_density=np.square([speed, turn]),
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
    yaw, notes = known.sensor.yaw, _notes(name, known)
    return OnlineFilter(name, kind, list(home), yaw, tuning, notes, settings.engine, samples)


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


def _matrix(
    name: str, value: float | Matrix, shape: tuple[int, int], unit: np.ndarray
) -> np.ndarray:
    if isinstance(value, float):
        return value * unit
    if len(value) != shape[0] or any(len(row) != shape[1] for row in value):
        raise InputError(f"{name} must be a number or have {shape[0]} rows of {shape[1]}")
    return np.array(value)


def _first(*values: float | None) -> float:
    return next(v for v in values if v is not None)
