"""Dead reckoning of recorded odometry."""

from __future__ import annotations

from typing import Protocol, Self

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, advance
from homeward.odometry.validity import validities


class RecordedTwists(Protocol):
    """Twists in order of time, as in `homeward.drives.drive.Odometry`."""

    @property
    def t(self) -> np.ndarray:
        """Stamps, (n,) [s]."""

    @property
    def v(self) -> np.ndarray:
        """Speeds, (n,) [m/s]."""

    @property
    def omega(self) -> np.ndarray:
        """Yaw rates, (n,) [rad/s]."""

    @property
    def vy(self) -> np.ndarray:
        """Speeds to the left, (n,) [m/s]."""

    @property
    def bridged(self) -> Self:
        """The same with each unknown twist replaced by the last known one."""


def dead_reckoning(odometry: RecordedTwists, t: np.ndarray) -> Pose:
    """Integrate twists along arcs from the origin to poses (n,) at `t` [s].

    The first twist is at the origin. Each of one or more twists is valid for `validities`. Where
    the motion is unknown, the last known twist is used.
    """
    end = dead_reckoning_unwrapped(odometry, t)
    return end._replace(heading=wrap(end.heading))


def dead_reckoning_unwrapped(odometry: RecordedTwists, t: np.ndarray) -> Pose:
    """Integrate as `dead_reckoning`, with unwrapped headings."""
    odometry, valid = odometry.bridged, validities(odometry.t)
    twists, vy, held = Twist(odometry.v, odometry.omega), odometry.vy, valid[:-1]
    heading = np.append(0.0, np.cumsum(odometry.omega[:-1] * held))
    start = Pose(0.0, 0.0, heading[:-1])
    steps = advance(start, Twist(*(a[:-1] for a in twists)), held, vy[:-1])
    x, y = (np.append(0.0, np.cumsum(step)) for step in (steps.x, steps.y))
    last = np.maximum(np.searchsorted(odometry.t, t, side="right") - 1, 0)
    since = np.clip(t - odometry.t[last], 0.0, valid[-1])
    start = Pose(x[last], y[last], heading[last])
    return advance(start, Twist(*(a[last] for a in twists)), since, vy[last])
