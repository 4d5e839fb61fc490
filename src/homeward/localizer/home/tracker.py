"""Home in a map that changes: found once, followed, and looked for elsewhere now and then."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from homeward.drives.drive import DriveSettings, HomeBearing
from homeward.localizer.home.hypotheses import (
    MOST_SEEDS,
    PROBABLE,
    Hypotheses,
    Seed,
    propagate,
    search,
    seeds,
    seeds_for,
    try_seed,
    update,
)
from homeward.localizer.home.observation import HomeObservation
from homeward.localizer.home.problem import HomeProblem
from homeward.localizer.inputs.bearing_noise import BearingNoise
from homeward.localizer.map.map import Map
from homeward.localizer.map.state import Marginal
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import INLIER_GATE

SEARCH_EVERY = 40
"""Keyframes between two searches for home from scratch ..."""
SEARCH_PATIENCE = 10
"""... which waits so many for one without other long work."""
MOST_IN_DOUBT = 4 * MOST_SEEDS
"""Seeds where home may be elsewhere: one a keyframe, this takes as long as a search is old."""


class HomeTracker:
    """Tracks the hypotheses where home is in a map.

    Parameters
    ----------
    home : dict of str to HomeBearing
        What the camera saw at home.
    drive : DriveSettings
        Camera and start prior as far as known.
    settings : LocalizerSettings
        Everything else.
    noise : BearingNoise
        Of bearings, home's among them.
    """

    def __init__(
        self,
        home: Mapping[str, HomeBearing],
        drive: DriveSettings,
        settings: LocalizerSettings,
        noise: BearingNoise,
    ) -> None:
        self.observation = HomeObservation(home, drive, settings)
        self.hypotheses: Hypotheses | None = None
        """Where home may be; None where it is not found."""
        self.names: list[str] = []
        """Of the q landmarks among which it is looked for."""
        self._noise, self._surveyed, self._sure = noise, False, settings.sure
        self._seeds: deque[Seed] = deque()
        self._searched = 0
        """Keyframe at which other places for home were last looked for."""

    def update(self, known: Map) -> None:
        """Follow home as the map changes; search for it anew when there is reason to."""
        now, before, frame = self.hypotheses, self.names, self._surveyed
        self.names = known.landmarks.shared_with_home(self.observation.bearings)
        self._surveyed = known.registration.knows_home
        if self._surveyed is not frame:  # home is in another frame now
            now = None
        problem = self.problem(known, known.state)
        if now is not None and before == self.names:
            self.hypotheses = self._follow(problem, now, known)
        else:
            also = seeds_for(now, before, self.names) if now is not None else []
            self.hypotheses = search(problem, also)
            self._seeds.clear()
            if self.hypotheses is not None and self._most(self.hypotheses) > MOST_SEEDS:
                self._seeds.extend(seeds(problem, MOST_IN_DOUBT)[MOST_SEEDS:])

    def problem(self, known: Map, state: Marginal) -> HomeProblem:
        """Return what is known of home's landmarks by a state of the map.

        It is in the odometry frame; where the map has a survey in home's frame, in that.
        """
        state = known.registration.in_home_frame(state)
        places = known.places_for_home(self.names)
        problem = self.observation.problem(self.names, *places, state, self._noise)
        if not known.registration.knows_home:
            return problem
        return problem.at_origin(known.registration.static_places(state))

    def conclude(self, known: Map, state: Marginal) -> bool:
        """Find home anew by what a whole drive says; return whether it is found.

        Where it is not, everything stays as it was.
        """
        before = self.hypotheses.fits if self.hypotheses is not None else ()
        found = search(self.problem(known, state), [f.seed for f in before])
        self.hypotheses = found or self.hypotheses
        return found is not None

    def stayed(self, known: Map) -> np.ndarray:
        """(q,), bool: which of the landmarks among which home is did not move on the way."""
        return np.array([name not in known.landmarks.former for name in self.names], bool)

    def bearing_sigmas(self) -> dict[str, float]:
        """Return how well each home bearing is predicted by everything else [rad], by landmark."""
        if self.hypotheses is None:
            return {}
        variances = self.hypotheses.best.innovations[1]
        return dict(zip(self.names, np.sqrt(variances).tolist(), strict=True))

    def _follow(self, problem: HomeProblem, before: Hypotheses, known: Map) -> Hypotheses | None:
        """Return the hypotheses after the map changed a little."""
        now = (update if known.solved else propagate)(problem, before)
        if now is None:
            return None
        if now.max_log_evidence < before.max_log_evidence + math.log(PROBABLE):
            # The best set's home went walk_moment: there may be a way back to it, or a better one.
            return search(problem, [f.seed for f in (*now.fits, *now.unconverged)])
        return self._try_next_seed(problem, now, known)

    def _most(self, now: Hypotheses) -> int:
        """Return from how many seeds to look for home: more, where it is in doubt."""
        doubted = now.rivals(INLIER_GATE) > 1.0 - self._sure
        return MOST_IN_DOUBT if doubted else MOST_SEEDS

    def _try_next_seed(self, problem: HomeProblem, now: Hypotheses, known: Map) -> Hypotheses:
        """Look now and then where else home might be, one place after the other."""
        since = known.smoother.newest - self._searched
        wait = SEARCH_PATIENCE if known.busy else 0
        if self._seeds and since >= wait:
            return try_seed(problem, now, self._seeds.popleft())
        if not self._seeds and since >= SEARCH_EVERY + wait:
            self._seeds.extend(seeds(problem, self._most(now)))
            self._searched = known.smoother.newest
        return now
