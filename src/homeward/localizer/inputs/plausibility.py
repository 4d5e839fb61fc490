"""Plausibility check of odometry: speeds and accelerations that no wheeled robot has.

Encoders are reset, counters wrap round and messages are damaged. Then one twist is far too large,
and the pose would move by metres at a small covariance. Such a twist means unknown motion.
"""

from __future__ import annotations

import math
from collections import deque

from homeward.geometry.robust import MAD_TO_SIGMA
from homeward.localizer.tunables import GATE, MIN_INTERVAL_S, NUM_CHANGES, START_S
from homeward.odometry.limits import GRIP_ACCELERATION, GRIP_TURN_ACCELERATION, MAX_RATE

IMPLAUSIBLE = (
    "Odometry reported impossible motion {} times, first at {:.2f} s (speed or acceleration no "
    "wheeled robot has, or not a number). The motion up to the next twist was treated as unknown, "
    "so the pose is less certain there. Look for encoder resets, counter overflow or damaged "
    "messages."
)


LIMITS = GRIP_ACCELERATION, GRIP_TURN_ACCELERATION, GRIP_ACCELERATION
"""Maximum accelerations [m/s^2, rad/s^2, m/s^2] by rate of a twist: v, omega, vy."""


class Plausibility:
    """Plausibility check: whether a robot can have reached a twist since the last plausible one."""

    def __init__(self) -> None:
        self._last: tuple[float, float, float, float] | None = None
        """Last plausible twist: time [s], speed [m/s], turn rate [rad/s], speed to the left [m/s].
        """
        self._received = 0.0, 0.0, 0.0
        """Last twist of all [m/s, rad/s, m/s] ..."""
        self._changes = tuple(deque[float](maxlen=NUM_CHANGES) for _ in self._received)
        """... and the sizes of the latest changes."""
        self._number, self._first = 0, math.nan

    def accepts(self, t: float, v: float, omega: float, vy: float = 0.0) -> bool:
        """Return whether a twist of stamp `t` [s] is plausible; count it if not.

        The speeds that a robot may have reached grow with the time since the last plausible twist,
        and differ from it by the usual noise of the odometry at most `GATE` standard deviations.
        So a single wrong sample is refused, and a real change of speed is accepted soon.
        """
        if self._last is None and math.isfinite(t):
            self._last = (t - START_S, 0.0, 0.0, 0.0)
        twist = v, omega, vy
        if self._last is not None and all(abs(rate) < MAX_RATE for rate in twist):
            before, *last = self._last
            time = max(abs(t - before), MIN_INTERVAL_S)
            noise = [GATE * MAD_TO_SIGMA * _median(changes) for changes in self._changes]
            for changes, now, then in zip(self._changes, twist, self._received, strict=True):
                changes.append(abs(now - then))
            self._received = twist
            change = zip(twist, last, LIMITS, noise, strict=True)
            if all(abs(now - then) <= limit * time + by for now, then, limit, by in change):
                self._last = (t, *twist)
                return True
        if not (math.isnan(v) and math.isnan(omega)):
            self._number += 1
            self._first = t if math.isnan(self._first) else self._first
        return False

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
        return (IMPLAUSIBLE.format(self._number, self._first),) if self._number else ()


def _median(changes: deque[float]) -> float:
    """Return the median of changes, 0 while there are few of them."""
    return sorted(changes)[len(changes) // 2] if len(changes) == NUM_CHANGES else 0.0
