"""Estimators by name, with their settings models, for commands and studies."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from homeward.drives.drive import Drive
from homeward.errors import needs_start_prior, require_kind
from homeward.estimator import Estimator
from homeward.io.models import Strict
from homeward.io.settings import validated
from homeward.localizer.localizer import Localizer
from homeward.localizer.settings import LocalizerSettings
from homeward.plugins import ESTIMATORS as GROUP
from homeward.plugins import PluginEstimator, fault, installed, load

_Maker = Callable[[Drive, Any], Estimator]


def _robust(drive: Drive, settings: LocalizerSettings) -> Estimator:
    """Return the robust localiser for a drive; with visual homing where the drive has images."""
    localizer = Localizer(drive.home, settings=settings, known=drive.known, **drive.settings.robot)
    if type(drive) is Drive:
        return localizer
    # Imported here only: other drives need no image processing.
    from homeward.vision.recorded.estimator import ImageDrive, RecordedVisualHoming

    return RecordedVisualHoming(localizer, drive) if isinstance(drive, ImageDrive) else localizer


DEFAULT = "robust"
NEED_START = ("ekf", "a-ekf", "pi-ekf", "adaptive", "invariant", "particle", "schmidt", "ukf")
"""Filters, which need a start prior."""
ESTIMATORS = (DEFAULT, *NEED_START)
"""Names of the built-in estimators."""


class NoSettings(Strict):
    """Settings model of an estimator without settings."""


def estimator_names() -> tuple[str, ...]:
    """Return the names of all estimators; those of installed packages last."""
    return (*ESTIMATORS, *(name for name in installed(GROUP) if name not in ESTIMATORS))


def make_estimator(
    name: str, drive: Drive, settings: Strict | dict[str, Any] | None = None
) -> Estimator:
    """Return an estimator for a drive; it uses only the home bearings and settings of the drive.

    Parameters
    ----------
    name : str
        One of `estimator_names`, or ``package.module:make``: a callable that returns an `Estimator`
        for a drive, or for a drive and its settings.
    drive : Drive
        The drive to run on. Only the number of its sightings is used, and no ground truth.
    settings : Strict or dict, optional
        Settings of the estimator, or their values; None: the defaults.

    Raises
    ------
    InputError
        For an unknown name, unusable settings, a missing start prior, or a third-party estimator
        that violates the protocol.
    """
    make = _entry(name)[1]
    require_kind(drive, Drive, "read one with open_drive(PATH)")
    return make(drive, estimator_settings(name, settings))


def estimator_settings(name: str, settings: Strict | dict[str, Any] | None = None) -> Strict:
    """Return the complete settings of an estimator; parameters and errors as `make_estimator`."""
    model = _entry(name)[0]
    return settings if isinstance(settings, model) else validated(model, settings or {})


def settings_model(name: str) -> type[Strict]:
    """Return the model of an estimator's settings; errors as `make_estimator`."""
    return _entry(name)[0]


def needs_start(name: str) -> bool:
    """Return whether an estimator needs a start prior; errors as `make_estimator`.

    The callable of a third-party estimator has an attribute ``needs_start`` for this.
    """
    if name in ESTIMATORS:
        return name in NEED_START
    return bool(getattr(load(GROUP, name, ESTIMATORS), "needs_start", False))


def _entry(name: str) -> tuple[type[Strict], _Maker]:
    """Return the settings model of an estimator, and the function that makes it."""
    if name == DEFAULT:
        return LocalizerSettings, _robust
    if name in NEED_START:
        # Imported here only: the localiser needs no filter.
        from homeward.lab.engine.estimators.table import FILTERS

        return FILTERS[name]
    make = load(GROUP, name, ESTIMATORS)
    model = _second_argument_model(name, make)

    def make_plugin(drive: Drive, settings: Strict) -> Estimator:
        if getattr(make, "needs_start", False) and drive.settings.start is None:
            raise needs_start_prior(name)
        arguments = (drive,) if model is NoSettings else (drive, settings)
        return PluginEstimator(name, lambda: make(*arguments))

    return model, make_plugin


def _second_argument_model(name: str, make: Callable[..., Any]) -> type[Strict]:
    """Return the settings model in the annotation of a plugin's second argument."""
    try:
        parameters = list(inspect.signature(make, eval_str=True).parameters.values())
    except ValueError:  # some builtins have no signature
        parameters = []
    except Exception as error:
        raise fault(f"{name}: reading the types of its arguments", error) from error
    kinds = [p.annotation for p in parameters[1:2]]
    if kinds and isinstance(kinds[0], type) and issubclass(kinds[0], Strict):
        return kinds[0]
    return NoSettings
