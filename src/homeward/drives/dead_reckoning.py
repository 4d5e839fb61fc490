"""Where odometry alone leads, and the odometry that leads along poses."""

from __future__ import annotations

import math

import numpy as np

from homeward.angles import wrap
from homeward.drives.drive import Odometry
from homeward.drives.plausibility import without_implausible
from homeward.estimator import hold_time
from homeward.frames import Pose, Twist, advance


def dead_reckoning(odometry: Odometry, t: np.ndarray) -> Pose:
    """Return the poses to which twists lead along arcs, from the origin at the first of them.

    Parameters
    ----------
    odometry : Odometry
        At least one twist; each holds until the next, at most for `hold_time`. Where the motion is
        unknown, the last known twist is used.
    t : ndarray, shape (n,)
        Times asked for [s].

    Returns
    -------
    Pose
        x [m], y [m], heading [rad], each of shape (n,).
    """
    end = reckoning(odometry, t)
    return end._replace(heading=wrap(end.heading))


def reckoning(odometry: Odometry, t: np.ndarray) -> Pose:
    """Return what `dead_reckoning` does, headings counted beyond a turn."""
    odometry = odometry.bridged
    intervals = np.diff(odometry.t)
    hold = hold_time(intervals.tolist())
    twists, held = Twist(odometry.v, odometry.omega), np.minimum(intervals, hold)
    heading = np.append(0.0, np.cumsum(odometry.omega[:-1] * held))
    steps = advance(Pose(0.0, 0.0, heading[:-1]), Twist(*(a[:-1] for a in twists)), held)
    x, y = (np.append(0.0, np.cumsum(step)) for step in (steps.x, steps.y))
    last = np.maximum(np.searchsorted(odometry.t, t, side="right") - 1, 0)
    since = np.clip(t - odometry.t[last], 0.0, hold)
    begun = Pose(x[last], y[last], heading[last])
    return advance(begun, Twist(*(a[last] for a in twists)), since)


def odometry_from_poses(t: np.ndarray, rows: np.ndarray, remarks: dict[str, int]) -> Odometry:
    """Return the twists that lead from each pose to the next along an arc.

    The motion of a pose that jumps is unknown, and counted in `remarks`.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Strictly increasing [s].
    rows : ndarray, shape (n, 3)
        x [m], y [m], heading [rad]. What a pose moves sideways is left out.
    remarks : dict
        Counts by reason in words.

    Returns
    -------
    Odometry
        Each twist holds to the next pose, the last is 0.
    """
    forward, sideways, turn = steps_between(rows)
    # An arc is longer than its chord by (turn / 2) / sin(turn / 2).
    way = forward / np.sinc(turn / math.tau)
    v, omega, sideways = (np.append(step / np.diff(t), 0.0) for step in (way, turn, sideways))
    return without_implausible(Odometry(t, v, omega), remarks, sideways)


def steps_between(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return forward and sideways step [m] and turn [rad] from each pose to the next.

    Parameters
    ----------
    rows : ndarray, shape (n, 3)
        x [m], y [m], heading [rad].

    Returns
    -------
    forward, sideways, turn : ndarray, shape (n - 1,)
        Along and to the left of the heading half-way.
    """
    dx, dy = np.diff(rows[:, 0]), np.diff(rows[:, 1])
    turn = np.asarray(wrap(np.diff(rows[:, 2])))
    middle = rows[:-1, 2] + turn / 2
    cos, sin = np.cos(middle), np.sin(middle)
    return dx * cos + dy * sin, dy * cos - dx * sin, turn
