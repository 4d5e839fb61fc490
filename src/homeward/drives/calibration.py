"""Calibration of a drive: its own settings and those of its robot, applied when it is read."""

from __future__ import annotations

import dataclasses
from typing import Any

from homeward.drives.cameras.names import with_first_camera
from homeward.drives.drive import Drive, Odometry
from homeward.drives.settings import DriveSettings, RobotSettings
from homeward.errors import InputError
from homeward.io.models import Strict
from homeward.io.settings import nested, validated

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
        from homeward.drives.tilt import levelled  # few drives need it

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
    given = drive.recorded.settings
    kept = {
        "odometry": given.odometry,
        "bearings_late": given.bearings_late,
        "wheels": given.wheels,
    }
    return dataclasses.replace(
        drive,
        odometry=drive.recorded.odometry,
        sightings=drive.recorded.sightings,
        tilt=drive.recorded.tilt,
        settings=drive.settings.model_copy(update=kept),
        recorded=None,
    )
