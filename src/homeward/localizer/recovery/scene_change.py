"""Scene-change detection, for a robot that was kidnapped to where nothing of its map is in sight.

Bearings that do not fit the map tell that it was lifted. Where most are of landmarks that are not
mapped yet, little contradicts the map, and odometry knows nothing of the way. But a robot that
hardly moved does not lose everything out of sight and see as much else instead.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from homeward.angles import wrap
from homeward.estimator import CHECKED, Innovation
from homeward.localizer.tunables import LINEAR


class SceneChangeDetector:
    """Scene-change detector: all that is in sight was replaced at once."""

    def __init__(self) -> None:
        self._seen: frozenset[str] = frozenset()
        """What was in sight when enough of it last fitted the map ..."""
        self._from = np.zeros(3)
        """... and from where, (3,), in the odometry frame."""

    def has_changed(
        self,
        names: Collection[str],
        innovations: Collection[Innovation],
        place: np.ndarray,
        landmarks: np.ndarray,
    ) -> bool:
        """Return whether what was in sight before is gone, and as much else has come.

        Parameters
        ----------
        names : collection of str
            All landmarks in sight.
        innovations : collection of Innovation
            Of those that are mapped.
        place : ndarray, shape (3,)
            Where odometry has the robot, in the odometry frame.
        landmarks : ndarray, shape (n, 2)
            Where those of the map stand in it [m].
        """
        fitting = sum(i.accepted for i in innovations)
        if fitting >= CHECKED:
            self._seen, self._from = frozenset(names), place
        if fitting or not self._seen:
            return False
        new = len(frozenset(names) - self._seen)
        if new < CHECKED or 2 * new <= len(names):
            return False
        off = place - self._from
        distances = np.hypot(*(landmarks - self._from[:2]).T)
        near = np.hypot(*off[:2]) < LINEAR * np.median(distances)
        return bool(near and abs(wrap(off[2])) < LINEAR)
