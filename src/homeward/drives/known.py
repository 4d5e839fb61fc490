"""Validation of an estimator's inputs: home bearings, robot, landmarks and settings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

from homeward.drives.drive import HomeBearing
from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.settings import DriveSettings, Robot
from homeward.errors import InputError, naming_file
from homeward.estimator import real
from homeward.io.settings import Model, validated
from homeward.sighting_keys import keyed

Home = Mapping[str, float | HomeBearing] | Sequence[Any]
"""Home bearings [rad] by landmark id, with standard deviations where known. Those without ids are a
sequence of bearings, or of pairs of a class and a bearing."""


def known_home(home: Home) -> dict[str, HomeBearing]:
    """Return validated home bearings; `InputError` for a wrong type or number."""
    home = keyed(home)
    if not isinstance(home, Mapping):
        raise InputError(
            f"home is a {type(home).__name__} instead of bearings [rad] by landmark id"
        )
    return {name: _home_bearing(name, seen) for name, seen in home.items()}


def known_robot(robot: Robot) -> DriveSettings:
    """Return validated settings of a robot; `InputError` names the wrong key."""
    known = validated(DriveSettings, {k: v for k, v in robot.items() if v is not None})
    if given := known.odometry.corrections:
        raise InputError(
            f"odometry: {', '.join(given)}: an estimator takes corrected twists",
            advice="correct them with OdometryNoise.corrected, and leave these keys out",
        )
    return known


def known_landmarks(known: KnownLandmarks | dict[str, Any] | None) -> KnownLandmarks:
    """Return validated known landmarks; `InputError` names the wrong key."""
    if known is not None and not isinstance(known, (KnownLandmarks, dict)):
        raise InputError(f"known must be KnownLandmarks or its keys and values, not {known!r:.40}")
    return validated(KnownLandmarks, known or {})


def known_settings(model: type[Model], settings: Model | dict[str, Any] | None) -> Model:
    """Return validated settings of an estimator; None: the defaults."""
    if settings is not None and not isinstance(settings, (model, dict)):
        wanted = f"{model.__name__} or its keys and values"
        raise InputError(f"settings must be {wanted}, not a {type(settings).__name__}")
    return validated(model, settings or {})


def _home_bearing(name: object, seen: object) -> HomeBearing:
    if not isinstance(name, str):
        raise InputError(f"a landmark id must be text, not {name!r}", part="home")
    given = seen if isinstance(seen, HomeBearing) else HomeBearing(cast(float, seen))
    with naming_file(part=f"home: {name!r}"):
        bearing, sigma = real(given.bearing), real(given.sigma)
        if not math.isfinite(bearing):
            raise InputError("the bearing is not finite")
    return HomeBearing(bearing, sigma, given.camera)
