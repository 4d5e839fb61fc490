"""Detectors of a kidnapping, of a slip, of a scene that changed and of lost odometry.

A robot may be lifted, pushed or slip, and its odometry may drop out. Then its map still stands, but
the robot is not where the map has it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection

import numpy as np

from homeward.angles import wrap
from homeward.estimator import CHECKED, Innovation
from homeward.localizer.map.state import Marginal
from homeward.localizer.motion.preintegration import Motion
from homeward.localizer.recovery.search import Search
from homeward.localizer.tunables import (
    INLIER_GATE,
    LINEAR_RANGE,
    MAJORITY,
    MAX_MOTION_SIGMA,
    MIN_BEARINGS,
    RECENT_SIGHTINGS,
    VERIFYING_BEARINGS,
)


class KidnapDetector:
    """Kidnapped-robot detector: the share of recent bearings that the map rejects."""

    def __init__(self) -> None:
        self._recent: deque[tuple[str, bool]] = deque(maxlen=RECENT_SIGHTINGS)

    def clear(self) -> None:
        """Forget what was seen."""
        self._recent.clear()

    def was_kidnapped(self, innovations: list[Innovation]) -> bool:
        """Return whether hardly anything fits the map any more, these innovations included."""
        self._recent.extend((i.landmark, i.accepted) for i in innovations)
        wrong = [name for name, accepted in self._recent if not accepted]
        # As few fit from anywhere, by chance.
        few = RECENT_SIGHTINGS - len(wrong) < MIN_BEARINGS
        return len(self._recent) == RECENT_SIGHTINGS and few and len(set(wrong)) >= 2

    @property
    def fitting(self) -> float:
        """Share of the last sightings that fit [1]; NaN while too little was seen."""
        full = len(self._recent) == RECENT_SIGHTINGS
        return sum(fits for _, fits in self._recent) / RECENT_SIGHTINGS if full else math.nan

    def others_fit(self, names: list[str]) -> bool:
        """Return whether the last sightings of all landmarks but these fitted."""
        others = [fits for name, fits in self._recent if name not in names]
        return bool(others) and sum(others) >= MAJORITY * len(others)


class SlipDetector:
    """Slip detector: too many large innovations, and a pose from which far more bearings fit.

    The gate bears with odometry that is worse than its noise says; so a robot that was carried a
    little way may go on unawares, and bend its map. Where too much is off, another place is looked
    for from which nearly all would fit.
    """

    def __init__(self) -> None:
        self.search: Search | None = None
        """For that place; None where the robot is where it was thought to be."""
        self._fits: deque[bool] = deque(maxlen=RECENT_SIGHTINGS)

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
        fits = [abs(i.value) <= INLIER_GATE * i.sigma for i in innovations]
        if self.search is None:
            if not fits or 2 * sum(fits) > len(fits):
                return False
            self.search = Search(motion)
        self._fits.extend(fits)
        holds = self.search.motion_since(motion).covariance[2, 2] < LINEAR_RANGE**2
        if not holds or sum(self._fits) >= MAJORITY * len(self._fits):
            self.clear()
            return False
        self.search.fewest = sum(self._fits) + VERIFYING_BEARINGS
        return True


class SceneChangeDetector:
    """Scene-change detector: all that is in sight was replaced at once.

    Bearings that do not fit the map tell that the robot was lifted. Where most are of landmarks
    that are not mapped yet, little contradicts the map, and odometry knows nothing of the way. But
    a robot that hardly moved does not lose everything out of sight and see as much else instead.
    """

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
        near = np.hypot(*off[:2]) < LINEAR_RANGE * np.median(distances)
        return bool(near and abs(wrap(off[2])) < LINEAR_RANGE)


def odometry_lost(motion: Motion, marginal: Marginal) -> bool:
    """Return whether the odometry is lost: its covariance is too large to predict bearings with.

    Parameters
    ----------
    motion : Motion
        Since the newest keyframe.
    marginal : Marginal
        What is known of that keyframe's pose and of the landmarks.
    """
    shift = max(motion.covariance[0, 0], motion.covariance[1, 1])
    return bool(max(shift / marginal.scale**2, motion.covariance[2, 2]) > MAX_MOTION_SIGMA**2)
