"""Home out of the drive itself: what the camera saw when the robot was there."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from homeward.drives.drive import Drive, HomeBearing, Odometry
from homeward.drives.home.spin import Spin, spin
from homeward.drives.settings import HomeWhen
from homeward.errors import InputError
from homeward.geometry.frames import Pose
from homeward.io.table import quoted
from homeward.odometry.validity import validities

STILL_M = 0.05
"""A robot that goes further does not stand [m]."""
STILL_RAD = 0.05
"""Nor one that turns by more [rad]."""
FOUND = (
    "home bearings by a turn of {:.0f} degrees, good to {:.2g} degrees in the median; home's "
    "heading is that at its beginning to {:.2g} degrees"
)
LOOKED = "degrees came into view during home's turn, not all round: home knows nothing of the rest"
OF_OTHER_HOME = "{} of a home that was not chosen, left out"
LEFT_OUT = "landmarks that home leaves out, as their sightings during its turn disagree: {}"


def with_home(drive: Drive, when: HomeWhen) -> Drive:
    """Return a drive with home bearings from its own sightings, instead of any that it has.

    `InputError` where the robot was not at home then, or saw nothing; see `spin`.
    """
    span = when.during or when.spin
    if span is None:
        return drive
    first, last = (drive.span[0] + t for t in span)
    if drive.settings.home_sensor is not None:
        raise InputError("home_sensor: what the drive itself saw of home is by its own camera")
    if drive.known.surveyed_from_home:
        raise InputError("landmarks.yaml is surveyed from home; another home cannot be chosen")
    if drive.home:
        drive = _seen_from(drive, first)
    told = drive.settings.model_copy(update={"home": None})
    if when.during is not None:
        _require_still(first, last, drive.odometry)
        home = _mean_directions(drive, first, last)
        if not home:
            raise InputError(f"nothing was seen during home's {span[0]:g} to {span[1]:g} s")
        return dataclasses.replace(drive, home=home, settings=told)
    found = spin((first, last), drive.odometry, drive.sightings, told)
    remarks = {**drive.remarks, **_remarks(found)}
    return dataclasses.replace(drive, home=found.home, settings=told, remarks=remarks)


def _require_still(first: float, last: float, odometry: Odometry) -> None:
    """Refuse an interval [s] in which the odometry moves."""
    ends = np.minimum(odometry.t + validities(odometry.t), last)
    within = np.clip(ends - np.maximum(odometry.t, first), 0.0, None)
    odometry = odometry.bridged
    way, turn = np.abs(odometry.v) @ within, np.abs(odometry.omega) @ within
    if way > STILL_M or turn > STILL_RAD:
        raise InputError(
            f"the robot does not stand at home: meanwhile it drives {way:.2f} m and turns "
            f"{turn:.2f} rad"
        )


def _mean_directions(drive: Drive, first: float, last: float) -> dict[str, HomeBearing]:
    """Return the mean direction of each landmark that was seen in an interval [s]."""
    seen, home = drive.sightings, dict[str, HomeBearing]()
    at_home = seen.rows((seen.t >= first) & (seen.t <= last))
    for landmark in dict.fromkeys(at_home.landmark.tolist()):
        mine = at_home.bearing[at_home.landmark == landmark]
        home[landmark] = HomeBearing(float(np.arctan2(np.sin(mine).sum(), np.cos(mine).sum())))
    return home


def _seen_from(drive: Drive, t: float) -> Drive:
    """Return a drive without its own home: its truth as seen from where it truly was at `t` [s]."""
    settings, truth = drive.settings.model_copy(update={"start": None}), drive.truth
    remarks = dict(drive.remarks)
    if drive.settings.start is not None:
        remarks[OF_OTHER_HOME.format("start prior")] = 1
    if truth is not None and truth.t[0] <= t <= truth.t[-1]:
        home = Pose(*(float(part[0]) for part in truth.at(np.array([t]))))
        truth = truth.seen_from(home)
    elif truth is not None:
        truth, remarks[OF_OTHER_HOME.format("truth")] = None, 1
    return dataclasses.replace(drive, home={}, settings=settings, truth=truth, remarks=remarks)


def spin_words(found: Spin) -> str:
    """Say what a spin told."""
    return "; ".join(f"{number} {why}" for why, number in _remarks(found).items())


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
