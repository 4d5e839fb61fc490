"""Watchdogs of the sensors: whether what comes in is new, and on one clock."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from homeward.odometry.clock import Clock

AHEAD_S = 2.0
"""A stamp so far ahead of all others is a mistake, until `SEVERAL` agree with it [s]."""
SEVERAL = 5
CLEARED_S = 0.5
"""A fault lasts until its cause has been absent for this long [s]: a sensor just at its limit would
otherwise start and stop the robot many times a second."""


class Fault(NamedTuple):
    """Fault that keeps the robot from driving."""

    reason: str
    """In words that stay the same while the fault lasts."""
    value: float | None = None
    """The measured quantity, in the unit of the limit in the reason."""


class Lasting:
    """Condition that lasts until it has been absent for `CLEARED_S`."""

    def __init__(self) -> None:
        self._last = -math.inf

    def holds(self, present: bool, now: float) -> bool:
        """Return whether the condition holds at `now` [s], given whether it is present."""
        if present:
            self._last = max(self._last, now)
        return present or self._last <= now < self._last + CLEARED_S


class StampGate:
    """Takes a clock that jumps ahead for good, and refuses single stamps from the future."""

    def __init__(self) -> None:
        self._newest = -math.inf
        self._ahead: deque[float] = deque(maxlen=SEVERAL)

    def takes(self, t: float) -> bool:
        """Return whether a sample of stamp `t` [s] is to be believed."""
        if self._newest == -math.inf or t < self._newest + AHEAD_S:
            self._ahead.clear()
            # A clock that was set back goes on from there; the estimators wait for that themselves.
            self._newest = max(self._newest, t) if t > self._newest - AHEAD_S else t
            return True
        self._ahead.append(t)
        agree = max(self._ahead) - min(self._ahead) < AHEAD_S
        if len(self._ahead) < SEVERAL or not agree:
            return False
        self._ahead.clear()
        self._newest = t
        return True


class Watchdog:
    """Watches one kind of samples; a driver that repeats itself counts as dead.

    Parameters
    ----------
    what : str
        The kind, as a plural.
    timeout : float
        It is dead after so long without a newer stamp [s].
    clock : Clock
        The one of all kinds; stamps may be set back.
    """

    def __init__(self, what: str, timeout: float, clock: Clock) -> None:
        self._what, self._timeout, self._clock = what, timeout, clock
        self.newest = -math.inf
        """Newest stamp [s], on a clock that is never set back."""
        self._heard = -math.inf
        self._silent = Lasting()

    def hear(self, t: float, now: float) -> float:
        """Take note of a sample of stamp `t` [s] at `now` [s] on a steady clock.

        Returns
        -------
        float
            The stamp on a clock that is never set back [s].
        """
        t = self._clock.read(t)
        if t > self.newest:
            self.newest, self._heard = t, now
        return t

    def fault(self, now: float) -> Fault | None:
        """Return the fault at `now` [s]; its value is the time since the last sample [s]."""
        if self._heard == -math.inf:
            return Fault(f"no {self._what} yet")
        silent = now - self._heard
        if not self._silent.holds(silent > self._timeout, now):
            return None
        return Fault(f"no {self._what} for more than {self._timeout:g} s", silent)
