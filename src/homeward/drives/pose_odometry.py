"""Odometry from poses: the twists that lead from each pose to the next."""

from __future__ import annotations

import math

import numpy as np

from homeward.drives.drive import Odometry
from homeward.drives.plausibility import without_implausible
from homeward.geometry.angles import wrap


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
