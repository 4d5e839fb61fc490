"""Monitor: whether the robot is where the map says, and where else it may be looked for.

It owns all detectors. They are asked in the order in which their evidence comes: the odometry,
before anything is predicted with it; the innovations; the landmarks that seem to have moved.
"""

from __future__ import annotations

import math
from enum import Enum, auto

from homeward.localizer.geometry import compose
from homeward.localizer.map.gating import Gated
from homeward.localizer.map.map import Map
from homeward.localizer.motion.preintegration import Motion
from homeward.localizer.recovery.detectors import (
    KidnapDetector,
    SceneChangeDetector,
    SlipDetector,
    odometry_lost,
)
from homeward.localizer.recovery.search import Search
from homeward.localizer.tunables import LINEAR_RANGE, MAJORITY, MAX_MOTION_SIGMA, RECENT_SIGHTINGS
from homeward.reasons import Reason


class Health(Enum):
    """Whether the robot is where the map says, and how it shows that it is not."""

    OK = auto()
    """It is."""
    NO_MAP = auto()
    """Nothing is mapped, and the way from the origin is not known any more."""
    SLIPPED = auto()
    """It may be elsewhere nearby: too many innovations are large."""
    ODOMETRY_LOST = auto()
    """It is lost from now on: odometry was gone for too long ..."""
    KIDNAPPED = auto()
    """... or hardly any bearing fits the map ..."""
    SCENE_CHANGED = auto()
    """... or all that is in sight was replaced at once ..."""
    CARRIED = auto()
    """... or its landmarks moved together, which means that it was moved."""
    LOST = auto()
    """It was lost before, and is not found yet."""


class Monitor:
    """Monitor of one map: whether the robot is where it says.

    Parameters
    ----------
    origin_given : bool
        Whether something besides the way from there holds the map's origin.
    """

    def __init__(self, origin_given: bool) -> None:
        self._origin_given = origin_given
        self._kidnap, self._slip, self._scene = (
            KidnapDetector(),
            SlipDetector(),
            SceneChangeDetector(),
        )
        self._since: float | None = None
        """Since when the robot is lost [s] ..."""
        self._why = Health.LOST
        """... how that showed ..."""
        self._search = Search()
        """... and the search for it."""
        self._found: list[tuple[float, float]] = []
        """From when until when it was lost before [s]."""

    def assess_odometry(self, motion: Motion, known: Map) -> Health:
        """Return whether bearings can be predicted from where the map has the robot.

        Parameters
        ----------
        motion : Motion
            Since the newest keyframe, or since the robot was lost.
        known : Map
            The map.
        """
        marginal = known.state
        gone = not self.is_lost and odometry_lost(motion, marginal)
        # All that is mapped from an unknown origin would be as vague as that, and nothing linear.
        no_origin = not self._origin_given and marginal.covariance[2, 2] > MAX_MOTION_SIGMA**2
        if not known.landmarks.mapped and (gone or no_origin):
            return Health.NO_MAP
        if self.is_lost and motion.covariance[2, 2] <= LINEAR_RANGE**2:
            return Health.LOST
        return Health.ODOMETRY_LOST if gone or self.is_lost else Health.OK

    def assess_innovations(self, gated: Gated, known: Map) -> Health:
        """Return whether what is seen is what the map says.

        Parameters
        ----------
        gated : Gated
            The newest frame.
        known : Map
            The map.
        """
        innovations, motion = gated.innovations, gated.motion
        if self._kidnap.was_kidnapped(innovations):
            return Health.KIDNAPPED
        state = known.state
        place = compose(state.mean[:3], motion.delta)
        if self._scene.has_changed(gated.frame.names, innovations, place, state.positions):
            return Health.SCENE_CHANGED
        return Health.SLIPPED if self._slip.suspects(innovations, motion) else Health.OK

    def at_fault(self, refused: list[str]) -> list[str]:
        """Return which of these landmarks are not where the map says, the robot being there."""
        return refused if refused and self._kidnap.others_fit(refused) else []

    def begin_search(self, t: float, why: Health) -> None:
        """Let the robot be lost from `t` [s] on, or be looked for anew if it is lost already."""
        if self._since is None:
            self._since, self._why = t, why
        self._search = Search()
        self._kidnap.clear()
        self._slip.clear()

    def end_search(self, t: float) -> None:
        """Let the robot be where the map says from `t` [s] on."""
        if self._since is not None:
            self._found.append((self._since, t))
        self._since = None
        self._kidnap.clear()
        self._slip.clear()

    def add_keyframe(self, motion: Motion) -> None:
        """Let there be another keyframe, reached by a motion."""
        if self._slip.search is not None:
            self._slip.search.add_keyframe(motion)

    @property
    def search(self) -> Search:
        """Where the robot is looked for, be it lost or suspected to have slipped."""
        return self._slip.search or self._search

    @property
    def is_lost(self) -> bool:
        """Whether the robot does not know where in its map it is."""
        return self._since is not None

    @property
    def reason(self) -> Reason:
        """Why a lost robot has no pose."""
        return Reason.SCENE_CHANGED if self._why is Health.SCENE_CHANGED else Reason.LOST

    @property
    def spells_lost(self) -> list[tuple[float, float]]:
        """From when until when the robot was lost [s]; it may be still."""
        return self._found if self._since is None else [*self._found, (self._since, math.inf)]

    @property
    def fits_badly(self) -> bool:
        """Whether too little fits of what was seen lately, or the robot is lost."""
        return self.is_lost or self._kidnap.fitting < MAJORITY

    @property
    def fits_well(self) -> bool:
        """Whether all but one fit of what was seen lately."""
        return not self.is_lost and self._kidnap.fitting >= 1.0 - 1.0 / RECENT_SIGHTINGS
