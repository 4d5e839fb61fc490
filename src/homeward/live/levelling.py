"""Bearings of a live session, corrected for the roll and pitch of the robot."""

from __future__ import annotations

import math
from collections import Counter, deque

import numpy as np

from homeward.drives.measure import MAX_TILT, UNRELIABLE, level
from homeward.drives.settings import DriveSettings
from homeward.live.messages import BearingsIn, TiltIn

MAX_AGE_S = 0.5
"""Maximum time from bearings to the nearest tilt that corrects them [s]."""
NO_TILT = "bearings not corrected for roll and pitch: no tilt within 0.5 s"


class Levelling:
    """The last tilts of a robot, by which its bearings are corrected; `counts` as of a session."""

    def __init__(self, robot: DriveSettings, counts: Counter[str]) -> None:
        self._sigma, self._counts = robot.sensor.bearing_sigma, counts
        self._tilts: deque[TiltIn] = deque(maxlen=500)

    def add(self, tilt: TiltIn) -> None:
        """Add a tilt."""
        self._tilts.append(tilt)

    def levelled(self, seen: BearingsIn, yaw: float) -> BearingsIn:
        """Return bearings as seen by a level robot; `yaw` is that of their camera [rad].

        Bearings without an elevation get a larger standard deviation, where one is known.
        """
        plain = seen.model_copy(update={"elevations": {}}) if seen.elevations else seen
        if not self._tilts or not seen.bearings:
            return plain
        tilt = min(self._tilts, key=lambda tilt: abs(tilt.t - seen.t))
        if abs(tilt.t - seen.t) > MAX_AGE_S:
            self._counts[NO_TILT] += len(seen.bearings)
            return plain
        names = list(seen.bearings)
        sigma = math.nan if self._sigma is None else self._sigma
        given = np.array(list(seen.bearings.values()))
        elevation = np.array([seen.elevations.get(name, math.nan) for name in names])
        sigma_of = np.array([seen.sigmas.get(name, sigma) for name in names])
        bearings, sigmas = level(given, elevation, sigma_of, yaw, (tilt.roll, tilt.pitch))
        unknown = len(set(names).difference(seen.elevations))
        if unknown and math.hypot(tilt.roll, tilt.pitch) > MAX_TILT:
            self._counts[UNRELIABLE] += unknown
        known = {n: s for n, s in zip(names, sigmas.tolist(), strict=True) if math.isfinite(s)}
        levelled = dict(zip(names, bearings.tolist(), strict=True))
        return plain.model_copy(update={"bearings": levelled, "sigmas": known})
