"""The first rest of a robot, as a proposal where home is not given."""

from __future__ import annotations

import numpy as np

from homeward.drives.drive import Drive
from homeward.odometry.validity import validities

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
