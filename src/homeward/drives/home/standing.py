"""Home by standing there: the mean of what the camera saw."""

from __future__ import annotations

import numpy as np

from homeward.drives.drive import HomeBearing, Odometry, Sightings
from homeward.errors import InputError
from homeward.estimator import HOLD_S

STILL_M = 0.05
"""A robot that goes further does not stand [m]."""
STILL_RAD = 0.05
"""Nor one that turns by more [rad]."""


def home_during(
    interval: tuple[float, float], odometry: Odometry, seen: Sightings
) -> dict[str, HomeBearing]:
    """Return the mean direction of each landmark while the robot stood at home.

    The interval counts from the first sample of the drive [s].

    Raises
    ------
    InputError
        When the robot moved meanwhile, or nothing was seen.
    """
    start = min(float(odometry.t[0]), float(seen.t[0]) if seen.t.size else np.inf)
    first, last = start + interval[0], start + interval[1]
    _require_still(first, last, odometry)
    at_home = (seen.t >= first) & (seen.t <= last)
    if not at_home.any():
        raise InputError(f"nothing was seen during home's {interval[0]:g} to {interval[1]:g} s")
    ids, angles = seen.landmark[at_home], seen.bearing[at_home]
    home = {}
    for landmark in dict.fromkeys(ids.tolist()):
        mine = angles[ids == landmark]
        home[landmark] = HomeBearing(float(np.arctan2(np.sin(mine).sum(), np.cos(mine).sum())))
    return home


def _require_still(first: float, last: float, odometry: Odometry) -> None:
    """Refuse an interval [s] in which the odometry moves."""
    ends = np.minimum(np.append(odometry.t[1:], np.inf), odometry.t + HOLD_S)
    within = np.clip(np.minimum(ends, last) - np.maximum(odometry.t, first), 0.0, None)
    way, turn = np.abs(odometry.v) @ within, np.abs(odometry.omega) @ within
    if way > STILL_M or turn > STILL_RAD:
        raise InputError(
            f"the robot does not stand at home: meanwhile it drives {way:.2f} m and turns "
            f"{turn:.2f} rad"
        )
