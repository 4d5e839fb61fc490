"""Dead odometry: a twist repeated exactly at zero while the bearings show that the robot moves.

While a robot is stationary, the bearings of static landmarks scatter about their means. While it
moves, they change smoothly, by many standard deviations. People who walk past a stationary robot
change their bearings, too, but are a minority. So most landmarks in view must change.

The test is von Neumann's (1941): for independent errors, outliers included, the mean square of
successive differences is twice the variance, of any size; for a smooth change it is far less.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Mapping

from homeward.localizer.inputs.bearing_noise import BearingNoise
from homeward.localizer.tunables import (
    DEAD_WINDOW_FRAMES,
    DEAD_WINDOW_S,
    GATE,
    MAJORITY,
    MAX_LAG_S,
    MAX_NEUMANN_RATIO,
    MIN_SIGHTINGS,
    MINIMAL,
)

DEAD = (
    "Odometry reported no motion {}, but bearings changed by {:.0f} degrees: the odometry driver "
    "is dead, or the robot was carried. The motion was treated as unknown there, and positions "
    "are from bearings of known landmarks alone. Check the odometry topic or file."
)
REASON = (
    "odometry reports no motion, but bearings changed by {:.0f} degrees: check the odometry; "
    "without it and without surveyed landmarks nothing can be mapped"
)


class _Track:
    """Bearings of one landmark in a window, on the unit circle."""

    def __init__(self, bearing: float) -> None:
        self._first, self._last = bearing, cmath.rect(1.0, bearing)
        self._number, self._sum, self._steps = 1, self._last, 0.0
        self.change = 0.0
        """Largest change from the first bearing [rad]."""

    def add(self, bearing: float, sigma: float) -> bool | None:
        """Add a bearing of a standard deviation [rad]; return whether it changes, if known."""
        now = cmath.rect(1.0, bearing)
        self._number, self._sum = self._number + 1, self._sum + now
        self._steps, self._last = self._steps + abs(now - self._last) ** 2, now
        change = abs(math.remainder(bearing - self._first, math.tau))
        self.change = max(self.change, change)
        if self._number < MIN_SIGHTINGS:
            return None
        squares = self._number - abs(self._sum) ** 2 / self._number
        large = squares > (self._number - 1) * (GATE * sigma) ** 2
        return bool(large) and self._steps < MAX_NEUMANN_RATIO * squares


class DeadOdometry:
    """Detector of dead odometry: whether the robot moves while its twist stays exactly zero."""

    def __init__(self) -> None:
        self.is_dead = False
        """Whether odometry is dead at present."""
        self._since = self._newest = math.nan
        """First and newest stamp of the present run of zero twists [s]; NaN: the robot moves."""
        self._has_moved = False
        self._change, self._dead_from, self._dead_until = 0.0, math.nan, math.nan
        self._waiting: deque[tuple[float, Mapping[str, float], Mapping[str, float], float]] = (
            deque()
        )
        self._begin_window(math.nan)

    def odometry(self, t: float, v: float, omega: float, vy: float = 0.0) -> None:
        """Add a twist of stamp `t` [s]; one that is not exactly zero ends the run."""
        if v or omega or vy:
            self._has_moved |= math.isfinite(v)
            self.is_dead, self._since = False, math.nan
            self._waiting.clear()
            return
        if math.isnan(self._since):
            self._since = t
            self._begin_window(math.nan)
        self._newest = t
        # Odometry may be early or late by the lag: then the robot moves at either end of the run.
        while self._waiting and self._waiting[0][0] <= t - MAX_LAG_S:
            frame = self._waiting.popleft()
            if frame[0] >= self._since + MAX_LAG_S:
                self._test(*frame)

    def bearings(
        self,
        t: float,
        bearings: Mapping[str, float],
        sigmas: Mapping[str, float],
        noise: BearingNoise,
    ) -> None:
        """Add a frame of stamp `t` [s]: bearings, and standard deviations where given [rad]."""
        if not math.isnan(self._since):
            self._waiting.append((t, bearings, sigmas, noise.sigma))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
        if math.isnan(self._dead_from):
            return ()
        when = "all the time"
        if self._has_moved:
            when = f"from {self._dead_from:.1f} s to {self._dead_until:.1f} s"
        return (DEAD.format(when, math.degrees(self._change)),)

    @property
    def reason(self) -> str:
        """Reason why there is no pose while odometry is dead."""
        return REASON.format(math.degrees(self._change))

    def _begin_window(self, t: float) -> None:
        """Begin a window at `t` [s]."""
        self._begun, self._frames = t, 0
        self._tracks: dict[str, _Track] = {}
        self._changes: dict[str, bool] = {}

    def _test(
        self, t: float, bearings: Mapping[str, float], sigmas: Mapping[str, float], default: float
    ) -> None:
        """Test the landmarks of a frame, and decide by all of the window."""
        if not t - self._begun <= DEAD_WINDOW_S and self._frames >= DEAD_WINDOW_FRAMES * bool(
            self._tracks
        ):
            if self._has_moved:  # odometry that never reported a motion stays dead
                self.is_dead &= not self._most(False)
            self._begin_window(t)
        self._frames += 1
        for name, bearing in bearings.items():
            if name not in self._tracks:
                self._tracks[name] = _Track(bearing)
                continue
            changes = self._tracks[name].add(bearing, sigmas.get(name, default))
            if changes is not None:
                self._changes[name] = changes
        self.is_dead |= self._most(True)
        if self.is_dead:
            changed = sorted(self._tracks[n].change for n, yes in self._changes.items() if yes)
            if changed:
                self._change = max(self._change, changed[len(changed) // 2])
            self._dead_until = self._newest
            if math.isnan(self._dead_from):
                self._dead_from = self._since

    def _most(self, change: bool) -> bool:
        """Return whether most landmarks of the window change, or do not."""
        number = sum(yes is change for yes in self._changes.values())
        return number >= MINIMAL and number >= MAJORITY * len(self._changes)
