"""Relocalisation search: the last bearings, tied together by odometry, and the pose they tell."""

from __future__ import annotations

from collections import deque

import numpy as np

from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.landmarks import Landmarks
from homeward.localizer.motion.preintegration import NC, Motion
from homeward.localizer.recovery.relocalise import SightLines, relocalise
from homeward.localizer.tunables import RECENT_SIGHTINGS


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
        self._seen: deque[tuple[str, float, float, Motion]] = deque(maxlen=RECENT_SIGHTINGS)

    def motion_since(self, motion: Motion) -> Motion:
        """Return the motion since the search began, from that since the newest keyframe."""
        return self._to_newest.compose(motion)

    def add_keyframe(self, motion: Motion) -> None:
        """Let there be another keyframe, reached by a motion."""
        self._to_newest = self.motion_since(motion)

    def add_bearings(self, frame: WeighedFrame, camera: Motion, landmarks: Landmarks) -> None:
        """Keep bearings of mapped landmarks, the camera being a motion away from where it began."""
        each = zip(frame.names, frame.bearings.tolist(), frame.sigmas.tolist(), strict=True)
        self._seen.extend((*seen, camera) for seen in each if seen[0] in landmarks.mapped)

    def find(
        self, landmarks: Landmarks, calibration: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return where the search began, in the map, (3,), and the covariance of that, (3, 3).

        None instead of both when the sightings do not tell.
        """
        known = [seen for seen in self._seen if seen[0] in landmarks.mapped]
        if not known:
            return None
        names, bearings, sigmas, cameras = zip(*known, strict=True)
        mapped = [landmarks.mapped[n] for n in names]
        positions, covariances = landmarks.places(mapped)
        lines = SightLines(
            cameras=np.array([c.uncalibrated + c.jacobian @ calibration for c in cameras]),
            bearings=np.array(bearings),
            sigmas=np.array(sigmas),
            names=np.array([m.number for m in mapped]),
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
