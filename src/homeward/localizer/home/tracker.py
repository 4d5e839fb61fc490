"""Tracking of home in a changing map: found once, updated, and searched elsewhere at times."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.drives.settings import DriveSettings
from homeward.geometry.se2 import compose
from homeward.localizer.home.hypotheses import (
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
from homeward.localizer.home.turn_note import turn_notes
from homeward.localizer.inputs.bearing_noise import BearingNoise
from homeward.localizer.map.landmarks import numbers
from homeward.localizer.map.map import Map
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.survey.factors import HomeFactors
from homeward.localizer.map.survey.survey import exchange_notes
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import (
    GIVEN_WRONG,
    INLIER,
    LINEAR,
    MAX_SEEDS,
    MAX_SEEDS_IN_DOUBT,
    MIN_TOGETHER,
    MINIMAL,
    PROBABLE,
    SEARCH_EVERY,
    SEARCH_PATIENCE,
    SIGN_FALSE_ALARM,
    VERIFIED,
)

MIRROR_NOTE = (
    "Of {} home bearings, {} fit the map with the opposite sign, {} as given: they are clockwise,"
    " unlike those of the drive. No pose is given until this is corrected. Multiply the home"
    " bearings by -1."
)
START_NOTE = (
    "The start prior contradicts the home bearings and is not used. Correct or remove `start:` in"
    " drive.yaml."
)


class HomeTracker:
    """Tracks the hypotheses on home; `noise` is also that of home bearings."""

    def __init__(
        self,
        home: Mapping[str, HomeBearing],
        drive: DriveSettings,
        settings: LocalizerSettings,
        noise: BearingNoise,
    ) -> None:
        self.observation = HomeObservation(home, drive, settings)
        self.hypotheses: Hypotheses | None = None
        """The hypotheses; None while home is not found."""
        self.names: list[str] = []
        """Names of the q landmarks used."""
        self._noise, self._surveyed, self._sure = noise, False, settings.sure
        self._seeds: deque[Seed] = deque()
        self._places = np.zeros(0, int), np.zeros(0), np.zeros((0, 2, 2))
        """Indices of the landmarks used, and their walks; see `Map.places_for_home` ..."""
        self._p_static: np.ndarray | None = None
        """... at these probabilities to be static, which are replaced at each change."""
        self.is_updated = False
        """Whether `hypotheses` are fitted to the newest state of the map, not only propagated."""
        self._searched = 0
        """Keyframe of the last search from scratch."""
        self._mirrored: tuple[int, int, int] | None = None
        """Number of home bearings, and how many of them fit with the opposite sign and as given;
        None unless they fit much better with that sign."""

    def notes(self, known: Map) -> tuple[str, ...]:
        """Return notes for the user: on the start, the home bearings, and a turn at home."""
        found = self.hypotheses
        if found is None:
            return ()
        start = () if found.best.problem.assumed.start else (START_NOTE,)
        exchanged = exchange_notes(self.exchanged, "in the home bearings")
        mapped = known.landmarks.mapped.items()
        others = numbers(m for n, m in mapped if n not in self.observation.bearings)
        turned = turn_notes(found.best, others, known.smoother.all_landmarks)
        mirrored = () if self._mirrored is None else (MIRROR_NOTE.format(*self._mirrored),)
        return *start, *mirrored, *exchanged, *turned

    @property
    def is_mirrored(self) -> bool:
        """Whether the home bearings have the opposite sign of those of the drive."""
        return self._mirrored is not None

    @property
    def exchanged(self) -> dict[str, str]:
        """Two landmarks, each with the other, whose home bearings are exchanged."""
        return {} if self.hypotheses is None else self.hypotheses.exchanged(self._sure)

    def replace(
        self, home: Mapping[str, HomeBearing], drive: DriveSettings, settings: LocalizerSettings
    ) -> None:
        """Replace the home bearings; hypotheses stay if none that they use has changed."""
        before, now = self.observation, HomeObservation(home, drive, settings)
        self.observation = now.continued(before)
        if any(before.bearings[n] != now.bearings.get(n) for n in self.names):
            self.hypotheses, self.names = None, []
            self._seeds.clear()
        self._p_static = None

    def update(self, known: Map) -> None:
        """Update home after a change of the map, by a new search if necessary."""
        now, before, frame = self.hypotheses, self.names, self._surveyed
        if known.evaluated or known.smoother.p_static is not self._p_static:
            self.names = known.landmarks.shared_with_home(self.observation.bearings)
            known.landmarks.activate_at_home(self.names)
            self._p_static = None
        self._surveyed = known.registration.has_home
        if self._surveyed is not frame:  # the frame of home has changed
            now = None
        problem = self.problem(known, known.smoother)
        self.is_updated = True
        if now is not None and before == self.names:
            self.hypotheses = self._follow(problem, now, known)
        else:
            also = seeds_for(now, before, self.names) if now is not None else []
            self.hypotheses = search(problem, also)
            self._test_sign(self.hypotheses)
            self._seeds.clear()
            if self.hypotheses is not None and self._number_of_seeds(self.hypotheses) > MAX_SEEDS:
                self._seeds.extend(seeds(problem, MAX_SEEDS_IN_DOUBT)[MAX_SEEDS:])
        if known.evaluated and known.smoother.use_home(self._factors(known)) and self.hypotheses:
            problem = self.problem(known, known.smoother)
            self.hypotheses = self._follow(problem, self.hypotheses, known)

    def _factors(self, known: Map) -> HomeFactors | None:
        """Return the inlier home bearings, if they move a part of the map beyond linear bearings.

        From then on they stay in use. None if home is ambiguous or at the origin of a survey, or
        the map is young.
        """
        now = self.hypotheses
        if now is None or not known.is_window_full or known.registration.has_home:
            return None
        if self._is_doubted(now):
            return None
        best, used = now.best, now.best.inliers
        problem, places = best.problem, best.landmarks[used]
        moved = np.hypot(*(places - problem.landmarks[used]).T)
        is_far = moved > LINEAR * np.hypot(*(places - best.home[:2]).T)
        is_used = known.smoother.at_home is not None or is_far.sum() >= MIN_TOGETHER
        if used.sum() < VERIFIED or not is_used:
            return None
        ids = known.smoother.ids[self._places[0][used]]
        offsets = np.zeros((len(used), 3)) if problem.offsets is None else problem.offsets
        camera = compose(best.home, problem.mount)
        columns = problem.bearings[used], problem.sigmas[used]
        return HomeFactors(ids, *columns, camera, offsets[used])

    def problem(self, known: Map, smoother: Smoother, state: Marginal | None = None) -> HomeProblem:
        """Return the resection problem by a solution of the map, or its state at another keyframe.

        It is in the odometry frame, or in home's frame if the map has a survey in that.
        """
        state = smoother.without_home(smoother.state if state is None else state)
        state = known.registration.in_home_frame(state)
        if smoother.p_static is not self._p_static:
            self._places = known.places_for_home(self.names, smoother)
            self._p_static = smoother.p_static
        problem = self.observation.problem(self.names, *self._places, state, self._noise)
        if not known.registration.has_home:
            return problem
        return problem.at_origin(known.registration.static_places(state))

    def finalise(self, known: Map, whole: Smoother) -> bool:
        """Search for home by the solution of a whole drive; return whether it is found.

        If it is not, nothing changes.
        """
        before = self.hypotheses.fits if self.hypotheses is not None else ()
        found = search(self.problem(known, whole), [f.seed for f in before])
        self.hypotheses = found or self.hypotheses
        return found is not None

    def stayed(self, known: Map) -> np.ndarray:
        """(q,), bool: which of the landmarks used did not move during the drive."""
        return np.array([name not in known.landmarks.former for name in self.names], bool)

    def _follow(self, problem: HomeProblem, before: Hypotheses, known: Map) -> Hypotheses | None:
        """Return the hypotheses after a small change of the map.

        They are fitted again after a solution of the map that changes home bearings notably, and
        until the map has filled its window or home is not ambiguous any more.
        """
        now = propagate(problem, before)
        self.is_updated = now is None or (
            known.evaluated
            and (not known.is_window_full or self._is_doubted(now) or now.best.has_changed)
        )
        if self.is_updated:
            now = update(problem, before)
        if now is None:
            return None
        if self.is_updated and now.max_log_evidence < before.max_log_evidence + math.log(PROBABLE):
            # The best set's home diverged: search for it again, or for a better one.
            return search(problem, [f.seed for f in (*now.fits, *now.unconverged)])
        return self._try_next_seed(problem, now, known)

    def _number_of_seeds(self, now: Hypotheses) -> int:
        """Return the number of seeds of a search: more while home is ambiguous."""
        return MAX_SEEDS_IN_DOUBT if self._is_doubted(now) else MAX_SEEDS

    def _is_doubted(self, now: Hypotheses) -> bool:
        """Return whether home may be elsewhere than the best hypothesis has it."""
        return now.rivals(INLIER) > 1.0 - self._sure

    def _try_next_seed(self, problem: HomeProblem, now: Hypotheses, known: Map) -> Hypotheses:
        """Try the next seed of a search, and start a new search from time to time."""
        since = known.smoother.newest - self._searched
        wait = SEARCH_PATIENCE if known.busy or self.is_updated else 0
        if self._seeds and since >= wait:
            return try_seed(problem, now, self._seeds.popleft())
        if not self._seeds and since >= SEARCH_EVERY + wait:
            self._seeds.extend(seeds(problem, self._number_of_seeds(now)))
            self._searched = known.smoother.newest
            self._test_sign(now)
        return now

    def _test_sign(self, found: Hypotheses | None) -> None:
        """Test whether home bearings of the opposite sign fit much better, if most do not fit."""
        self._mirrored = None
        if found is None:
            return
        problem, number = found.best.problem, found.best.inliers.size
        agreeing = int(np.count_nonzero(found.best.inliers))
        if number <= MINIMAL or 2 * agreeing > number:
            return
        other = search(replace(problem, bearings=-problem.bearings))
        needed = math.log(1.0 / GIVEN_WRONG) + math.log(1.0 / SIGN_FALSE_ALARM)
        if other is not None and other.best.log_evidence - found.max_log_evidence >= needed:
            self._mirrored = number, int(np.count_nonzero(other.best.inliers)), agreeing
