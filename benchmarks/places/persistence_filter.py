"""A peer: resection on the landmarks that a persistence filter accepts.

Rosen, Mason and Leonard, "Towards lifelong feature-based mapping in semi-static environments",
IEEE ICRA 2016: the filter, here with an exponential prior on survival.
"""

import math

import numpy as np

from benchmarks.peers.online import STEPS, residuals
from homeward.localizer.resection import poses_from_triples

MISSED, FALSE = 0.2, 0.02  # probabilities of a missed and of a false detection
AGREES = 3.0  # maximum error of a bearing that agrees [sigmas]
MIN_PROBABILITY = 0.5  # minimum probability of presence of a used landmark
LAST_S = 3600.0  # duration in a drive that counts as a day [s]


class Persistence:
    """The persistence filter of one landmark; landmarks go at `rate` [1 / day]."""

    def __init__(self, rate: float) -> None:
        self._rate, self._t = rate, 0.0
        self._there, self._gone = 1.0, 0.0
        """Likelihood of the detections if it is still present; and, summed, if it went before."""

    def update(self, t: float, detected: bool) -> None:
        """Update with a detection, or a miss, at `t` [days since it was mapped]."""
        went = self._survival(self._t) - self._survival(t)
        self._gone = (FALSE if detected else 1.0 - FALSE) * (self._gone + self._there * went)
        self._there *= (1.0 - MISSED) if detected else MISSED
        self._t = t
        most = max(self._there, self._gone)  # only the ratio matters
        self._there, self._gone = self._there / most, self._gone / most

    def probability(self, t: float) -> float:
        evidence = self._gone + self._there * self._survival(self._t)
        return self._there * self._survival(t) / evidence

    def _survival(self, t: float) -> float:
        return math.exp(-self._rate * t)


class Resection:
    """Least squares of all bearings of a frame, from its best triple, without outlier rejection."""

    def __init__(self, survey: dict[str, tuple[float, float]]) -> None:
        self._survey = survey

    def look(self, seen: dict[str, float]) -> np.ndarray | None:
        """Return the pose (3,) from bearings [rad], or None."""
        seen = {n: b for n, b in seen.items() if n in self._survey}
        if len(seen) < 3:
            return None
        places = np.array([self._survey[n] for n in seen])
        bearings = np.array(list(seen.values()))
        poses = poses_from_triples(places, bearings)
        if not len(poses):
            return None
        costs = np.abs(residuals(poses[:, None], places, bearings)).sum(axis=1)
        pose = poses[int(np.argmin(costs))]
        for _ in range(STEPS):
            d = places - pose[:2]
            square = (d**2).sum(axis=1)
            jacobian = np.column_stack([d[:, 1] / square, -d[:, 0] / square, -np.ones(len(d))])
            step = np.linalg.lstsq(jacobian, residuals(pose, places, bearings), rcond=None)[0]
            pose = pose + step
        return pose


class PersistentResection:
    """Resection of each frame on the accepted landmarks, without the worst outliers.

    Landmarks were last seen at the positions of `survey` [m]; those that disagree with the pose
    count as missed. `sigma` is that of a bearing [rad].
    """

    def __init__(self, survey: dict[str, tuple[float, float]], rate: float, sigma: float) -> None:
        self._survey, self._sigma = survey, sigma
        self._resection = Resection(survey)
        self._filters = {name: Persistence(rate) for name in survey}

    def look(self, t: float, seen: dict[str, float]) -> np.ndarray | None:
        """Return the pose (3,) at `t` [s of the drive], or None."""
        day = 1.0 + t / LAST_S
        known = {n: b for n, b in seen.items() if n in self._survey}
        used = {
            n: b for n, b in known.items() if self._filters[n].probability(day) > MIN_PROBABILITY
        }
        while (pose := self._resection.look(used)) is not None:
            off = self._off(pose, known)
            worst = max(used, key=lambda name: off[name])
            if off[worst] < AGREES * self._sigma:
                break
            del used[worst]
        if pose is not None:
            for name, error in off.items():
                self._filters[name].update(day, error < AGREES * self._sigma)
        return pose

    def _off(self, pose: np.ndarray, seen: dict[str, float]) -> dict[str, float]:
        """Return the differences of bearings from those of the survey [rad]."""
        off = {}
        for name, found in seen.items():
            x, y = self._survey[name]
            expected = math.atan2(y - pose[1], x - pose[0]) - pose[2]
            off[name] = abs(math.remainder(found - expected, math.tau))
        return off
