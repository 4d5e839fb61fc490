"""Detectors of kidnapping, slip, scene change and lost odometry.

A robot may be lifted, pushed or slip, and its odometry may drop out. Then the map is still right,
but the robot is not where the map has it.
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
    INLIER,
    LINEAR,
    MAJORITY,
    MINIMAL,
    RECENT,
    VAGUE,
)


class KidnapDetector:
    """Kidnapped-robot detector: the share of recent bearings that the map rejects."""

    def __init__(self) -> None:
        self._recent: deque[tuple[str, bool]] = deque(maxlen=RECENT)

    def clear(self) -> None:
        """Forget all sightings."""
        self._recent.clear()

    def was_kidnapped(self, innovations: list[Innovation]) -> bool:
        """Return whether hardly any recent bearing fits the map, these innovations included."""
        self._recent.extend((i.landmark, i.accepted) for i in innovations)
        wrong = [name for name, accepted in self._recent if not accepted]
        # By chance, as many fit from anywhere.
        few = RECENT - len(wrong) < MINIMAL
        return len(self._recent) == RECENT and few and len(set(wrong)) >= 2

    @property
    def fit_share(self) -> float:
        """Share of the recent sightings that fit [1]; NaN while there are too few."""
        full = len(self._recent) == RECENT
        return sum(fits for _, fits in self._recent) / RECENT if full else math.nan

    def others_fit(self, names: list[str]) -> bool:
        """Return whether recent sightings of all landmarks but these fitted."""
        others = [fits for name, fits in self._recent if name not in names]
        return bool(others) and sum(others) >= MAJORITY * len(others)


class SlipDetector:
    """Slip detector: many large innovations, and a pose from which far more bearings would fit.

    The gate allows for odometry that is worse than its noise, so a small displacement may go
    unnoticed and distort the map. If too many innovations are large, a pose is sought from which
    nearly all bearings fit.
    """

    def __init__(self) -> None:
        self.search: Search | None = None
        """Search for that pose; None where there is no suspicion."""
        self._fits: deque[bool] = deque(maxlen=RECENT)

    def clear(self) -> None:
        """Drop the suspicion, if any."""
        self.search = None
        self._fits.clear()

    def suspects(self, innovations: list[Innovation], motion: Motion) -> bool:
        """Return whether the robot may have been displaced.

        Parameters
        ----------
        innovations : list of Innovation
            Innovations of a frame ...
        motion : Motion
            ... and the motion to it from the newest keyframe.
        """
        fits = [abs(i.value) <= INLIER * i.sigma for i in innovations]
        if self.search is None:
            if not fits or 2 * sum(fits) > len(fits):
                return False
            self.search = Search(motion)
        self._fits.extend(fits)
        holds = self.search.motion_since(motion).covariance[2, 2] < LINEAR**2
        if not holds or sum(self._fits) >= MAJORITY * len(self._fits):
            self.clear()
            return False
        return True


class SceneChangeDetector:
    """Scene-change detector: everything in sight was replaced at once.

    A kidnapped robot shows in bearings that do not fit the map. If most are of landmarks not mapped
    yet, little contradicts the map, and odometry did not notice. But a robot that hardly moved does
    not lose everything out of sight and see as much else instead.
    """

    def __init__(self) -> None:
        self._seen: frozenset[str] = frozenset()
        """Landmarks in sight when enough of them last fitted the map ..."""
        self._from = np.zeros(3)
        """... and the robot's pose then, (3,), in the odometry frame."""

    def has_changed(
        self,
        names: Collection[str],
        innovations: Collection[Innovation],
        place: np.ndarray,
        landmarks: np.ndarray,
    ) -> bool:
        """Return whether all landmarks in sight have been replaced by others.

        Parameters
        ----------
        names : collection of str
            All landmarks in sight.
        innovations : collection of Innovation
            Those of mapped landmarks.
        place : ndarray, shape (3,)
            The robot's pose by odometry, in the odometry frame.
        landmarks : ndarray, shape (n, 2)
            Positions of the map's landmarks there [m].
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
        near = np.hypot(*off[:2]) < LINEAR * np.median(distances)
        return bool(near and abs(wrap(off[2])) < LINEAR)


def odometry_lost(motion: Motion, marginal: Marginal) -> bool:
    """Return whether odometry is lost: its covariance is too large to predict bearings with.

    Parameters
    ----------
    motion : Motion
        Since the newest keyframe.
    marginal : Marginal
        The state at that keyframe.
    """
    shift = max(motion.covariance[0, 0], motion.covariance[1, 1])
    return bool(max(shift / marginal.scale**2, motion.covariance[2, 2]) > VAGUE**2)
