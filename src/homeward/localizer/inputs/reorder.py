"""Reorder buffer: bearings wait for odometry that comes late; what comes too late is told.

The motion up to some bearings is known once odometry of a later stamp has come. Mostly it has come
just before, or the bearings themselves are late. Where it is odometry that is late, the bearings
wait for it.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from homeward.drives.clock import LATE_S

LATELY_S = 10.0
"""After odometry that came later than bearings, they wait for it so long [s]."""
SEVERAL = 10
"""Of fewer samples nobody says that most come late."""


class BearingFrame(NamedTuple):
    """Bearing frame: all sightings of one stamp."""

    t: float
    """[s]"""
    sightings: Mapping[str, float]
    """Bearing [rad] by landmark."""
    sigmas: Mapping[str, float]
    """Standard deviation [rad] of some of them."""


class ReorderBuffer:
    """Reorder buffer: keeps bearings until their odometry has come, and counts late samples."""

    def __init__(self) -> None:
        self.newest = -math.inf
        """The last stamp of bearings [s]."""
        self._waiting: deque[BearingFrame] = deque()
        self._waits_until = -math.inf
        self._came: Counter[str] = Counter()
        self._late: Counter[str] = Counter()

    def odometry(self, t: float, late: bool) -> None:
        """Take note of a twist of stamp `t` [s], and whether it was too late to be used."""
        self._count("odometry", late)
        if self.newest - LATE_S <= t < self.newest:
            self._waits_until = t + LATELY_S

    def late_bearings(self) -> None:
        """Take note of bearings that were too late to be used."""
        self._count("bearings", True)

    def bearings(self, frame: BearingFrame) -> None:
        """Take bearings; `due` returns them."""
        self._count("bearings", False)
        self.newest = frame.t
        self._waiting.append(frame)

    def due(self, last_odometry_t: float, now: float) -> Iterator[BearingFrame]:
        """Yield the bearings that need not wait any longer, in order of time.

        Parameters
        ----------
        last_odometry_t : float
            The newest stamp of odometry [s].
        now : float
            The newest stamp of all [s].
        """
        while self._waiting:
            t = self._waiting[0].t
            if last_odometry_t < t < self._waits_until and t >= now - LATE_S:
                return
            yield self._waiting.popleft()

    @property
    def waits(self) -> bool:
        """Whether there are bearings that wait."""
        return bool(self._waiting)

    def complaint(self) -> str | None:
        """Return in words that most samples of a kind came too late; None where they did not."""
        for kind, late in self._late.items():
            came = self._came[kind]
            if came >= SEVERAL and 2 * late > came:
                return (
                    f"most {kind} came too late, {late:,} of {came:,}; feed samples "
                    f"in the order of their stamps, none more than {LATE_S:g} s late"
                )
        return None

    def _count(self, kind: str, late: bool) -> None:
        """Count a sample."""
        self._came[kind] += 1
        if late:
            self._late[kind] += 1
