"""Sign-convention check: whether bearings and turn rates run the same way round.

Where the robot turns to the left and drives forward, whatever it sees to its right goes farther to
the right, however near it is; and the other way round. Where most of it goes the other way, the
bearings run clockwise, or the turn rates do. A map can be made of that, too: in the mirror, with a
pose that agrees with itself and is wrong.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

LEAST_TURN, LONGEST_S = 0.1, 5.0
"""Two sightings of a landmark are compared when the robot has turned by so much [rad] in no more
than so much time [s]."""
ASIDE = 0.1
"""Landmarks nearer to straight ahead or behind are on no side [rad]."""
ENOUGH, CERTAIN = 30, 120
"""So many comparisons tell; after so many, most of them right, the signs are known for good."""
FEW = 1.0 / 3.0
"""Where no more are right, it is no matter of noise [1]."""


class SignCheck:
    """Sign-convention check: counts whether bearings go against the turns of the odometry.

    Parameters
    ----------
    yaw : float
        Of the camera's axis on the robot [rad].
    """

    def __init__(self, yaw: float) -> None:
        self._yaw = yaw
        self._last: dict[str, tuple[float, float, float]] = {}
        """When a landmark was seen [s], and heading and bearing then [rad]."""
        self._agrees: deque[bool] = deque(maxlen=CERTAIN)
        self._known = False

    @property
    def reversed(self) -> bool:
        """Whether most bearings go the wrong way."""
        return len(self._agrees) >= ENOUGH and sum(self._agrees) <= FEW * len(self._agrees)

    def bearings(self, t: float, sightings: Mapping[str, float], heading: float, v: float) -> None:
        """Take sightings of stamp `t` [s], bearings from the camera's axis [rad] by landmark.

        The robot's heading is by odometry alone [rad], it drives at `v` [m/s].
        """
        if self._known:
            return
        for name, beta in sightings.items():
            now = (t, heading, math.remainder(beta + self._yaw, math.tau))
            before = self._last.setdefault(name, now)
            turn = heading - before[1]
            if abs(turn) >= LEAST_TURN or t - before[0] > LONGEST_S:
                self._last[name] = now
                if t - before[0] <= LONGEST_S and _tells(turn, v, before[2], now[2]):
                    self._agrees.append(math.remainder(now[2] - before[2], math.tau) * turn < 0.0)
        if len(self._agrees) == CERTAIN and sum(self._agrees) > (1.0 - FEW) * CERTAIN:
            self._known = True
            self._last.clear()


def _tells(turn: float, forward: float, before: float, now: float) -> bool:
    """Return whether turning [rad] and driving move a landmark the same way at both bearings."""
    way = math.copysign(1.0, forward) * math.copysign(1.0, turn)
    return forward == 0.0 or max(way * math.sin(before), way * math.sin(now)) < -math.sin(ASIDE)
