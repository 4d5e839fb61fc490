"""Bearing-only localisation and homing of a mobile robot."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings, Truth
    from homeward.drives.home.spin import HomeScan
    from homeward.drives.opening import open_drive, save_drive
    from homeward.drives.settings import DriveSettings, Mount, OdometryNoise, Robot, Sensor, Start
    from homeward.errors import HomewardError, InputError
    from homeward.estimator import Counts, Estimate, Estimator, Innovation, LandmarkEstimate, Status
    from homeward.geometry.frames import Polar, Pose
    from homeward.geometry.statistics import AccuracyLimit, PoseAccuracy
    from homeward.lab.engine.estimators.paper import a_ekf, ekf, pi_ekf
    from homeward.lab.filters.settings import (
        AugmentedSettings,
        FilterSettings,
        ProportionalIntegralSettings,
    )
    from homeward.localizer.fixed_lag import FixedLag, smooth_with_lag
    from homeward.localizer.localizer import Localizer
    from homeward.localizer.settings import LocalizerSettings
    from homeward.localizer.smoothing import smooth
    from homeward.places.files import load_place, save_place
    from homeward.places.place import Place
    from homeward.reasons import Reason, Rejection
    from homeward.registry import make_estimator
    from homeward.runs.scoring import score
    from homeward.track import Track, run

    __version__: str

_NAMES = {
    "drives.drive": ("Drive", "HomeBearing", "Odometry", "Sightings", "Truth"),
    "drives.home.spin": ("HomeScan",),
    "drives.opening": ("open_drive", "save_drive"),
    "drives.settings": ("DriveSettings", "Mount", "OdometryNoise", "Robot", "Sensor", "Start"),
    "lab.engine.estimators.paper": ("a_ekf", "ekf", "pi_ekf"),
    "errors": ("HomewardError", "InputError"),
    "estimator": ("Counts", "Estimate", "Estimator", "Innovation", "LandmarkEstimate", "Status"),
    "lab.filters.settings": ("AugmentedSettings", "FilterSettings", "ProportionalIntegralSettings"),
    "geometry.statistics": ("AccuracyLimit", "PoseAccuracy"),
    "geometry.frames": ("Polar", "Pose"),
    "localizer.fixed_lag": ("FixedLag", "smooth_with_lag"),
    "localizer.localizer": ("Localizer",),
    "localizer.settings": ("LocalizerSettings",),
    "localizer.smoothing": ("smooth",),
    "places.files": ("load_place", "save_place"),
    "places.place": ("Place",),
    "reasons": ("Reason", "Rejection"),
    "registry": ("make_estimator",),
    "runs.scoring": ("score",),
    "track": ("Track", "run"),
}
"""Public names by module."""
_MODULES = {name: module for module, names in _NAMES.items() for name in names}

__all__ = [
    "AccuracyLimit",
    "AugmentedSettings",
    "Counts",
    "Drive",
    "DriveSettings",
    "Estimate",
    "Estimator",
    "FilterSettings",
    "FixedLag",
    "HomeBearing",
    "HomeScan",
    "HomewardError",
    "Innovation",
    "InputError",
    "LandmarkEstimate",
    "Localizer",
    "LocalizerSettings",
    "Mount",
    "Odometry",
    "OdometryNoise",
    "Place",
    "Polar",
    "Pose",
    "PoseAccuracy",
    "ProportionalIntegralSettings",
    "Reason",
    "Rejection",
    "Robot",
    "Sensor",
    "Sightings",
    "Start",
    "Status",
    "Track",
    "Truth",
    "__version__",
    "a_ekf",
    "ekf",
    "load_place",
    "make_estimator",
    "open_drive",
    "pi_ekf",
    "run",
    "save_drive",
    "save_place",
    "score",
    "smooth",
    "smooth_with_lag",
]


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> Any:
    # Imported at first use, so that `import homeward` stays quick.
    if name == "__version__":
        return import_module("importlib.metadata").version("homeward")
    if name not in _MODULES:
        raise AttributeError(f"module 'homeward' has no attribute {name!r}")
    try:
        return getattr(import_module(f"homeward.{_MODULES[name]}"), name)
    except ModuleNotFoundError as error:
        raise (import_module("homeward.errors").missing_extra_error(error) or error) from None
