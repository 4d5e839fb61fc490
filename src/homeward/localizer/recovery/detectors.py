"""Kidnapping and slip detection, and the bearings from which the robot is found in its map again.

A robot may be lifted, pushed or slip, and its odometry may drop out. Then its map still stands, but
the robot is not where the map has it.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from homeward.estimator import Innovation
from homeward.localizer.map.landmarks import Landmarks
from homeward.localizer.map.sightings import BEARING, LANDMARK, NC, OFFSET, OFFSET_JACOBIAN, SIGMA
from homeward.localizer.map.state import Marginal
from homeward.localizer.motion.preintegration import Motion
from homeward.localizer.reasons import Reason
from homeward.localizer.recovery.relocalise import SightLines, relocalise

RECENT, KIDNAPPED_SHARE = 10, 0.75
"""When so large a share of the last sightings does not fit, the robot was lifted and put down."""
FITTING_SHARE = 0.6
"""With such a share of sightings that fit, those which do not are their landmarks' fault."""
LOST_RAD, LOST_SHARE = 0.7, 1.0
"""A motion less certain than this, against the landmarks' distance [1], tells nothing."""
NOTHING_M = 0.01
"""So little is nothing among any landmarks [m]."""
BAD_FIT_SHARE, GOOD_FIT_SHARE = 0.6, 0.9
"""With a smaller share that fit the map is doubted, until such a share does."""
FITS, SUSPECT_SHARE = 3.0, 0.5
"""When such a share of a stamp's sightings is off by more [standard deviations], the robot may have
been shoved ..."""
GAIN = 5
"""... and was, if from elsewhere so many more fit: three always can, by chance."""
RELOCALISABLE_RAD = 0.3
"""Sight lines of a lost robot hold together while their headings are better known than this."""


class RelocalisationBuffer:
    """Relocalisation buffer: the last bearings, tied by odometry to where the search began.

    Parameters
    ----------
    begin : Motion
        From the newest keyframe to where the search begins; none where that is unknown.
    """

    def __init__(self, begin: Motion | None = None) -> None:
        self._to_newest = Motion.identity() if begin is None else begin.inverse()
        self._seen: deque[tuple[str, np.ndarray]] = deque(maxlen=RECENT)

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
        self, landmarks: Landmarks, marginal: Marginal, calibration: np.ndarray, fewest: int = 0
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return where the search began, in the map, and the covariance of that.

        So many sightings must agree on it at the fewest.
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
        return relocalise(lines, fewest)


class KidnapDetector:
    """Kidnapped-robot detector: the share of recent bearings that the map rejects."""

    def __init__(self) -> None:
        self.since: float | None = None
        """Since when the robot does not know where in its map it is [s] ..."""
        self.why = Reason.LOST
        """... and how that shows."""
        self.spells: list[tuple[float, float]] = []
        """From when until when it was lost before [s]."""
        self.search = RelocalisationBuffer()
        self._recent: deque[tuple[str, bool]] = deque(maxlen=RECENT)

    def begin(self, t: float, why: Reason = Reason.LOST) -> None:
        """Be lost from `t` [s] on, or look for the robot anew if it is."""
        if self.since is None:
            self.since, self.why = t, why
        self.search = RelocalisationBuffer()
        self._recent.clear()

    def end(self, t: float) -> None:
        """Be lost no longer, from `t` [s] on."""
        if self.since is not None:
            self.spells.append((self.since, t))
        self.since = None
        self._recent.clear()

    def was_kidnapped(self, innovations: list[Innovation]) -> bool:
        """Return whether hardly anything fits the map any more, these innovations included."""
        self._recent.extend((i.landmark, i.accepted) for i in innovations)
        wrong = [name for name, accepted in self._recent if not accepted]
        return (
            len(self._recent) == RECENT
            and len(wrong) >= KIDNAPPED_SHARE * RECENT
            and len(set(wrong)) >= 2
        )

    @property
    def fitting(self) -> float:
        """Share of the last sightings that fit [1]; NaN while the robot was not long found."""
        full = len(self._recent) == RECENT
        return sum(fits for _, fits in self._recent) / RECENT if full else math.nan

    def others_fit(self, names: list[str]) -> bool:
        """Return whether the last sightings of all landmarks but these fitted."""
        others = [fits for name, fits in self._recent if name not in names]
        return bool(others) and sum(others) >= FITTING_SHARE * len(others)


class SlipDetector:
    """Slip detector: too many large innovations, and a pose from which far more bearings fit.

    The gate bears with odometry that is worse than its noise says; so a robot that was carried a
    little way may go on unawares, and bend its map. Where too much is off, another place is looked
    for from which nearly all would fit.
    """

    def __init__(self) -> None:
        self._search: RelocalisationBuffer | None = None
        self._fits: deque[bool] = deque(maxlen=RECENT)

    def clear(self) -> None:
        """Drop the suspicion, if any."""
        self._search = None
        self._fits.clear()

    def add_keyframe(self, motion: Motion) -> None:
        """Let there be another keyframe, reached by a motion."""
        if self._search is not None:
            self._search.add_keyframe(motion)

    def suspicion(
        self, innovations: list[Innovation], motion: Motion
    ) -> tuple[RelocalisationBuffer, int] | None:
        """Return a search for the robot, and how many sightings must agree for it to be moved.

        Parameters
        ----------
        innovations : list of Innovation
            What it saw ...
        motion : Motion
            ... so much after the newest keyframe.

        Returns
        -------
        tuple of Search and int
            None where it is where it was thought to be, for all that is seen.
        """
        fits = [abs(i.value) <= FITS * i.sigma for i in innovations]
        if self._search is None:
            if not fits or sum(fits) > SUSPECT_SHARE * len(fits):
                return None
            self._search = RelocalisationBuffer(motion)
        self._fits.extend(fits)
        held = self._search.motion_since(motion).covariance[2, 2] < RELOCALISABLE_RAD**2
        if not held or sum(self._fits) >= FITTING_SHARE * len(self._fits):
            self.clear()
            return None
        return self._search, sum(self._fits) + GAIN


def odometry_lost(motion: Motion, marginal: Marginal) -> bool:
    """Return whether the odometry is lost: its covariance is too large to predict bearings with.

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
    distances = marginal.distances
    return bool(distances.size and shift > (LOST_SHARE * np.median(distances)) ** 2)


def pose_reset(last: np.ndarray, pose: np.ndarray, covariance: np.ndarray) -> Motion:
    """Pose reset: return the motion from a keyframe to where the robot was found, in the map both.

    The landmarks' errors are in that pose too, so its covariance is doubled.
    """
    nothing = np.zeros((3, NC))
    back = Motion(last, np.zeros((3, 3)), nothing).inverse()
    return back.compose(Motion(pose, 2.0 * covariance, nothing))
