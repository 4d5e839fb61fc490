"""Monitor of one map: whether the robot is where the map has it, by all detectors.

They run in the order in which their evidence becomes available: odometry, before it predicts
anything; the innovations; landmarks that seem to have moved.
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
from homeward.localizer.recovery.search import Driven, Search
from homeward.localizer.tunables import LINEAR, MAJORITY, RECENT, VAGUE
from homeward.reasons import Reason


class Health(Enum):
    """Whether the robot is where the map has it, and if not, how that was detected."""

    OK = auto()
    """It is."""
    NO_MAP = auto()
    """Nothing is mapped, and the motion since the origin is unknown."""
    SLIPPED = auto()
    """It may have slipped to nearby: too many innovations are large."""
    ODOMETRY_LOST = auto()
    """Lost from now on: odometry dropped out for too long ..."""
    KIDNAPPED = auto()
    """... or hardly any bearing fits the map ..."""
    SCENE_CHANGED = auto()
    """... or all that is in sight was replaced at once ..."""
    CARRIED = auto()
    """... or landmarks moved together, which means that the robot was carried."""
    LOST = auto()
    """Lost before, and not relocalised yet."""


class Monitor:
    """Monitor of one map: whether the robot is where it says.

    Parameters
    ----------
    origin_given : bool
        Whether a start prior determines the map's origin, not only odometry.
    """

    def __init__(self, origin_given: bool) -> None:
        self._origin_given = origin_given
        self._kidnap, self._slip, self._scene = (
            KidnapDetector(),
            SlipDetector(),
            SceneChangeDetector(),
        )
        self._since: float | None = None
        """Since when the robot has been lost [s] ..."""
        self._cause = Health.LOST
        """... how that was detected ..."""
        self._search = Search()
        """... and the relocalisation search."""
        self._driven = Driven(0.0, 0.0)
        """Motion of the wheels from the newest keyframe to the start of the search."""
        self._past: list[tuple[float, float]] = []
        """Earlier intervals in which it was lost [s]."""

    def assess_odometry(self, motion: Motion, known: Map) -> Health:
        """Assess odometry: whether bearings can be predicted from where the map has the robot.

        Parameters
        ----------
        motion : Motion
            Since the newest keyframe, or since the robot was lost.
        known : Map
            The map.
        """
        marginal = known.state
        dropped_out = not self.is_lost and odometry_lost(motion, marginal)
        # All that is mapped from an uncertain origin would be as uncertain, and nothing linear.
        no_origin = not self._origin_given and marginal.covariance[2, 2] > VAGUE**2
        if not known.landmarks.mapped and (dropped_out or no_origin):
            return Health.NO_MAP
        if self.is_lost and motion.covariance[2, 2] <= LINEAR**2:
            return Health.LOST
        return Health.ODOMETRY_LOST if dropped_out or self.is_lost else Health.OK

    def assess_innovations(self, gated: Gated, known: Map) -> Health:
        """Assess the innovations: whether the bearings fit the map.

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

    def moved_landmarks(self, rejected: list[str]) -> list[str]:
        """Return which of these landmarks moved, the robot being where the map has it."""
        return rejected if rejected and self._kidnap.others_fit(rejected) else []

    def begin_search(self, t: float, why: Health, motion: Motion) -> None:
        """Declare the robot lost from `t` [s] on, or restart the search if it is lost already.

        `motion` is that since the newest keyframe, or since the last search began.
        """
        if self._since is None:
            self._since, self._cause, self._driven = t, why, Driven(0.0, 0.0)
        self._search, self._driven = Search(), self.driven(motion)
        self._kidnap.clear()
        self._slip.clear()

    def end_search(self, t: float) -> None:
        """Declare the robot relocalised at `t` [s]."""
        if self._since is not None:
            self._past.append((self._since, t))
        self._since = None
        self._kidnap.clear()
        self._slip.clear()

    def driven(self, motion: Motion) -> Driven:
        """Return the wheels' motion since the newest keyframe, by that since the search began."""
        return Driven(self._driven.path + motion.path, self._driven.turned + motion.turned)

    def add_keyframe(self, motion: Motion) -> None:
        """Register a new keyframe, reached by a motion."""
        if self._slip.search is not None:
            self._slip.search.add_keyframe(motion)

    @property
    def search(self) -> Search:
        """The relocalisation search, whether the robot is lost or is suspected to have slipped."""
        return self._slip.search or self._search

    @property
    def is_lost(self) -> bool:
        """Whether the robot is lost in its map."""
        return self._since is not None

    @property
    def reason(self) -> Reason:
        """The reason why a lost robot has no pose."""
        return Reason.SCENE_CHANGED if self._cause is Health.SCENE_CHANGED else Reason.LOST

    @property
    def spells_lost(self) -> list[tuple[float, float]]:
        """Intervals in which the robot was lost [s]; the last may be open."""
        return self._past if self._since is None else [*self._past, (self._since, math.inf)]

    @property
    def fits_badly(self) -> bool:
        """Whether too few recent sightings fit, or the robot is lost."""
        return self.is_lost or self._kidnap.fit_share < MAJORITY

    @property
    def fits_well(self) -> bool:
        """Whether all recent sightings but one fit."""
        return not self.is_lost and self._kidnap.fit_share >= 1.0 - 1.0 / RECENT
