"""Relocalisation search: the last bearings, tied together by odometry, and the pose they tell."""

from __future__ import annotations

from collections import deque

import numpy as np

from homeward.localizer.map.landmarks import Landmarks
from homeward.localizer.map.sightings import BEARING, LANDMARK, NC, OFFSET, OFFSET_JACOBIAN, SIGMA
from homeward.localizer.map.state import Marginal
from homeward.localizer.motion.preintegration import Motion
from homeward.localizer.recovery.relocalise import SightLines, relocalise

NEWEST = 10
"""Sightings that are kept: odometry ties them together for a short way only."""


class Search:
    """Relocalisation search: where in the map the robot is, by what it saw since the search began.

    Parameters
    ----------
    begin : Motion
        From the newest keyframe to where the search begins; none where that is unknown.
    """

    def __init__(self, begin: Motion | None = None) -> None:
        self.fewest = 0
        """So many sightings must agree on a pose at the fewest."""
        self._to_newest = Motion.identity() if begin is None else begin.inverse()
        self._seen: deque[tuple[str, np.ndarray]] = deque(maxlen=NEWEST)

    def motion_since(self, motion: Motion) -> Motion:
        """Return the motion since the search began, from that since the newest keyframe."""
        return self._to_newest.compose(motion)

    def add_keyframe(self, motion: Motion) -> None:
        """Let there be another keyframe, reached by a motion."""
        self._to_newest = self.motion_since(motion)

    def add_sightings(self, names: list[str], rows: np.ndarray) -> None:
        """Keep sightings of mapped landmarks, rows of the table from where the search began."""
        pairs = zip(names, rows, strict=True)
        self._seen.extend((n, row) for n, row in pairs if row[LANDMARK] >= 0)

    def find(
        self, landmarks: Landmarks, marginal: Marginal, calibration: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return where the search began, in the map, (3,), and the covariance of that, (3, 3).

        None instead of both when the sightings do not tell.
        """
        known = [(n, r) for n, r in self._seen if n in landmarks.mapped]
        if not known:
            return None
        rows = np.array([r for _, r in known])
        numbers = landmarks.number([n for n, _ in known])
        positions, covariances = marginal.places(numbers)
        by_calibration = rows[:, OFFSET_JACOBIAN].reshape(-1, 3, NC)
        lines = SightLines(
            cameras=rows[:, OFFSET] + by_calibration @ calibration,
            bearings=rows[:, BEARING],
            sigmas=rows[:, SIGMA],
            names=numbers,
            positions=positions,
            covariances=covariances,
        )
        return relocalise(lines, self.fewest)


def pose_reset(last: np.ndarray, pose: np.ndarray, covariance: np.ndarray) -> Motion:
    """Pose reset: return the motion from a keyframe to where the robot was found, in the map both.

    The landmarks' errors are in that pose too, so its covariance is doubled.
    """
    nothing = np.zeros((3, NC))
    back = Motion(last, np.zeros((3, 3)), nothing).inverse()
    return back.compose(Motion(pose, 2.0 * covariance, nothing))
