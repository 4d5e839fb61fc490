"""The robot of a drive: its validated settings, its cameras, and its calibration.

A drive and its robot have settings, which are combined and applied when the drive is read.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from homeward.drives.drive import Drive, HomeBearing, Odometry
from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.settings import DriveSettings, Mount, OtherCamera, Robot, RobotSettings
from homeward.errors import InputError, naming_file
from homeward.estimator import real
from homeward.io.models import Strict
from homeward.io.settings import Model, nested, validated
from homeward.io.table import quoted
from homeward.sighting_keys import keyed

Home = Mapping[str, float | HomeBearing] | Sequence[Any]
"""Home bearings [rad] by landmark id, with standard deviations where known. Those without ids are a
sequence of bearings, or of pairs of a class and a bearing."""


def known_home(home: Home) -> dict[str, HomeBearing]:
    """Return validated home bearings; `InputError` for a wrong type or number."""
    home = keyed(home)
    if not isinstance(home, Mapping):
        problem = f"home is a {type(home).__name__} instead of bearings [rad] by landmark id"
        raise InputError(problem)
    return {name: _home_bearing(name, seen) for name, seen in home.items()}


def known_robot(robot: Robot) -> DriveSettings:
    """Return validated settings of a robot; `InputError` names the wrong key."""
    known = validated(DriveSettings, {k: v for k, v in robot.items() if v is not None})
    if given := known.odometry.corrections:
        problem = f"odometry: {', '.join(given)}: an estimator takes corrected twists"
        advice = "correct them with OdometryNoise.corrected, and leave these keys out"
        raise InputError(problem, advice=advice)
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
        advice = "give str(id)"
        raise InputError(f"a landmark id must be text, not {name!r}", part="home", advice=advice)
    given = seen if isinstance(seen, HomeBearing) else HomeBearing(cast(float, seen))
    with naming_file(part=f"home: {name!r}"):
        bearing, sigma = real(given.bearing), real(given.sigma)
        if not math.isfinite(bearing):
            raise InputError("the bearing is not finite")
    return HomeBearing(bearing, sigma, given.camera)


class Cameras:
    """Cameras by name: those under `cameras:`, and the first one, whose extrinsics are `sensor:`.

    The first one has no name, or any other; then that is the same for all bearings. `seen` are
    names that occur, as for `in_first`.
    """

    def __init__(self, settings: DriveSettings, seen: Iterable[str] = ()) -> None:
        self._others = {name: settings.in_first(name) for name in settings.cameras}
        self.first = ""
        """Name of the first camera, as far as it has occurred."""
        for name in seen:
            self.in_first(name)

    def in_first(self, name: str) -> np.ndarray | None:
        """Return the pose (3,) of a camera in the frame of the first one; None for the first.

        It is the same array each time. `InputError` where its extrinsics are unknown.
        """
        if name in self._others:
            return self._others[name]
        if name and name != self.first:
            if self.first:
                raise InputError(
                    f"cameras {quoted(self.first)} and {quoted(name)}: only one "
                    "may have the extrinsics under sensor:",
                    advice=f"add cameras: {{{quoted(name)}: {{x: ..., y: ..., yaw: "
                    "...}} to drive.yaml or the robot file",
                )
            self.first = name
        return None


def with_camera(settings: DriveSettings, name: str, camera: OtherCamera) -> DriveSettings:
    """Return settings with the extrinsics of a camera; of the first one for an empty name."""
    if name:
        return settings.model_copy(update={"cameras": {**settings.cameras, name: camera}})
    given = camera.model_dump(exclude_unset=True)
    return settings.model_copy(update={"sensor": settings.sensor.model_copy(update=given)})


def with_first_camera(settings: DriveSettings, drive: Drive) -> DriveSettings:
    """Return settings in which `sensor` has the extrinsics of the first camera of a drive.

    Where all cameras of the drive are under `cameras` and `sensor` has none, it is the first there.
    `InputError` where the extrinsics of a camera are unknown.
    """
    names = {*drive.sightings.camera.tolist(), *(seen.camera for seen in drive.home.values())}
    Cameras(settings, sorted(names))
    used = [name for name in settings.cameras if name in names]
    poses = set(Mount.model_fields)
    if not used or not names <= set(used) or poses & settings.sensor.model_fields_set:
        return settings
    first = settings.cameras[used[0]].model_dump(exclude_none=True)
    return settings.model_copy(update={"sensor": settings.sensor.model_copy(update=first)})


def require_one_camera(drive: Drive, problem: str, file: Path | None = None) -> None:
    """Raise `InputError` with the `problem` and the `file` for a drive with several cameras."""
    home = [seen.camera for seen in drive.home.values()]
    if drive.settings.offsets([*set(drive.sightings.camera.tolist()), *home]) is not None:
        raise InputError(problem, file)


DELAY_REMOVED = "sightings with stamps corrected by the {:g} s of bearings_late"
CORRECTED = "odometry rows corrected by {}"
REPLACED = "keys of the robot file that the drive's own settings replace: {}"


def given_keys(settings: Strict) -> dict[str, Any]:
    """Return the values of settings that were given, by dotted key."""
    found: dict[str, Any] = {}
    for head, part in settings.model_dump(exclude_unset=True, exclude_none=True).items():
        inner = part if isinstance(part, dict) and head != "cameras" else {"": part}
        found |= {f"{head}.{key}".rstrip("."): value for key, value in inner.items()}
    return found


def with_calibration(drive: Drive, robot: RobotSettings | None = None) -> Drive:
    """Return a drive with the settings of its robot, and its odometry and bearings corrected.

    A key of the drive replaces that of `robot`, and its standard deviation. `InputError` where the
    odometry was computed with another geometry of wheels than that of `robot`.
    """
    settings, remarks = drive.settings, dict(drive.remarks)
    if robot is not None:
        if None not in (robot.wheels, settings.wheels) and robot.wheels != settings.wheels:
            raise InputError(
                "wheels differ between the drive and the robot file, whose "
                "corrections would be wrong here",
                advice="import the drive again with the wheels of the robot file",
            )
        own, shared = given_keys(settings), given_keys(robot)
        if replaced := [key for key in shared if own.get(key, shared[key]) != shared[key]]:
            remarks[REPLACED.format(", ".join(replaced))] = len(replaced)
        kept = {k: v for k, v in shared.items() if k.removesuffix("_sigma") not in own}
        settings = validated(DriveSettings, nested(kept | own))
    settings = with_first_camera(settings, drive)
    given, late = settings.odometry.corrections, settings.bearings_late
    if not given and late is None and drive.tilt is None:
        return dataclasses.replace(drive, settings=settings, remarks=remarks)
    odometry, sightings = drive.odometry, drive.sightings
    if given:
        words = ", ".join(f"{key} {value:g}" for key, value in given.items())
        remarks[CORRECTED.format(words)] = odometry.t.size
        twist = odometry.v, odometry.omega, odometry.vy
        odometry = Odometry(odometry.t, *settings.odometry.corrected(*twist))
    if late is not None:
        remarks[DELAY_REMOVED.format(late)] = sightings.t.size
        sightings = dataclasses.replace(sightings, t=sightings.t - late)
    if drive.tilt is not None:
        from homeward.drives.measure import levelled  # few drives need it

        sightings = levelled(sightings, drive.tilt, settings, remarks)
    return dataclasses.replace(
        drive,
        odometry=odometry,
        sightings=sightings,
        settings=settings.uncorrected,
        remarks=remarks,
        tilt=None,
        recorded=dataclasses.replace(drive, settings=settings),
    )


def as_recorded(drive: Drive) -> Drive:
    """Return a drive as it was before `with_calibration`, with the corrections in its settings."""
    if drive.recorded is None:
        return drive
    corrections = "odometry", "bearings_late", "wheels"
    kept = {key: getattr(drive.recorded.settings, key) for key in corrections}
    return dataclasses.replace(
        drive,
        odometry=drive.recorded.odometry,
        sightings=drive.recorded.sightings,
        tilt=drive.recorded.tilt,
        settings=drive.settings.model_copy(update=kept),
        recorded=None,
    )
