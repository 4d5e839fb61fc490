"""What tells that a robot may have been carried to where nothing of its map is in sight.

Bearings that do not fit the map tell that it was lifted. Where all are of landmarks that were not
mapped yet, nothing contradicts the map, and odometry knows nothing of the way. But a robot that
hardly moved does not lose everything out of sight and see as much else instead.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from homeward.angles import wrap
from homeward.estimator import Innovation
from homeward.frames import Pose, compose
from homeward.localizer.landmarks import Landmarks
from homeward.localizer.mapper import Mapper

FEWEST = 4
"""So many landmarks must go out of sight, and so many others come, at the fewest."""
HARDLY_RAD, HARDLY_SHARE = 0.3, 0.3
"""A robot has hardly moved that turned by less [rad] and drove less [distance of landmarks]."""
FITTING = 6
"""So many sightings in a row of landmarks known before must fit for it to be where it was."""


class Elsewhere:
    """Watches for all that is in sight being replaced at once."""

    def __init__(self) -> None:
        self._before: frozenset[str] | None = None
        """What was mapped when the robot may have been carried off; None where it was not."""
        self._seen: frozenset[str] = frozenset()
        """What was in sight when enough of the map last was ..."""
        self._from = np.zeros(3)
        """... and from where, (3,), in the odometry frame."""
        self._fitting = 0
        """Sightings in a row of landmarks known before that fit."""
        self._map: Landmarks | None = None

    @property
    def doubted(self) -> bool:
        """Whether the robot may be elsewhere."""
        return self._before is not None

    def look(self, t: float, names: Collection[str], seen: list[Innovation], map_: Mapper) -> None:
        """Take what was in sight at `t` [s].

        Parameters
        ----------
        t : float
            Not before the last one's.
        names : collection of str
            All landmarks in sight.
        seen : list of Innovation
            Of those that were mapped.
        map_ : Mapper
            After it took them.
        """
        if map_.lost.since is not None or map_.landmarks is not self._map:
            # The map is contradicted, and searched for the robot; or it is another map.
            self._before, self._seen, self._map = None, frozenset(), map_.landmarks
        elif self._before is not None:
            for i in seen:
                if i.landmark in self._before:
                    self._fitting = self._fitting + 1 if i.accepted else 0
            if self._fitting >= FITTING:
                self._before, self._fitting = None, 0
        elif len(seen) >= FEWEST:
            self._seen, self._from = frozenset(names), _place(t, map_)
        elif self._all_others(names, seen) and self._hardly_moved(t, map_):
            self._before = frozenset(map_.landmarks.mapped)

    def _all_others(self, names: Collection[str], seen: list[Innovation]) -> bool:
        """Return whether enough is in sight, none of it mapped or in sight before."""
        enough = bool(self._seen) and len(names) >= FEWEST
        return enough and not seen and self._seen.isdisjoint(names)

    def _hardly_moved(self, t: float, map_: Mapper) -> bool:
        """Return whether the robot is at `t` [s] near where enough of the map was in sight."""
        off = _place(t, map_) - self._from
        distances = np.hypot(*(map_.marginal.positions - self._from[:2]).T)
        near = np.hypot(*off[:2]) < HARDLY_SHARE * np.median(distances)
        return bool(near and abs(wrap(off[2])) < HARDLY_RAD)


def _place(t: float, map_: Mapper) -> np.ndarray:
    """Return the robot's pose at `t` [s], (3,), in the odometry frame."""
    newest, since = Pose(*map_.marginal.mean[:3].tolist()), map_.motion(t)
    return np.array(compose(newest, Pose(*since.delta.tolist())))
