"""Home out of the drive itself: what the camera saw when the robot was there."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from homeward.drives.drive import Drive, HomeWhen
from homeward.drives.home.spin import Spin, spin
from homeward.drives.home.standing import home_during
from homeward.drives.text.table import quoted
from homeward.errors import InputError

FOUND = (
    "home bearings by a turn of {:.0f} degrees, good to {:.2g} degrees in the median; home's "
    "heading is that at its beginning to {:.2g} degrees"
)
LOOKED = "degrees came into view during home's turn, not all round: home knows nothing of the rest"
LEFT_OUT = "landmarks that home leaves out, as their sightings during its turn disagree: {}"


def with_home(drive: Drive, when: HomeWhen) -> Drive:
    """Return a drive with the home bearings that it saw itself, instead of any that it has.

    Raises
    ------
    InputError
        When the robot was not at home then, or saw nothing; see `home_during` and `spin`.
    """
    told = drive.settings.model_copy(update={"home": None})
    if when.during is not None:
        home = home_during(when.during, drive.odometry, drive.sightings)
        return dataclasses.replace(drive, home=home, settings=told)
    if when.spin is None:
        return drive
    if told.home_sensor is not None:
        raise InputError("home_sensor: the camera of home's spin is that of the drive")
    first, last = (drive.span[0] + t for t in when.spin)
    found = spin((first, last), drive.odometry, drive.sightings, told)
    remarks = {**drive.remarks, **_remarks(found)}
    return dataclasses.replace(drive, home=found.home, settings=told, remarks=remarks)


def _remarks(found: Spin) -> dict[str, int]:
    """Return what is to be said of a spin."""
    turned, seen = abs(math.degrees(found.turned)), math.degrees(found.seen)
    good = math.degrees(np.median([seen.sigma for seen in found.home.values()]))
    heading = math.degrees(found.heading_sigma)
    remarks = {FOUND.format(turned, good, heading): len(found.names)}
    if seen < 359.5:
        remarks[LOOKED] = round(seen)
    if found.left_out:
        remarks[LEFT_OUT.format(", ".join(map(quoted, found.left_out)))] = len(found.left_out)
    return remarks
