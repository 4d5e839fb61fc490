"""Sightings that fit a robot's own map: when each landmark was last where the map has it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from homeward.estimator import Estimate
from homeward.live.messages import BearingsIn
from homeward.localizer.tunables import MIN_SIGHTINGS


class Fits:
    """Times of sightings that fitted the own map of a robot, on the clock of its drive."""

    def __init__(self) -> None:
        self.last: dict[str, float] = {}
        """When a sighting of each landmark last fitted [s]."""
        self.changed_at = -math.inf
        """When a landmark was last mapped, or mapped elsewhere [s]."""
        self._misfits: dict[str, tuple[float, int]] = {}
        """Time of the first misfit of each landmark after that [s], and their number."""
        self._moved: dict[str, float] = {}
        """When landmarks began to be elsewhere [s]."""

    def add(self, message: BearingsIn, estimate: Estimate) -> None:
        """Add bearings and the answer to them.

        A landmark that fits after `MIN_SIGHTINGS` misfits in a row was mapped, or mapped elsewhere.
        """
        fits = {i.landmark for i in estimate.innovations if i.accepted}
        for name in message.bearings.keys() - fits:
            since, number = self._misfits.get(name, (message.t, 0))
            self._misfits[name] = since, number + 1
        for name in fits:
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
