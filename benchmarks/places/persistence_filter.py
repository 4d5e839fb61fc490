"""A peer: resection among landmarks that a persistence filter holds to be there.

References
----------
Rosen, Mason and Leonard, "Towards lifelong feature-based mapping in semi-static environments",
IEEE ICRA 2016: the filter, here with an exponential prior on survival.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.survey.peers import Resection

MISSED, FALSE = 0.2, 0.02
"""Probabilities not to detect a landmark that is there, and to detect one that is not."""
AGREES = 3.0
"""Within so many sigmas a bearing agrees."""
BELIEVED = 0.5
"""A landmark is used where it is there more probably than not."""
LAST_S = 3600.0
"""Within a drive landmarks survive as in a day that is so long [s]."""


class Persistence:
    """The persistence filter of one landmark.

    Parameters
    ----------
    rate : float
        How often a landmark goes [1 / day].
    """

    def __init__(self, rate: float) -> None:
        self._rate, self._t = rate, 0.0
        self._there, self._gone = 1.0, 0.0
        """Likelihood of what was seen if it is still there; and, summed, if it went before."""

    def update(self, t: float, detected: bool) -> None:
        """Take that it was detected at `t` [days since it was mapped], or was not."""
        went = self._survival(self._t) - self._survival(t)
        self._gone = (FALSE if detected else 1.0 - FALSE) * (self._gone + self._there * went)
        self._there *= (1.0 - MISSED) if detected else MISSED
        self._t = t
        most = max(self._there, self._gone)  # the ratio counts alone
        self._there, self._gone = self._there / most, self._gone / most

    def probability(self, t: float) -> float:
        """Return how probable it is that it is there at `t` [days]."""
        evidence = self._gone + self._there * self._survival(self._t)
        return self._there * self._survival(t) / evidence

    def _survival(self, t: float) -> float:
        return math.exp(-self._rate * t)


class PersistentResection:
    """Each look resected on the landmarks that are believed, the worst outliers left out in turn.

    What does not agree with the pose counts as not detected.

    Parameters
    ----------
    survey : dict of str to (float, float)
        Where landmarks were seen last [m].
    rate : float
        How often a landmark goes [1 / day].
    sigma : float
        Of a bearing [rad].
    """

    def __init__(self, survey: dict[str, tuple[float, float]], rate: float, sigma: float) -> None:
        self._survey, self._sigma = survey, sigma
        self._resection = Resection(survey)
        self._filters = {name: Persistence(rate) for name in survey}

    def look(self, t: float, seen: dict[str, float]) -> np.ndarray | None:
        """Return the pose (3,) at `t` [s of the drive], or None."""
        day = 1.0 + t / LAST_S
        known = {n: b for n, b in seen.items() if n in self._survey}
        believed = {n: b for n, b in known.items() if self._filters[n].probability(day) > BELIEVED}
        while (pose := self._resection.look(believed)) is not None:
            off = self._off(pose, known)
            worst = max(believed, key=lambda name: off[name])
            if off[worst] < AGREES * self._sigma:
                break
            del believed[worst]
        if pose is not None:
            for name, error in off.items():
                self._filters[name].update(day, error < AGREES * self._sigma)
        return pose

    def _off(self, pose: np.ndarray, seen: dict[str, float]) -> dict[str, float]:
        """Return how far bearings are from those of the survey [rad]."""
        off = {}
        for name, found in seen.items():
            x, y = self._survey[name]
            expected = math.atan2(y - pose[1], x - pose[0]) - pose[2]
            off[name] = abs(math.remainder(found - expected, math.tau))
        return off
