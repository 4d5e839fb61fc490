"""Home at a time of the drive, from its own sightings."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from homeward.drives.drive import Drive, HomeBearing, Odometry
from homeward.drives.home.rest import rest_directions
from homeward.drives.home.spin import home_remark, spin, spin_remarks
from homeward.drives.robot import with_first_camera
from homeward.drives.settings import HomeWhen
from homeward.errors import InputError
from homeward.geometry.frames import Pose
from homeward.odometry.validity import validities

MAX_STILL_M, MAX_STILL_RAD = 0.05, 0.05
"""Maximum motion of a stationary robot [m, rad]."""
OTHER_HOME = "{} relative to another home, ignored"
SEEN = (
    "home bearings are the sightings at {:g} s of the drive: fewer than {} landmarks are mapped "
    "there"
)
MIN_MAPPED = 4
"""Minimum number of mapped landmarks for home at a time of the drive: a pose needs as many."""
MAX_AGE_S = 0.5
"""Maximum time between home at a time of the drive and a sighting that counts as seen there [s]."""


def with_home(
    drive: Drive, when: HomeWhen, on_progress: Callable[[float], None] | None = None
) -> Drive:
    """Return a drive with home bearings from its own sightings, which replace any that it has.

    `on_progress` receives the fraction done, in [0, 1], while the drive is mapped. `InputError`
    where the robot moved at that time, or had no sightings; see `spin`. A drive without any
    sightings stays as it is.
    """
    times = when.times
    if times is None or not drive.sightings.t.size:  # refused by what needs sightings
        return drive
    first, last = time_in(drive, times[0]), drive.span[0] + times[1]
    if drive.settings.home_sensor is not None:
        advice = "remove it from drive.yaml"
        raise InputError("home_sensor does not apply if home comes from this drive", advice=advice)
    if drive.known.surveyed_from_home:
        advice = "remove the time at home"
        raise InputError("landmarks.yaml already defines home (frame: home)", advice=advice)
    drive = _seen_from(drive, first)
    drive = dataclasses.replace(drive, settings=drive.settings.model_copy(update={"home": None}))
    if when.at is not None:
        home, remarks = _home_at(drive, first, on_progress)
    elif when.during is not None:
        _require_still(first, last, drive.odometry)
        home, remarks = _seen_at_rest(drive, first, last)
    else:
        settings = with_first_camera(drive.settings, drive)
        found = spin((first, last), drive.odometry, drive.sightings, settings)
        home, remarks = found.home, spin_remarks(found)
    if not home:
        raise InputError(f"no sightings at home from {times[0]:g} to {times[1]:g} s")
    return dataclasses.replace(drive, home=home, remarks={**drive.remarks, **remarks})


def time_in(drive: Drive, since: float) -> float:
    """Return the stamp of a time since the first sample of a drive [s]; `InputError` if outside."""
    first, last = drive.span
    if not 0.0 <= since <= last - first:
        raise InputError(
            f"time at home {since:g}: must be from 0 to {last - first:.1f} s, the length of the"
            " drive"
        )
    return first + since


def _home_at(
    drive: Drive, t: float, on_progress: Callable[[float], None] | None
) -> tuple[dict[str, HomeBearing], dict[str, int]]:
    """Return the home bearings of the pose at `t` [s], and a remark.

    They are predicted by the map of the drive, or else the sightings nearest in time.
    """
    # Imported here only: the localiser uses drives.
    from homeward.localizer.home_at import predicted_home

    since = t - drive.span[0]
    found = predicted_home(drive, t, on_progress)
    mapped = len(found.names)
    if mapped >= MIN_MAPPED:
        return found.home, home_remark(found, f"a map of the drive, at {since:g} s")
    stamps = drive.sightings.t
    nearest = float(stamps[np.abs(stamps - t).argmin()])
    if abs(nearest - t) > MAX_AGE_S:
        raise InputError(
            f"no home at {since:g} s: the map of the drive gives {mapped} "
            f"bearings there, and no sighting is within {MAX_AGE_S:g} s",
            advice="choose a time with landmarks in view",
        )
    home, remarks = _seen_at_rest(drive, nearest, nearest)
    return home, {SEEN.format(nearest - drive.span[0], MIN_MAPPED): len(home), **remarks}


def _require_still(first: float, last: float, odometry: Odometry) -> None:
    """Refuse an interval [s] in which the odometry moves."""
    ends = np.minimum(odometry.t + validities(odometry.t), last)
    within = np.clip(ends - np.maximum(odometry.t, first), 0.0, None)
    odometry = odometry.bridged
    path = np.hypot(odometry.v, odometry.vy) @ within
    turn = np.abs(odometry.omega) @ within
    if path > MAX_STILL_M or turn > MAX_STILL_RAD:
        problem = f"the robot moves at home: it drives {path:.2f} m and turns {turn:.2f} rad"
        advice = "give an interval without motion, or --home at:T for its pose at one time"
        raise InputError(problem, advice=advice)


def _seen_at_rest(
    drive: Drive, first: float, last: float
) -> tuple[dict[str, HomeBearing], dict[str, int]]:
    """Return the bearing of each landmark in view in an interval [s], and remarks."""
    seen = drive.sightings
    return rest_directions(seen.rows((seen.t >= first) & (seen.t <= last)))


def _seen_from(drive: Drive, t: float) -> Drive:
    """Return a drive without its home, and its ground truth relative to the pose at `t` [s]."""
    settings, truth, remarks = drive.settings, drive.truth, dict(drive.remarks)
    if drive.home and settings.start is not None:
        settings = settings.model_copy(update={"start": None})
        remarks[OTHER_HOME.format("start prior")] = 1
    if truth is not None and truth.t[0] <= t <= truth.t[-1]:
        home = Pose(*(float(part[0]) for part in truth.at(np.array([t]))))
        truth = truth.seen_from(home)
    elif drive.home and truth is not None:
        truth, remarks[OTHER_HOME.format("ground truth")] = None, 1
    return dataclasses.replace(drive, home={}, settings=settings, truth=truth, remarks=remarks)


MIN_REST_S, MAX_REST_S = 2.0, 10.0
"""Minimum and maximum length of a proposed interval [s]."""
STILL_SPEED, STILL_RATE = 0.005, 0.005
"""Maximum speed [m/s] and yaw rate [rad/s] of a robot at rest."""
MIN_LANDMARKS = 3
"""Minimum number of landmarks that are in view there."""
PROPOSED = (
    "the robot is at rest from {0:g} to {1:g} s, which is home with --home during:{0:g},{1:g}"
)


def first_rest(drive: Drive) -> tuple[float, float] | None:
    """Return the first interval at rest with landmarks in view [s from the start]; None: none."""
    o, s = drive.odometry, drive.sightings
    if not (o.t.size and s.t.size):
        return None
    still = (np.hypot(o.v, o.vy) <= STILL_SPEED) & (np.abs(o.omega) <= STILL_RATE)
    ends = o.t + validities(o.t)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    for begin, end in edges.reshape(-1, 2).tolist():
        first, last = float(o.t[begin]), min(float(ends[end - 1]), float(o.t[begin]) + MAX_REST_S)
        seen = s.landmark[(s.t >= first) & (s.t <= last)]
        if last - first >= MIN_REST_S and len(set(seen.tolist())) >= MIN_LANDMARKS:
            start = drive.span[0]
            return float(np.ceil(10.0 * (first - start)) / 10.0), float(
                np.floor(10.0 * (last - start)) / 10.0
            )
    return None


def with_proposal(advice: str, drive: Drive) -> str:
    """Return an advice with the proposal to take the first rest as home, if there is one."""
    rest = first_rest(drive)
    return advice if rest is None else f"{advice}; {PROPOSED.format(*rest)}"
