"""Sightings that agree with a robot's own map, or not: which landmarks are in place, and when."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from homeward.estimator import Estimate, Status
from homeward.geometry.frames import Pose
from homeward.live.messages import BearingsIn
from homeward.localizer.tunables import MIN_SIGHTINGS


class Rejected(NamedTuple):
    """Sighting that does not agree with the map."""

    pose: Pose
    """Pose of the robot."""
    camera: str
    bearing: float
    """[rad]"""
    sigma: float
    """Standard deviation of the innovation [rad]."""


class Fits:
    """Times of sightings that agree with a robot's own map, on the clock of its drive."""

    def __init__(self) -> None:
        self.last: dict[str, float] = {}
        """Time of the last sighting of each landmark that agreed [s]."""
        self.changed_at = -math.inf
        """When the map last got a landmark, or another position of one, or one was doubted [s]."""
        self._misfits: dict[str, tuple[float, int]] = {}
        """Time of the first sighting since then that disagreed [s], and their number."""
        self._moved: dict[str, float] = {}
        """When each landmark that moved was first seen elsewhere [s]."""
        self.rejected: dict[str, deque[Rejected]] = {}
        """Sightings since the last that agreed that were outside the gate, in frames of which most
        fitted, at most `MIN_SIGHTINGS`."""

    def add(self, message: BearingsIn, estimate: Estimate) -> None:
        """Add bearings and the answer to them.

        A landmark that agrees after `MIN_SIGHTINGS` that disagreed is new in the map, or moved.
        """
        fits = {i.landmark for i in estimate.innovations if i.accepted}
        outside = {i.landmark: i.sigma for i in estimate.innovations if i.landmark not in fits}
        pose = estimate.pose if estimate.status is Status.LOCALISED else None
        if pose is not None and len(fits) > len(outside):
            for name in outside.keys() & message.bearings.keys():
                some = self.rejected.setdefault(name, deque(maxlen=MIN_SIGHTINGS))
                if len(some) in (1, MIN_SIGHTINGS - 1):  # a single outlier is no news
                    self.changed_at = message.t
                about = message.camera, message.bearings[name], outside[name]
                some.append(Rejected(pose, *about))
        for name in message.bearings.keys() - fits:
            since, number = self._misfits.get(name, (message.t, 0))
            self._misfits[name] = since, number + 1
        for name in fits:
            self.rejected.pop(name, None)
            since, number = self._misfits.pop(name, (message.t, 0))
            if number >= MIN_SIGHTINGS:
                self.changed_at = message.t
                if name in self.last:
                    self._moved[name] = since
            self.last[name] = message.t

    def outdated(self, together: Iterable[Sequence[str]]) -> set[str]:
        """Return landmarks that were last seen before another one of their group moved.

        `together` are groups of landmarks that move together.
        """
        found = set[str]()
        for group in together:
            moved = max((self._moved.get(name, -math.inf) for name in group), default=-math.inf)
            found |= {name for name in group if self.last.get(name, math.inf) < moved}
        return found
