"""Estimators by name, each with its settings: how commands and studies make one for a drive."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from homeward.drives.drive import Drive, Strict
from homeward.drives.settings import validated
from homeward.engine.online import OnlineFilter
from homeward.engine.runner import Tuning
from homeward.errors import InputError
from homeward.estimator import Estimator
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
from homeward.localizer.localizer import Localizer
from homeward.localizer.settings import LocalizerSettings
from homeward.model import POLAR, PolarModel


def make_robust(drive: Drive, settings: LocalizerSettings) -> Estimator:
    """Return the robust localiser for a drive; with an eye on home's picture where there is one."""
    localizer = Localizer(drive.home, drive.settings, settings)
    if type(drive) is Drive:
        return localizer
    # Imported here alone: what only reads logs needs no images.
    from homeward.vision.recorded import RecordedSight, SeenDrive

    return RecordedSight(localizer, drive) if isinstance(drive, SeenDrive) else localizer


def make_ekf(drive: Drive, settings: FilterSettings) -> OnlineFilter:
    """Return the paper's EKF for a drive."""
    model = PolarModel(len(drive.home), guard=settings.guard)
    kind = ExtendedKalmanFilter(model, settings.integration)
    return _online("ekf", kind, drive, settings)


def make_augmented(drive: Drive, settings: AugmentedSettings) -> OnlineFilter:
    """Return the paper's A-EKF for a drive."""
    ids = list(drive.home)
    chosen = ids if settings.parameters == "all" else list(settings.parameters)
    if unknown := [i for i in chosen if i not in drive.home]:
        raise InputError(f"parameters: home has no bearing of landmark {unknown[0]!r}")
    if len(set(chosen)) != len(chosen):
        raise InputError("parameters: a landmark is named twice")
    indices = tuple(ids.index(i) for i in chosen)
    kind = augmented_ekf(len(ids), indices, settings.integration, settings.guard)
    return _online(
        "a-ekf",
        kind,
        drive,
        settings,
        parameter_variance=settings.parameter_sigma**2,
        parameter_density=settings.parameter_walk**2,
    )


def make_proportional_integral(
    drive: Drive, settings: ProportionalIntegralSettings
) -> OnlineFilter:
    """Return the paper's PI-EKF for a drive."""
    q = len(drive.home)
    model = PolarModel(q, guard=settings.guard)
    kind = ProportionalIntegralFilter(model, settings.integration)
    scale = np.eye(model.n)
    # The paper counts R in cm: one unit of an innovation moves it by cm, not by m.
    scale[0, 0] = 0.01
    pi = _matrix("proportional", settings.proportional, (model.n, model.n), scale)
    m = _matrix("integral_gain", settings.integral_gain, (model.n, q), np.ones((model.n, q)))
    return _online(
        "pi-ekf", kind, drive, settings, proportional=pi / settings.sample_time, integral_gain=m
    )


_Maker = Callable[[Drive, Any], Estimator]

ESTIMATORS: dict[str, tuple[type[Strict], _Maker]] = {
    "robust": (LocalizerSettings, make_robust),
    "ekf": (FilterSettings, make_ekf),
    "a-ekf": (AugmentedSettings, make_augmented),
    "pi-ekf": (ProportionalIntegralSettings, make_proportional_integral),
}
"""Each name with the model of its settings and what makes it."""
DEFAULT = "robust"
NEED_START = ("ekf", "a-ekf", "pi-ekf")
"""Those that cannot begin without a start prior."""


def make_estimator(
    name: str, drive: Drive, settings: Strict | dict[str, Any] | None = None
) -> Estimator:
    """Return an estimator for a drive, of which only home and settings are used.

    Parameters
    ----------
    name : str
        A key of `ESTIMATORS`.
    drive : Drive
        What it will run on; of sightings only their number is looked at, and of truth nothing.
    settings : Strict or dict, optional
        Its settings, or their values; None: the defaults.

    Raises
    ------
    InputError
        For an unknown name, settings that cannot be used, or no start prior where one is needed.
    """
    return ESTIMATORS[_known(name)][1](drive, estimator_settings(name, settings))


def estimator_settings(name: str, settings: Strict | dict[str, Any] | None = None) -> Strict:
    """Return the settings of an estimator, spelt out; parameters and errors as `make_estimator`."""
    model = ESTIMATORS[_known(name)][0]
    return settings if isinstance(settings, model) else validated(model, settings or {})


def _known(name: str) -> str:
    if name not in ESTIMATORS:
        raise InputError(f"no estimator {name!r}: there are {', '.join(ESTIMATORS)}")
    return name


def _online(
    name: str,
    kind: ExtendedKalmanFilter,
    drive: Drive,
    settings: FilterSettings,
    parameter_variance: float = 0.0,
    parameter_density: float = 0.0,
    proportional: np.ndarray | None = None,
    integral_gain: np.ndarray | None = None,
) -> OnlineFilter:
    """Put a filter's numbers together: its settings first, then the drive's, then defaults."""
    if not drive.home:
        raise InputError(f"{drive.name}: home saw no landmark, so {name} has nothing to go by")
    model, known = kind.model, drive.settings
    start = known.start
    if start is None:
        raise InputError(f"{name} needs a start prior: in drive.yaml, or --start R,THETA,ALPHA")
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
        stored=np.array(list(drive.home_bearings().values())),
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
    return OnlineFilter(
        name,
        kind,
        list(drive.home),
        known.sensor.yaw,
        tuning,
        _notes(name, drive),
        settings.engine,
        drive.odometry.t.size + drive.sightings.t.size,
    )


def _notes(name: str, drive: Drive) -> tuple[str, ...]:
    """Say which assumptions of the paper this drive does not meet."""
    offsets = [
        math.hypot(mount.x, mount.y) for mount in (drive.settings.sensor, drive.settings.home_mount)
    ]
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
