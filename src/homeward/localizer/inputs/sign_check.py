"""Sign-convention check: whether bearings and turn rates have the same sense of rotation.

When the robot turns left while driving forward, every landmark to its right moves further right, at
any distance, and conversely. If most move the other way, either bearings or turn rates are
clockwise. A mirrored map would fit them all, with a pose that is consistent and wrong.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

from homeward.localizer.inputs.by_id import ById

MIN_TURN, MAX_INTERVAL_S = 0.1, 5.0
"""Two sightings of a landmark are compared once the robot has turned this far [rad] within this
time [s]."""
MIN_ASIDE = 0.1
"""Landmarks nearer than this to straight ahead or behind are on neither side [rad]."""
MIN_COUNT, CERTAIN = 30, 120
"""Comparisons before a verdict; and before the signs are taken as right for good."""
MINORITY = 1.0 / 3.0
"""Largest share of right comparisons that noise cannot explain [1]."""


class SignCheck:
    """Sign-convention check: counts how often bearings and odometry turn in opposite senses.

    Parameters
    ----------
    yaw : float
        Of the camera's axis on the robot [rad].
    """

    def __init__(self, yaw: float) -> None:
        self._yaw = yaw
        self._reference = ById[tuple[float, float, float]]()
        """Reference sighting of each landmark: time [s], heading and bearing [rad]."""
        self._agrees: deque[bool] = deque(maxlen=CERTAIN)
        self._known = False

    @property
    def reversed(self) -> bool:
        """Whether most bearings turn in the wrong sense."""
        return len(self._agrees) >= MIN_COUNT and sum(self._agrees) <= MINORITY * len(self._agrees)

    def bearings(self, t: float, sightings: Mapping[str, float], heading: float, v: float) -> None:
        """Add sightings of stamp `t` [s]: bearings from the camera's axis [rad] by landmark.

        `heading` is that of odometry alone [rad]; the robot drives at `v` [m/s].
        """
        if self._known:
            return
        for name, beta in sightings.items():
            now = (t, heading, math.remainder(beta + self._yaw, math.tau))
            before = self._reference.setdefault(name, now)
            turn = heading - before[1]
            if abs(turn) >= MIN_TURN or t - before[0] > MAX_INTERVAL_S:
                self._reference[name] = now
                if t - before[0] <= MAX_INTERVAL_S and _is_informative(turn, v, before[2], now[2]):
                    self._agrees.append(math.remainder(now[2] - before[2], math.tau) * turn < 0.0)
        self._reference.prune(lambda before: before[0] < t - MAX_INTERVAL_S)  # compared no more
        if len(self._agrees) == CERTAIN and sum(self._agrees) > (1.0 - MINORITY) * CERTAIN:
            self._known = True
            self._reference.clear()


def _is_informative(turn: float, forward: float, before: float, now: float) -> bool:
    """Return whether turn [rad] and drive move a landmark the same way at both bearings."""
    way = math.copysign(1.0, forward) * math.copysign(1.0, turn)
    return forward == 0.0 or max(way * math.sin(before), way * math.sin(now)) < -math.sin(MIN_ASIDE)
