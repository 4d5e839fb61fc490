"""Filters by name, each with the model of its settings and what makes it for a drive."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from homeward.drives.drive import Drive
from homeward.drives.known import known_home
from homeward.errors import without
from homeward.estimator import Estimator
from homeward.io.keys import Strict
from homeward.lab.filters.settings import (
    AugmentedSettings,
    CartesianSettings,
    FilterSettings,
    NoiseSettings,
    ParticleSettings,
    ProportionalIntegralSettings,
    SchmidtSettings,
)

Maker = Callable[[Drive, Any], Estimator]


def _engine(name: str) -> Any:
    """Return a function that makes a symbolic filter; `InputError` without the extra filters."""
    try:
        return getattr(import_module("homeward.lab.engine.estimators.paper"), name)
    except ModuleNotFoundError as error:
        raise without(error) or error from None


def _filter(name: str) -> Maker:
    """Return a function that makes one of the paper's filters for a drive."""

    def for_drive(drive: Drive, settings: NoiseSettings) -> Estimator:
        make, robot = _engine(name), drive.settings.robot
        made: Estimator = make(drive.home, settings=settings, samples=_samples(drive), **robot)
        return made

    return for_drive


def _peer(name: str) -> Maker:
    """Return a function that makes one of their peers for a drive."""

    def for_drive(drive: Drive, settings: Strict) -> Estimator:
        make, config = _engine(name), _engine("Told")
        known = name, known_home(drive.home), drive.settings
        made: Estimator = make(config(*known, settings, _samples(drive)))
        return made

    return for_drive


def _samples(drive: Drive) -> int:
    """Return the number of samples of a drive: for many it is worth compiling."""
    return drive.odometry.t.size + drive.sightings.t.size


FILTERS: dict[str, tuple[type[Strict], Maker]] = {
    "ekf": (FilterSettings, _filter("ekf")),
    "a-ekf": (AugmentedSettings, _filter("a_ekf")),
    "pi-ekf": (ProportionalIntegralSettings, _filter("pi_ekf")),
    "adaptive": (FilterSettings, _peer("adaptive")),
    "invariant": (CartesianSettings, _peer("invariant")),
    "particle": (ParticleSettings, _peer("particle")),
    "schmidt": (SchmidtSettings, _peer("schmidt")),
    "ukf": (FilterSettings, _peer("ukf")),
}
