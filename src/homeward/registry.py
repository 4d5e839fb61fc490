"""Estimators by name, each with its settings: how commands and studies make one for a drive."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from homeward.drives.drive import Drive
from homeward.errors import needs_start_prior
from homeward.estimator import Estimator
from homeward.io.keys import Strict
from homeward.io.settings import validated
from homeward.localizer.localizer import Localizer
from homeward.localizer.settings import LocalizerSettings
from homeward.plugins import ESTIMATORS as GROUP
from homeward.plugins import Guest, fault, installed, load

_Maker = Callable[[Drive, Any], Estimator]


def _robust(drive: Drive, settings: LocalizerSettings) -> Estimator:
    """Return the robust localiser for a drive; with an eye on home's picture where there is one."""
    localizer = Localizer(drive.home, settings=settings, known=drive.known, **drive.settings.robot)
    if type(drive) is Drive:
        return localizer
    # Imported here alone: what only reads logs needs no images.
    from homeward.vision.recorded.estimator import ImageDrive, RecordedVisualHoming

    return RecordedVisualHoming(localizer, drive) if isinstance(drive, ImageDrive) else localizer


DEFAULT = "robust"
NEED_START = ("ekf", "a-ekf", "pi-ekf", "adaptive", "invariant", "particle", "schmidt", "ukf")
"""Filters, which cannot begin without a start prior."""
ESTIMATORS = (DEFAULT, *NEED_START)
"""Names of the estimators of homeward."""


class NoSettings(Strict):
    """Of an estimator that takes none."""


def estimator_names() -> tuple[str, ...]:
    """Return the names of all estimators, those of installed packages last."""
    return (*ESTIMATORS, *(name for name in installed(GROUP) if name not in ESTIMATORS))


def make_estimator(
    name: str, drive: Drive, settings: Strict | dict[str, Any] | None = None
) -> Estimator:
    """Return an estimator for a drive, of which only home and settings are used.

    Parameters
    ----------
    name : str
        One of `estimator_names`, or ``package.module:make``: anything that makes an `Estimator`
        when called with a drive, or with a drive and its settings.
    drive : Drive
        What it will run on; of sightings only their number is looked at, and of truth nothing.
    settings : Strict or dict, optional
        Its settings, or their values; None: the defaults.

    Raises
    ------
    InputError
        For an unknown name, settings that cannot be used, no start prior where one is needed, or
        an estimator of somebody else that does not keep the protocol.
    """
    return _entry(name)[1](drive, estimator_settings(name, settings))


def estimator_settings(name: str, settings: Strict | dict[str, Any] | None = None) -> Strict:
    """Return the settings of an estimator, spelt out; parameters and errors as `make_estimator`."""
    model = _entry(name)[0]
    return settings if isinstance(settings, model) else validated(model, settings or {})


def settings_model(name: str) -> type[Strict]:
    """Return the model of an estimator's settings; errors as `make_estimator`."""
    return _entry(name)[0]


def needs_start(name: str) -> bool:
    """Return whether an estimator cannot begin without a start prior; errors as `make_estimator`.

    One of somebody else says so by an attribute ``needs_start`` of what makes it.
    """
    if name in ESTIMATORS:
        return name in NEED_START
    return bool(getattr(load(GROUP, name, ESTIMATORS), "needs_start", False))


def _entry(name: str) -> tuple[type[Strict], _Maker]:
    """Return the model of an estimator's settings, and what makes it."""
    if name == DEFAULT:
        return LocalizerSettings, _robust
    if name in NEED_START:
        # Imported here alone: the localiser needs none of the filters.
        from homeward.lab.engine.estimators.table import FILTERS

        return FILTERS[name]
    make = load(GROUP, name, ESTIMATORS)
    model = _second_model(name, make)

    def guest(drive: Drive, settings: Strict) -> Estimator:
        if getattr(make, "needs_start", False) and drive.settings.start is None:
            raise needs_start_prior(name)
        taken = (drive,) if model is NoSettings else (drive, settings)
        return Guest(name, lambda: make(*taken))

    return model, guest


def _second_model(name: str, make: Callable[..., Any]) -> type[Strict]:
    """Return the settings model that somebody's maker takes second, by its annotation."""
    try:
        parameters = list(inspect.signature(make, eval_str=True).parameters.values())
    except ValueError:  # of some builtins nothing is known
        parameters = []
    except Exception as error:
        raise fault(f"{name}: reading the types of its arguments", error) from error
    kinds = [p.annotation for p in parameters[1:2]]
    if kinds and isinstance(kinds[0], type) and issubclass(kinds[0], Strict):
        return kinds[0]
    return NoSettings
