"""Where odometry alone leads."""

from __future__ import annotations

import math

import numpy as np

from homeward.angles import wrap
from homeward.drives.drive import Odometry
from homeward.estimator import HOLD_S
from homeward.frames import Pose


def dead_reckoning(odometry: Odometry, t: np.ndarray) -> Pose:
    """Return the poses to which twists lead along arcs, from the origin at the first of them.

    Parameters
    ----------
    odometry : Odometry
        At least one twist; each holds until the next, at most `HOLD_S`.
    t : ndarray, shape (n,)
        Times asked for [s].

    Returns
    -------
    Pose
        x [m], y [m], heading [rad], each of shape (n,).
    """
    held = np.minimum(np.diff(odometry.t), HOLD_S)
    turn = odometry.omega[:-1] * held
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    dx, dy = _arc(heading[:-1], odometry.v[:-1] * held, turn)
    x, y = np.concatenate([[0.0], np.cumsum(dx)]), np.concatenate([[0.0], np.cumsum(dy)])
    last = np.maximum(np.searchsorted(odometry.t, t, side="right") - 1, 0)
    since = np.clip(t - odometry.t[last], 0.0, HOLD_S)
    turn = odometry.omega[last] * since
    dx, dy = _arc(heading[last], odometry.v[last] * since, turn)
    return Pose(x[last] + dx, y[last] + dy, wrap(heading[last] + turn))


def _arc(heading: np.ndarray, way: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the chord of an arc, begun at a heading."""
    chord = way * np.sinc(turn / math.tau)
    return chord * np.cos(heading + turn / 2), chord * np.sin(heading + turn / 2)
