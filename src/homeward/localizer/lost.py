"""A robot that was lifted, or whose odometry was gone: is it lost, and where is it in its map."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from homeward.estimator import Innovation
from homeward.localizer.landmarks import Landmarks
from homeward.localizer.marginal import Marginal
from homeward.localizer.preintegration import Motion
from homeward.localizer.relocation import SightLines, relocate
from homeward.localizer.sightings import BEARING, LANDMARK, NC, OFFSET, OFFSET_JACOBIAN, SIGMA

RECENT, LIFTED_SHARE = 10, 0.75
"""When so large a share of the last sightings does not fit, the robot was lifted and put down."""
FITTING_SHARE = 0.6
"""With such a share of sightings that fit, those which do not are their landmarks' fault."""
LOST_RAD, LOST_SHARE = 0.7, 1.0
"""A motion less certain than this, against the landmarks' distance [1], tells nothing."""
NOTHING_M = 0.01
"""So little is nothing among any landmarks [m]."""
LOST_AGAIN_RAD = 0.3
"""Sight lines of a lost robot hold together while their headings are better known than this."""


class Lost:
    """What tells that the robot is lost, and where it is found again."""

    def __init__(self) -> None:
        self.since: float | None = None
        """Since when the robot does not know where in its map it is [s]."""
        self._recent: deque[tuple[str, bool]] = deque(maxlen=RECENT)
        self._seen: deque[tuple[str, np.ndarray]] = deque(maxlen=RECENT)

    def begin(self, t: float) -> None:
        """Be lost from `t` [s] on."""
        self.since = t
        self._seen.clear()
        self._recent.clear()

    def end(self) -> None:
        """Be lost no longer."""
        self.since = None
        self._seen.clear()
        self._recent.clear()

    def was_lifted(self, innovations: list[Innovation]) -> bool:
        """Return whether hardly anything fits the map any more, these innovations included."""
        self._recent.extend((i.landmark, i.accepted) for i in innovations)
        wrong = [name for name, accepted in self._recent if not accepted]
        return (
            len(self._recent) == RECENT
            and len(wrong) >= LIFTED_SHARE * RECENT
            and len(set(wrong)) >= 2
        )

    def others_fit(self, names: list[str]) -> bool:
        """Return whether the last sightings of all landmarks but these fitted."""
        others = [fits for name, fits in self._recent if name not in names]
        return bool(others) and sum(others) >= FITTING_SHARE * len(others)

    def see(self, names: list[str], rows: np.ndarray) -> None:
        """Keep sightings of mapped landmarks, rows of the table from where the robot was lost."""
        pairs = zip(names, rows, strict=True)
        self._seen.extend((n, row) for n, row in pairs if row[LANDMARK] >= 0)

    def find(
        self, landmarks: Landmarks, marginal: Marginal, calibration: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return where the robot was lost, in the map, and the covariance of that."""
        known = [(n, r) for n, r in self._seen if n in landmarks.mapped]
        if not known:
            return None
        rows = np.array([r for _, r in known])
        numbers = landmarks.number([n for n, _ in known])
        positions, covariances = marginal.places(numbers)
        by_calibration = rows[:, OFFSET_JACOBIAN].reshape(-1, 3, NC)
        return relocate(
            SightLines(
                cameras=rows[:, OFFSET] + by_calibration @ calibration,
                bearings=rows[:, BEARING],
                sigmas=rows[:, SIGMA],
                names=numbers,
                positions=positions,
                covariances=covariances,
            )
        )


def hopeless(motion: Motion, marginal: Marginal) -> bool:
    """Return whether odometry knows so little of a motion that the robot counts as lost.

    Parameters
    ----------
    motion : Motion
        Since the newest keyframe.
    marginal : Marginal
        What is known of that keyframe's pose and of the landmarks.
    """
    if motion.covariance[2, 2] > LOST_RAD**2:
        return True
    shift = max(motion.covariance[0, 0], motion.covariance[1, 1])
    if shift < NOTHING_M**2:
        return False
    distances = np.hypot(*(marginal.positions - marginal.mean[:2]).T)
    return bool(distances.size and shift > (LOST_SHARE * np.median(distances)) ** 2)


def leap(last: np.ndarray, pose: np.ndarray, covariance: np.ndarray) -> Motion:
    """Return the motion from a keyframe to where a lost robot was found, in the map both.

    The landmarks' errors are in that pose too, so its covariance is doubled.
    """
    x, y, psi = last.tolist()
    c, s = math.cos(psi), math.sin(psi)
    inverse = np.array([-c * x - s * y, s * x - c * y, -psi])  # heading not wrapped
    nothing = np.zeros((3, NC))
    back = Motion(inverse, np.zeros((3, 3)), nothing)
    return back.then(Motion(pose, 2.0 * covariance, nothing))
