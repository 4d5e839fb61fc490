"""Watchdogs of the sensors: checks that samples are new, and on one clock."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from statistics import median_high
from typing import NamedTuple

from homeward.drives.plausibility import UNITS
from homeward.geometry.frames import Twist
from homeward.odometry.validity import Clock

AHEAD_S = 2.0
"""A stamp this far ahead of all others is an error, unless `SEVERAL` stamps agree with it [s]."""
SEVERAL = 5
NUM_STEPS, MIN_REFUSED = 15, 20
"""Number of latest steps between stamps in the typical one, and of refused samples for a note."""
CLEARED_S = 0.5
"""A fault lasts until its cause has been absent for this long [s]. Otherwise a sensor at its limit
would start and stop the robot many times a second."""


class Fault(NamedTuple):
    """Fault that keeps the robot from driving."""

    reason: str
    """Text that does not change while the fault lasts."""
    value: float | None = None
    """The measured quantity, in the unit of the limit in the reason."""


class FaultCheck(NamedTuple):
    """One row in the table of faults of a session."""

    fault: Fault
    is_present: bool
    lasts: bool = True
    """Whether the fault lasts until its cause has been absent for `CLEARED_S`."""


class Faults:
    """Faults of a table of checks that are active: present, or present just before."""

    def __init__(self) -> None:
        self._last: dict[str, float] = {}
        """When each lasting fault was last present [s], by reason."""

    def active(self, checks: Iterable[FaultCheck], now: float) -> tuple[Fault, ...]:
        """Return the active faults at `now` [s], in the order of the checks."""
        found = dict[str, Fault]()
        for fault, is_present, lasts in checks:
            last = self._last.get(fault.reason, -math.inf)
            if is_present and lasts:
                self._last[fault.reason] = max(last, now)
            if is_present or last <= now < last + CLEARED_S:
                found.setdefault(fault.reason, fault)
        return tuple(found.values())


class DrivingTime:
    """Time since an event [s], without turns on the spot, which do not change the position."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def add(self, dt: float, twist: Twist, vy: float = 0.0) -> None:
        """Add the time `dt` [s] in which the robot had this command, `vy` [m/s] to the left."""
        if twist.v or vy or not twist.omega:
            self.seconds += dt


class StampsOfKind:
    """Stamps of the samples of one kind, for a note on their unit and clock."""

    def __init__(self) -> None:
        self.steps: deque[float] = deque(maxlen=NUM_STEPS)
        """Steps between the latest ones [s]."""
        self.newest = -math.inf
        """The latest one [s]."""
        self.number, self.refused = 0, 0

    def add(self, t: float) -> None:
        """Add the stamp of a sample [s]."""
        self.steps.append(t - self.newest)
        self.newest = t
        self.number += 1

    @property
    def step(self) -> float:
        """Median step [s]."""
        return median_high(self.steps)


class StampGate:
    """Accepts a clock that jumps ahead permanently, and refuses single stamps from the future."""

    def __init__(self) -> None:
        self._newest = -math.inf
        self._ahead: deque[float] = deque(maxlen=SEVERAL)
        self._kinds: dict[str, StampsOfKind] = {}

    def accepts(self, t: float, kind: str) -> bool:
        """Return whether the stamp `t` [s] of a sample is plausible.

        `kind` has its name in the plural: samples of one kind have one clock.
        """
        stamps = self._kinds.setdefault(kind, StampsOfKind())
        stamps.add(t)
        is_plausible = self._is_plausible(t)
        stamps.refused += not is_plausible
        return is_plausible

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user on kinds of samples most of which were refused."""
        return tuple(
            self._note(kind, stamps)
            for kind, stamps in self._kinds.items()
            if stamps.refused >= MIN_REFUSED and 2 * stamps.refused > stamps.number
        )

    def _note(self, kind: str, stamps: StampsOfKind) -> str:
        """Return the note on a kind of samples."""
        words = f"{stamps.refused:,} of {stamps.number:,} {kind} were ignored: their stamps are"
        if (step := stamps.step) > AHEAD_S:
            unit = next((name for size, name in UNITS.items() if step <= size), "other units")
            return f"{words} {step:,.4g} s apart. Convert them to seconds if they are in {unit}."
        others = {n: stamps.newest - s.newest for n, s in self._kinds.items() if n != kind}
        name, ahead = max(others.items(), key=lambda item: abs(item[1]), default=("others", 0.0))
        return (
            f"{words} {abs(ahead):,.0f} s {'ahead of' if ahead > 0 else 'behind'} those of {name}."
            " Use one clock for both, in seconds."
        )

    def _is_plausible(self, t: float) -> bool:
        """Return whether a stamp [s] is near the others, or agrees with several before it."""
        if self._newest == -math.inf or t < self._newest + AHEAD_S:
            self._ahead.clear()
            # A clock that was set back continues from there, which the estimators handle.
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
    """Detects that samples of one kind are missing, or repeat an old stamp.

    `what` is their name in the plural, `timeout` the maximum time without a newer stamp [s], and
    `clock` the common clock of all kinds of samples, which handles stamps that are set back.
    """

    def __init__(self, what: str, timeout: float, clock: Clock) -> None:
        self._what, self._timeout, self._clock = what, timeout, clock
        self.newest = -math.inf
        """Newest stamp [s], on a clock that is never set back."""
        self._heard = -math.inf

    def record(self, t: float, now: float) -> float:
        """Record a sample with stamp `t` [s], received at `now` [s] on a steady clock.

        Return the stamp on a clock that is never set back [s].
        """
        t = self._clock.read(t)
        if t > self.newest:
            self.newest, self._heard = t, now
        return t

    def check(self, now: float) -> FaultCheck:
        """Return the check at `now` [s]; the value is the time since the last sample [s]."""
        if self._heard == -math.inf:
            return FaultCheck(Fault(f"no {self._what} yet"), True, lasts=False)
        silent, words = now - self._heard, f"no {self._what} for more than {self._timeout:g} s"
        return FaultCheck(Fault(words, silent), silent > self._timeout)
