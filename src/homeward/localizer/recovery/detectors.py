"""Detectors of a kidnapping, of a slip and of lost odometry.

A robot may be lifted, pushed or slip, and its odometry may drop out. Then its map still stands, but
the robot is not where the map has it.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from homeward.estimator import Innovation
from homeward.localizer.map.state import Marginal
from homeward.localizer.motion.preintegration import Motion
from homeward.localizer.recovery.search import Search

RECENT, KIDNAPPED_SHARE = 10, 0.75
"""When so large a share of the last sightings does not fit, the robot was lifted and put down."""
FITTING_SHARE = 0.6
"""With such a share of sightings that fit, those which do not are their landmarks' fault."""
LOST_RAD, LOST_SHARE = 0.7, 1.0
"""A motion less certain than this, against the landmarks' distance [1], tells nothing."""
NOTHING_M = 0.01
"""So little is nothing among any landmarks [m]."""
FITS, SUSPECT_SHARE = 3.0, 0.5
"""When such a share of a stamp's sightings is off by more [standard deviations], the robot may have
been shoved ..."""
GAIN = 5
"""... and was, if from elsewhere so many more fit: three always can, by chance."""
RELOCALISABLE_RAD = 0.3
"""Sight lines of a lost robot hold together while their headings are better known than this."""


class KidnapDetector:
    """Kidnapped-robot detector: the share of recent bearings that the map rejects."""

    def __init__(self) -> None:
        self._recent: deque[tuple[str, bool]] = deque(maxlen=RECENT)

    def clear(self) -> None:
        """Forget what was seen."""
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
        """Share of the last sightings that fit [1]; NaN while too little was seen."""
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
        self.search: Search | None = None
        """For that place; None where the robot is where it was thought to be."""
        self._fits: deque[bool] = deque(maxlen=RECENT)

    def clear(self) -> None:
        """Drop the suspicion, if any."""
        self.search = None
        self._fits.clear()

    def suspects(self, innovations: list[Innovation], motion: Motion) -> bool:
        """Return whether the robot may have been shoved.

        Parameters
        ----------
        innovations : list of Innovation
            What it saw ...
        motion : Motion
            ... so much after the newest keyframe.
        """
        fits = [abs(i.value) <= FITS * i.sigma for i in innovations]
        if self.search is None:
            if not fits or sum(fits) > SUSPECT_SHARE * len(fits):
                return False
            self.search = Search(motion)
        self._fits.extend(fits)
        holds = self.search.motion_since(motion).covariance[2, 2] < RELOCALISABLE_RAD**2
        if not holds or sum(self._fits) >= FITTING_SHARE * len(self._fits):
            self.clear()
            return False
        self.search.fewest = sum(self._fits) + GAIN
        return True


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
