"""Table of filters: name, settings model, and a function that makes the filter for a drive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from homeward.drives.drive import Drive
from homeward.errors import missing_extra_error
from homeward.estimator import Estimator
from homeward.io.models import Strict
from homeward.lab.filters.settings import (
    AugmentedSettings,
    CartesianSettings,
    FilterSettings,
    ParticleSettings,
    ProportionalIntegralSettings,
    SchmidtSettings,
)

Maker = Callable[[Drive, Any], Estimator]


def _filter(name: str) -> Maker:
    """Return a function that makes a filter; `InputError` without the extra filters."""

    def for_drive(drive: Drive, settings: Any) -> Estimator:
        try:
            from homeward.lab.engine.estimators.paper import filter_for
        except ModuleNotFoundError as error:
            raise missing_extra_error(error) or error from None
        return filter_for(name, drive, settings)

    return for_drive


_SETTINGS: dict[str, type[Strict]] = {
    "ekf": FilterSettings,
    "a-ekf": AugmentedSettings,
    "pi-ekf": ProportionalIntegralSettings,
    "adaptive": FilterSettings,
    "invariant": CartesianSettings,
    "particle": ParticleSettings,
    "schmidt": SchmidtSettings,
    "ukf": FilterSettings,
}
FILTERS = {name: (model, _filter(name)) for name, model in _SETTINGS.items()}
