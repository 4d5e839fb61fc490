"""Capture of home bearings where the robot is: at rest, or while it turns on the spot."""

from __future__ import annotations

import math
from collections import deque
from operator import itemgetter
from typing import NamedTuple

from homeward.drives.drive import HomeBearing, Samples
from homeward.drives.home.rest import rest_directions
from homeward.drives.home.spin import HomeScan, spin_summary
from homeward.drives.settings import DriveSettings
from homeward.drives.settings import Start as StartPrior
from homeward.errors import InputError
from homeward.geometry.frames import Polar, to_polar
from homeward.live.messages import BearingsIn, OdometryIn
from homeward.odometry.history import TwistHistory
from homeward.odometry.validity import MAX_DELAY_S

CAPTURE_S, MAX_SPEED_AT_REST = 1.0, 0.01
"""Bearings of this time [s] are averaged, and the robot must on average be slower [m/s, rad/s]."""
MIN_R = 0.001
"""Minimum distance from home of a start prior, since home itself has no direction from home [m]."""
SIGMAS_AT_REST = 0.01, 3.0, 0.02
"""Standard deviations of the start prior after a capture at rest: R [m], theta, alpha [rad]."""
SIGMAS_AFTER_TURN = 0.05, 3.0, 0.02
"""The same after a turn, in which wheels slip."""
NOTHING_SEEN = "home cannot be stored: no landmark in view"


class CapturedHome(NamedTuple):
    """Home bearings, and the start prior of the robot."""

    seen: dict[str, HomeBearing]
    start: StartPrior
    """Pose of the robot now, in the home frame."""
    words: str
    """Description of a turn, or of the bearings left out at rest; empty if there were none."""


class HomeCapture:
    """Recent bearings, and after `begin` those of a turn at home.

    Samples come with their time `t` on a clock that is never set back [s].
    """

    def __init__(self) -> None:
        self._newest = -math.inf
        """Newest time of all samples [s]."""
        self._lately: deque[tuple[float, BearingsIn]] = deque(maxlen=400)
        self._twists = TwistHistory()
        self._scan: HomeScan | None = None

    @property
    def newest(self) -> BearingsIn | None:
        """The bearings of the newest stamp, if there were any; the last of equal stamps."""
        return max(reversed(self._lately), key=itemgetter(0))[1] if self._lately else None

    def odometry(self, t: float, message: OdometryIn) -> None:
        """Add a twist."""
        if not self._is_too_late(t) and self._scan is not None:
            self._scan.odometry(t, message.v, message.omega, message.vy)
        if t >= self._twists.newest:
            self._twists.add(t, message.v, message.omega, vy=message.vy)
            self._twists.forget(t - 2.0 * CAPTURE_S)

    def bearings(self, t: float, message: BearingsIn) -> None:
        """Add bearings."""
        self._lately.append((t, message))
        if not self._is_too_late(t) and self._scan is not None:
            self._scan.bearings(t, message.bearings, message.sigmas, message.camera)

    def _is_too_late(self, t: float) -> bool:
        """Return whether a new sample is as late as if its clock was set back."""
        self._newest = max(self._newest, t)
        return t < self._newest - MAX_DELAY_S

    def begin(self, robot: DriveSettings) -> None:
        """Begin the capture of a home where the robot is; it may turn on the spot."""
        self._scan = HomeScan(**robot.robot)

    def set_robot(self, robot: DriveSettings) -> None:
        """Use other camera extrinsics for a capture that has begun."""
        if self._scan is not None:
            self._scan.robot = robot

    def end(self) -> None:
        """End the capture of a turn."""
        self._scan = None

    def captured(self) -> CapturedHome:
        """Return the home captured since `begin`, or else the home captured at rest just now.

        `InputError` where no landmark was in view, or the robot moved.
        """
        scan, self._scan = self._scan, None
        return self._at_rest() if scan is None else _turned(scan)

    def _at_rest(self) -> CapturedHome:
        """Return the mean bearings of the last `CAPTURE_S`, without outliers."""
        since = max((t for t, _ in self._lately), default=math.inf) - CAPTURE_S
        views = [view for t, view in self._lately if t > since]
        if not any(v.bearings for v in views):
            raise InputError(NOTHING_SEEN)
        if max(map(abs, self._twists.mean(since + CAPTURE_S, CAPTURE_S))) > MAX_SPEED_AT_REST:
            raise InputError(
                f"home cannot be stored: the robot must stand still for {CAPTURE_S:g} s"
            )
        seen = Samples()
        for view in views:
            seen.add_bearings(view.t, view.bearings, camera=view.camera)
        home, remarks = rest_directions(seen.sightings())
        start = StartPrior.about(Polar(MIN_R, 0.0, 0.0), *SIGMAS_AT_REST)
        words = "; ".join(f"{number} {text}" for text, number in remarks.items())
        return CapturedHome(home, start, words)


def _turned(scan: HomeScan) -> CapturedHome:
    """Return the home captured during a turn."""
    found = scan.spin()
    end, (*sigmas, turned) = to_polar(found.end), SIGMAS_AFTER_TURN
    start = StartPrior.about(
        end._replace(R=max(end.R, MIN_R), alpha=found.end.heading),
        *sigmas,
        math.hypot(turned, found.heading_sigma),
    )
    return CapturedHome(found.home, start, spin_summary(found))
