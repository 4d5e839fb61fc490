"""Reorder buffer: bearings wait for late odometry; samples that come too late are counted."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from homeward.localizer.tunables import MIN_SAMPLES, REORDER_WAIT_S
from homeward.odometry.validity import MAX_DELAY_S


class BearingFrame(NamedTuple):
    """All bearings of one stamp."""

    t: float
    """[s]"""
    sightings: Mapping[str, float]
    """Bearing [rad] by landmark."""
    sigmas: Mapping[str, float]
    """Standard deviation [rad] of some of them."""
    ranges: Mapping[str, tuple[float, float]] = MappingProxyType({})
    """Logarithm of the range [m] of some of them, and its standard deviation [1]."""
    camera: str = ""
    """Name of their camera ..."""
    offset: np.ndarray | None = None
    """... and its pose (3,) in the frame of the first one; None for the first."""

    def by_camera(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Return values by landmark and camera: between cameras, bearings are no track."""
        if self.offset is None:
            return values
        return {f"{name} {self.camera}": value for name, value in values.items()}


class ReorderBuffer:
    """Reorder buffer: holds bearings until their odometry has arrived, and counts late samples."""

    def __init__(self) -> None:
        self.newest = -math.inf
        """Newest stamp of bearings [s]."""
        self.waiting: deque[BearingFrame] = deque()
        """Frames that wait, in order of time."""
        self._waits_until = -math.inf
        self._counts: Counter[str] = Counter()
        self._late: Counter[str] = Counter()
        self.complaint: str | None = None
        """Message if most samples of a kind came too late."""

    def odometry(self, t: float, late: bool) -> None:
        """Register a twist of stamp `t` [s], and whether it was too late to be used."""
        self._count("odometry", late)
        if self.newest - MAX_DELAY_S <= t < self.newest:
            self._waits_until = t + REORDER_WAIT_S

    def late_bearings(self) -> None:
        """Count bearings that were too late to be used."""
        self._count("bearings", True)

    def bearings(self, frame: BearingFrame) -> None:
        """Queue a bearing frame; `due` returns it."""
        self._count("bearings", False)
        self.newest = frame.t
        self.waiting.append(frame)

    def due(self, last_odometry_t: float, now: float) -> list[BearingFrame]:
        """Remove and return the frames that need not wait any longer, in order of time.

        Given the newest stamps of odometry, and of all [s].
        """
        due = []
        while self.waiting:
            t = self.waiting[0].t
            if last_odometry_t < t < self._waits_until and t >= now - MAX_DELAY_S:
                break
            due.append(self.waiting.popleft())
        return due

    def _describe_late(self) -> str | None:
        """Return the present `complaint`."""
        for kind, late in self._late.items():
            count = self._counts[kind]
            if count >= MIN_SAMPLES and 2 * late > count:
                return (
                    f"most {kind} came too late, {late:,} of {count:,}; feed samples "
                    f"in the order of their stamps, none more than {MAX_DELAY_S:g} s late"
                )
        return None

    def _count(self, kind: str, late: bool) -> None:
        """Count a sample."""
        self._counts[kind] += 1
        if late:
            self._late[kind] += 1
        if self._late:
            self.complaint = self._describe_late()
