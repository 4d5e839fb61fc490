"""Home where the robot is: what it sees from there, standing, or while it turns."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.drives.home.spin import HomeScan, spin_summary
from homeward.drives.settings import DriveSettings
from homeward.drives.settings import Start as StartPrior
from homeward.errors import InputError
from homeward.geometry.frames import Polar, to_polar
from homeward.live.messages import BearingsIn, OdometryIn
from homeward.odometry.clock import Clock
from homeward.odometry.history import TwistHistory

STORE_S, STANDING = 1.0, 0.01
"""Home is what was seen for so long [s], by a robot no faster on average [m/s, rad/s]."""
NEAREST_M = 0.001
"""At home there is no direction from home, so priors are no nearer to it [m]."""
AT_HOME = 0.01, 3.0, 0.02
"""How far a robot is off that stores home where it stands: R [m], theta, alpha [rad] ..."""
AFTER_TURN = 0.05, 3.0, 0.02
"""... and one that turned there: wheels that slip take it so far."""


class Here(NamedTuple):
    """Home, looked at."""

    seen: dict[str, HomeBearing]
    start: StartPrior
    """Where the robot is now, in its frame."""
    words: str
    """How it was found; none where the robot just stood."""


class Looking:
    """What was seen lately, and, once that was asked for, from home."""

    def __init__(self) -> None:
        self._clock = Clock()
        self._lately: deque[tuple[float, BearingsIn]] = deque(maxlen=400)
        self._twists = TwistHistory()
        self._looks: HomeScan | None = None

    @property
    def newest(self) -> BearingsIn | None:
        """The last look, if there was any."""
        return self._lately[-1][1] if self._lately else None

    def odometry(self, message: OdometryIn) -> None:
        """Take a twist."""
        if self._looks is not None:
            self._looks.odometry(message.t, message.v, message.omega)
        t = self._clock.read(message.t)
        if t >= self._twists.newest:
            self._twists.add(t, message.v, message.omega)
            self._twists.forget(t - 2.0 * STORE_S)

    def bearings(self, message: BearingsIn) -> None:
        """Take a look."""
        self._lately.append((self._clock.read(message.t), message))
        if self._looks is not None:
            self._looks.bearings(message.t, message.bearings, message.sigmas)

    def begin(self, robot: DriveSettings) -> None:
        """Let home be where the robot is: it may turn, but stays."""
        self._looks = HomeScan(**robot.robot)

    def end(self) -> None:
        """Look at home no more."""
        self._looks = None

    def here(self) -> Here:
        """Return the home that was looked at since `begin`, or else what is seen now, standing.

        `InputError` where there is none, or the robot moved.
        """
        looks, self._looks = self._looks, None
        return self._standing() if looks is None else _turned(looks)

    def _standing(self) -> Here:
        """Return the mean of some views."""
        since = max((t for t, _ in self._lately), default=math.inf) - STORE_S
        views = [view for t, view in self._lately if t > since]
        if not any(v.bearings for v in views):
            raise InputError("home cannot be stored: nothing is seen")
        if max(map(abs, self._twists.mean(since + STORE_S, STORE_S))) > STANDING:
            raise InputError(f"home cannot be stored: stand still for {STORE_S:g} s")
        seen: dict[str, list[float]] = {}
        for view in views:
            for i, b in view.bearings.items():
                seen.setdefault(i, []).append(b)
        start = StartPrior.about(Polar(NEAREST_M, 0.0, 0.0), *AT_HOME)
        means = {i: float(np.angle(np.exp(1j * np.array(b)).mean())) for i, b in seen.items()}
        return Here({i: HomeBearing(b) for i, b in means.items()}, start, "")


def _turned(looks: HomeScan) -> Here:
    """Return what looks all round tell."""
    found = looks.spin()
    end, (*sigmas, turned) = to_polar(found.end), AFTER_TURN
    start = StartPrior.about(
        end._replace(R=max(end.R, NEAREST_M), alpha=found.end.heading),
        *sigmas,
        math.hypot(turned, found.heading_sigma),
    )
    return Here(found.home, start, spin_summary(found))
