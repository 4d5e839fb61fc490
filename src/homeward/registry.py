"""Estimators by name, each with its settings: how commands and studies make one for a drive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from homeward.drives.drive import Drive, Strict
from homeward.drives.text.settings import validated
from homeward.engine.online import OnlineFilter
from homeward.engine.paper import a_ekf, ekf, pi_ekf
from homeward.errors import InputError
from homeward.estimator import Estimator
from homeward.filters.settings import (
    AugmentedSettings,
    FilterSettings,
    ProportionalIntegralSettings,
)
from homeward.localizer.localizer import Localizer
from homeward.localizer.settings import LocalizerSettings

_Maker = Callable[[Drive, Any], Estimator]


def _robust(drive: Drive, settings: LocalizerSettings) -> Estimator:
    """Return the robust localiser for a drive; with an eye on home's picture where there is one."""
    localizer = Localizer(drive.home, settings=settings, **drive.settings.robot)
    if type(drive) is Drive:
        return localizer
    # Imported here alone: what only reads logs needs no images.
    from homeward.vision.recorded.estimator import ImageDrive, RecordedVisualHoming

    return RecordedVisualHoming(localizer, drive) if isinstance(drive, ImageDrive) else localizer


def _filter(make: Callable[..., OnlineFilter]) -> _Maker:
    """Return what makes one of the paper's filters for a drive."""

    def for_drive(drive: Drive, settings: FilterSettings) -> OnlineFilter:
        samples = drive.odometry.t.size + drive.sightings.t.size
        return make(drive.home, settings=settings, samples=samples, **drive.settings.robot)

    return for_drive


ESTIMATORS: dict[str, tuple[type[Strict], _Maker]] = {
    "robust": (LocalizerSettings, _robust),
    "ekf": (FilterSettings, _filter(ekf)),
    "a-ekf": (AugmentedSettings, _filter(a_ekf)),
    "pi-ekf": (ProportionalIntegralSettings, _filter(pi_ekf)),
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
