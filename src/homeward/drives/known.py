"""What an estimator is told beforehand, as numbers and models: home bearings, and the robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, cast

from homeward.drives.drive import HomeBearing
from homeward.drives.settings import DriveSettings, KnownLandmarks, Robot
from homeward.errors import InputError
from homeward.estimator import real
from homeward.io.settings import Model, validated

Home = Mapping[str, float | HomeBearing]
"""What the camera saw at home: bearings [rad] by landmark, with a deviation where it is known."""


def known_home(home: Home) -> dict[str, HomeBearing]:
    """Return home bearings from the camera's axis, with standard deviations, of plain floats.

    `InputError` where it is no mapping of text to such, or a bearing is not finite.
    """
    if not isinstance(home, Mapping):
        raise InputError(f"home is a {type(home).__name__}, where ids to bearings [rad] are due")
    return {name: _home_bearing(name, seen) for name, seen in home.items()}


def known_robot(robot: Robot) -> DriveSettings:
    """Return what is known of a robot, checked; `InputError` names the key that is wrong."""
    return validated(DriveSettings, {k: v for k, v in robot.items() if v is not None})


def known_landmarks(known: KnownLandmarks | dict[str, Any] | None) -> KnownLandmarks:
    """Return what is known of landmarks, checked; `InputError` names the key that is wrong."""
    if known is not None and not isinstance(known, (KnownLandmarks, dict)):
        raise InputError(f"known: KnownLandmarks or its keys and values, not {known!r:.40}")
    return validated(KnownLandmarks, known or {})


def known_settings(model: type[Model], settings: Model | dict[str, Any] | None) -> Model:
    """Return the settings of an estimator, checked; None: the defaults."""
    if settings is not None and not isinstance(settings, (model, dict)):
        which = f"{model.__name__} or its keys and values"
        raise InputError(f"settings: {which}, not a {type(settings).__name__}")
    return validated(model, settings or {})


def _home_bearing(name: object, seen: object) -> HomeBearing:
    if not isinstance(name, str):
        raise InputError(f"home: a landmark's id is text, not {name!r}")
    given = seen if isinstance(seen, HomeBearing) else HomeBearing(cast(float, seen))
    try:
        bearing, sigma = real(given.bearing), real(given.sigma)
    except InputError as error:
        raise InputError(f"home: {name!r}: {error}") from error
    if not math.isfinite(bearing):
        raise InputError(f"home: {name!r}: the bearing is not finite")
    return HomeBearing(bearing, sigma)
