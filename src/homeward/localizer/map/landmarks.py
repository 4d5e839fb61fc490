"""Landmark life cycle: candidates (delayed initialisation), mapped landmarks, moved landmarks."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from heapq import nlargest
from statistics import median

import numpy as np
from scipy.special import chdtri

from homeward.geometry.angles import wrap
from homeward.geometry.se2 import sight
from homeward.localizer.inputs.bearing_noise import ById
from homeward.localizer.map.ranges import place_by_ranges
from homeward.localizer.map.sightings import (
    BEARING,
    KEYFRAME,
    LANDMARK,
    LOG_RANGE,
    RANGE_SIGMA,
    SIGMA,
    scale_noise,
)
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.map.triangulation import (
    RangeMixture,
    is_determined,
    range_mixture,
    triangulate,
    unexplained,
)
from homeward.localizer.tunables import (
    BASELINE,
    ESTABLISHED,
    FALSE_ALARM,
    GATE,
    INLIER,
    LINEAR,
    MAJORITY,
    MARGIN,
    MAX_IDS,
    MAX_TESTED,
    MAX_TRIALS,
    MIN_LINES,
    MIN_SIGHTINGS,
    NEGLIGIBLE,
    RETRY_GROWTH,
    SWAP_RATIO,
    WINDOW_S,
)


@dataclass
class Landmark:
    """A mapped landmark."""

    name: str
    number: int
    """Its id in the smoother."""
    sightings: int = 0
    entered: int = 0
    """Keyframe at which it was initialised ..."""
    first: int = 0
    """... of its first sighting ..."""
    last: int = 0
    """... and of the last one that fitted its position."""
    rejections: int = 0
    """Recent rejections less twice the acceptances, not below zero."""
    walk_moment: np.ndarray = field(default_factory=lambda: np.zeros((2, 2)))
    """Second moment of its offset from the mapped position if it walks [m^2]."""
    lines: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Direction of the first sight line [rad], and how far the others lie to either side of it."""

    @property
    def parallax(self) -> float:
        """Angle between the outermost sight lines [rad]."""
        return self.lines[2] - self.lines[1]

    @property
    def established(self) -> bool:
        """Whether it has the sightings and the parallax needed to declare it moved."""
        return self.parallax >= LINEAR and self.sightings >= ESTABLISHED

    def count_sighting(self, direction: float) -> None:
        """Count a sighting, along a direction in the odometry frame [rad]."""
        if not self.sightings:
            self.lines = (direction, 0.0, 0.0)
        first, low, high = self.lines
        off = math.remainder(direction - first, math.tau)
        if not low <= off <= high:
            self.lines = (first, min(low, off), max(high, off))
        self.sightings += 1


@dataclass
class Candidate:
    """Candidate: sightings of a landmark that is not mapped, or that do not fit its position."""

    since: float
    """Time of the first of them [s]."""
    rows: deque[np.ndarray] = field(default_factory=deque)
    next_trial: float = 0.0
    """Number of sightings at which it is tried next."""


class Landmarks:
    """The landmarks of a smoother's map: their initialisation, rejection and removal.

    `parallax` is the smallest angle between two sight lines for triangulation [rad].
    """

    def __init__(self, smoother: Smoother, parallax: float) -> None:
        self.smoother, self._parallax = smoother, parallax
        self.mapped: dict[str, Landmark] = {}
        self.former: dict[str, Landmark] = {}
        """Former positions of landmarks that moved during the drive."""
        self.moved_at: dict[str, float] = {}
        """When they moved [s]."""
        self.range_mixtures: dict[str, RangeMixture] = {}
        """Range mixtures of landmarks that could not be triangulated yet."""
        self.expected: dict[str, np.ndarray] = {}
        """Expected positions of surveyed landmarks that are not mapped yet, (2,) [m]."""
        self._candidates = ById[Candidate]()

    def shared_with_home(self, home: Collection[str]) -> list[str]:
        """Return landmarks that home saw and that are or were mapped, oldest first."""
        known = {**self.former, **self.mapped}
        return [name for name in known if name in home][:MAX_TESTED]

    def ids(self, names: Iterable[str]) -> np.ndarray:
        """Return the smoother's ids of landmarks, shape (m,); -1 of those not mapped."""
        return np.array([self.mapped[n].number if n in self.mapped else -1 for n in names], int)

    def ids_at(self, t: float, names: Iterable[str]) -> dict[str, int]:
        """Return the smoother's ids of landmarks where they were at `t` [s], if mapped, by name."""
        known = {**self.mapped, **{n: m for n, m in self.former.items() if t < self.moved_at[n]}}
        return {n: known[n].number for n in names if n in known}

    def index(self, landmarks: Iterable[Landmark]) -> np.ndarray:
        """Return the indices of active landmarks in the state, shape (k,)."""
        return self.smoother.index(numbers(landmarks))

    def activate(self, names: Iterable[str]) -> None:
        """Make the landmarks of a frame active; see `Smoother.activate`."""
        ids = self.ids(names)
        self.smoother.activate(ids[ids >= 0])

    def activate_at_home(self, names: Collection[str]) -> None:
        """Make landmarks active that home uses, also where they were before they moved."""
        self.smoother.activate(numbers(self._at_home(names)))

    def deactivate(self, home: Collection[str]) -> None:
        """Make landmarks out of view passive, but those of `home`; see `Smoother.deactivate`."""
        self.smoother.deactivate(numbers(self._at_home(self.shared_with_home(home))))

    def _at_home(self, names: Collection[str]) -> list[Landmark]:
        """Return the landmarks with these names, at their present and former positions."""
        return [of[n] for of in (self.mapped, self.former) for n in names if n in of]

    def distances(self, names: Iterable[str]) -> dict[str, float]:
        """Return the distances from the newest pose of those that are mapped, by name [m]."""
        known = [n for n in names if n in self.mapped]
        away = self.positions(known) - self.smoother.state.mean[:2]
        return dict(zip(known, np.hypot(*away.T).tolist(), strict=True))

    def positions(self, names: Iterable[str]) -> np.ndarray:
        """Return the positions of those landmarks that are mapped, (k, 2) [m]."""
        known = [self.mapped[n] for n in names if n in self.mapped]
        return self.smoother.all_landmarks.positions(numbers(known))

    def walking_probabilities(self, landmarks: Iterable[Landmark]) -> np.ndarray:
        """Return the probabilities of landmarks to be walking about, shape (k,)."""
        return 1.0 - self.smoother.all_landmarks.static_probabilities(numbers(landmarks))

    def places(self, landmarks: Iterable[Landmark]) -> tuple[np.ndarray, np.ndarray]:
        """Return positions of landmarks, (k, 2) [m], and their covariances, (k, 2, 2)."""
        return self.smoother.all_landmarks.places(numbers(landmarks))

    def expect(self, places: dict[str, np.ndarray]) -> None:
        """Set the expected positions (2,) [m] of unmapped landmarks; try their candidates."""
        for name in places.keys() - self.expected.keys() & self._candidates.keys():
            self._candidates[name].next_trial = 0
        self.expected = places

    def add_accepted(
        self, t: float, names: list[str], rows: np.ndarray, directions: np.ndarray
    ) -> None:
        """Add accepted sightings of `t` [s], rows of the table, along directions [rad]."""
        newest = int(rows[0, KEYFRAME]) if len(rows) else 0
        for name, row, line in zip(names, rows, directions.tolist(), strict=True):
            landmark = self.mapped.get(name)
            if landmark is None:
                self._candidates.setdefault(name, Candidate(t)).rows.append(row)
            else:
                landmark.count_sighting(line)
                landmark.last = newest
                if not landmark.rejections:
                    self._candidates.pop(name, None)
        self.smoother.add_sightings(rows[rows[:, LANDMARK] >= 0])
        known = self._candidates
        if len(known) > MAX_IDS and known.prune(lambda waiting: waiting.since < t - WINDOW_S):
            for name in self.range_mixtures.keys() - self._candidates.keys():
                del self.range_mixtures[name]

    def add_rejected(self, t: float, name: str, row: np.ndarray) -> None:
        """Add a rejected sighting of `t` [s] to the candidate of its landmark."""
        self._candidates.setdefault(name, Candidate(t)).rows.append(row)

    def scale_noise(self, factor: float) -> None:
        """Scale the measurement noise of the candidates' sightings."""
        for waiting in self._candidates.values():
            for row in waiting.rows:
                scale_noise(row[None], factor)

    def initialise(self) -> bool:
        """Initialise the candidates that can be triangulated; return whether any was.

        Those with most sightings are tried first: if new ones come faster than they can be tried,
        many are never seen again.
        """
        waiting = [n for n in self._candidates if n not in self.mapped and self._is_due(n)]
        most = max(MAX_TRIALS, sum(name in self.expected for name in waiting))
        due = nlargest(most, waiting, key=lambda name: len(self._candidates[name].rows))
        initialised = [name for name in due if self._initialise(name)]
        for name in due:
            if name in initialised:
                self.range_mixtures.pop(name, None)
            elif len(self._candidates[name].rows) >= MIN_SIGHTINGS:
                rows = np.array(self._candidates[name].rows)
                self._fit_range_mixture(name, rows, self._line_sigmas(rows))
        return bool(initialised)

    def _is_due(self, name: str) -> bool:
        """Return whether a candidate has enough sightings for its next trial."""
        waiting = self._candidates.get(name)
        return waiting is not None and len(waiting.rows) >= waiting.next_trial

    def _initialise(self, name: str) -> bool:
        """Initialise one landmark if its sight lines agree, even if it is mapped elsewhere."""
        waiting = self._candidates.pop(name)
        rows = np.array(waiting.rows)
        found = self._at_expected(name, rows) or self._triangulate(rows)
        found = found or self._at_range(name, rows)
        known = name in self.mapped
        excess = self._excess(name, rows[found[1]], found[0]) if known and found else 0.0
        if found is None or (known and self._is_undecided(name, rows[found[1]], found[0], excess)):
            waiting.next_trial = RETRY_GROWTH * len(rows)
            self._candidates[name] = waiting  # in the order of trials
            return False
        position, agree = found
        rows = rows[agree]
        if excess >= MIN_SIGHTINGS:
            self.former[name] = self.mapped.pop(name)
            self.moved_at[name] = waiting.since
        elif known:
            self.drop(name)  # it was badly initialised
        elif self._has_returned(name, rows, position):
            self._restore(name)
        first, last = rows[[0, -1], KEYFRAME].astype(int).tolist()
        if name not in self.mapped:
            number = self.smoother.add_landmark(position)
            self.mapped[name] = Landmark(name, number, 0, self.smoother.newest, first)
        self.mapped[name].last = last
        rows[:, LANDMARK] = self.mapped[name].number
        self.smoother.add_sightings(rows)
        directions = self.smoother.cameras(rows)[:, 2] + rows[:, BEARING]
        for line in directions.tolist():
            self.mapped[name].count_sighting(line)
        return True

    def _fit_range_mixture(self, name: str, rows: np.ndarray, sigmas: np.ndarray) -> None:
        """Fit a range mixture to a candidate that cannot be triangulated, if its lines agree."""
        eyes = self.smoother.cameras(rows)
        mapped = np.hypot(*(self.smoother.state.positions - eyes[-1, :2]).T)
        scale = float(median(mapped.tolist() or [math.nan]))
        now = self.smoother.state.covariance[:3, :3]
        seen = range_mixture(eyes, rows[:, BEARING], sigmas, now, scale)
        if seen is not None:
            self.range_mixtures[name] = seen

    def replace_solution(self, whole: Smoother) -> None:
        """Adopt the solution of the whole drive: fit the range mixtures again, in its frame."""
        waiting = {
            name: np.array(self._candidates[name].rows)
            for name in self.range_mixtures
            if name in self._candidates
        }
        sigmas = {name: self._line_sigmas(rows) for name, rows in waiting.items()}
        self.smoother = whole  # it does not keep the variances of single motions
        self.range_mixtures.clear()
        for name, rows in waiting.items():
            self._fit_range_mixture(name, rows, sigmas[name])

    def _at_expected(self, name: str, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the expected position, and which sightings agree with it, if most do."""
        place = self.expected.get(name)
        if place is None or name in self.mapped:
            return None
        tolerance = INLIER * self._line_sigmas(rows) + NEGLIGIBLE
        agree = self._residuals(rows, place[None])[0] < tolerance
        return (place, agree) if agree.sum() >= MAJORITY * len(rows) else None

    def _at_range(self, name: str, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the position of a new landmark by ranges, and which sightings agree with it."""
        are_used = self.smoother.uses_ranges and (rows[:, RANGE_SIGMA] > 0.0).any()
        if name in self.mapped or not are_used:
            return None
        ranges = rows[:, LOG_RANGE:].copy()
        ranges[:, 0] -= self.smoother.range_scale
        eyes, sigmas = self.smoother.cameras(rows), self._line_sigmas(rows)
        return place_by_ranges(eyes, rows[:, BEARING], sigmas, ranges)

    def _triangulate(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return position and inlier sightings of a landmark, if the baseline is long enough."""
        if len(rows) < MIN_LINES:
            return None
        eyes = self.smoother.cameras(rows)
        base = float(np.hypot(*np.ptp(eyes[:, :2], axis=0)))
        since = int(rows[0, KEYFRAME]) - self.smoother.first
        if base < BASELINE * math.sqrt(self.smoother.variances.rows[since:, 0].sum()):
            return None
        return triangulate(eyes, rows[:, BEARING], self._line_sigmas(rows), self._parallax)

    def _excess(self, name: str, rows: np.ndarray, position: np.ndarray) -> float:
        """Return how many sightings of a landmark two positions explain, but no single one does.

        The two are its position and another one (2,), on which the sightings `rows` agree.
        """
        landmark, table = self.mapped[name], self.smoother.sightings
        old = table[table[:, LANDMARK] == landmark.number]
        both, places = np.vstack([old, rows]), np.vstack([self.positions([name]), position])
        sigmas = np.concatenate([old[:, SIGMA], self._line_sigmas(rows)])
        off = unexplained(self.smoother.cameras(both), both[:, BEARING], sigmas, places)
        before, since = off[:, : len(old)].sum(axis=1), off[:, len(old) :].sum(axis=1)
        if landmark.established:  # then no other position explains the marginalised ones
            before[1:] += landmark.sightings - len(old)
        return float((before + since).min() - before.min() - since.min())

    def _is_undecided(
        self, name: str, rows: np.ndarray, position: np.ndarray, excess: float
    ) -> bool:
        """Return whether sightings that agree on a position (2,) do not show that it is there.

        The landmark may have moved there, but not be seen often enough to decide; or another one
        may be mistaken for it.
        """
        few = MARGIN < excess < MIN_SIGHTINGS and len(rows) < ESTABLISHED
        return few or self._is_swapped(name, rows, position)

    def _has_returned(self, name: str, rows: np.ndarray, position: np.ndarray) -> bool:
        """Return whether sightings fit the former position of a landmark declared moved.

        They must fit it as well as the new `position` (2,) by their own noise: lines from few
        directions also pass near the former one of a landmark that moved along them.
        """
        if name not in self.former:
            return False
        place = self.smoother.all_landmarks.positions(numbers([self.former[name]]))
        own, off = self._residuals(rows, np.vstack([position, place]))
        squares = (off**2 - own**2) / self._own_sigmas(rows) ** 2
        fits = (off < INLIER * self._line_sigmas(rows)).mean() >= MAJORITY
        return bool(fits and squares.sum() < chdtri(2, FALSE_ALARM))

    def _restore(self, name: str) -> None:
        """Restore a landmark to its former position."""
        self.mapped[name] = self.former.pop(name)
        self.mapped[name].rejections = 0
        self.activate([name])
        del self.moved_at[name]

    def _is_swapped(self, name: str, rows: np.ndarray, position: np.ndarray) -> bool:
        """Return whether another landmark explains sightings as well as a new position does.

        Ids may be swapped. Landmarks that are rejected themselves are left out: two may be mapped
        in each other's place.
        """
        sound = [m for n, m in self.mapped.items() if n != name and m.rejections < MIN_SIGHTINGS]
        others = self.smoother.all_landmarks.positions(numbers([*sound, *self.former.values()]))
        own, *off = np.median(self._residuals(rows, np.vstack([position, others])), axis=1).tolist()
        return any(each < SWAP_RATIO * own for each in off)

    def update_rejections(self, fits: Mapping[str, bool]) -> list[str]:
        """Count the sightings of a frame that fitted; return landmarks rejected too often."""
        rejected = []
        for name, fit in fits.items():
            landmark = self.mapped[name]
            if fit and not landmark.rejections:
                continue
            rejections = landmark.rejections + (-2 if fit else 1)
            landmark.rejections = min(max(rejections, 0), 5 * MIN_SIGHTINGS)
            if landmark.rejections >= MIN_SIGHTINGS:
                rejected.append(name)
        return rejected

    def reinitialise(self, names: list[str], briefly: bool) -> bool:
        """Reinitialise landmarks that are not where they were mapped; return whether any changed.

        Nothing changes while their later sightings do not agree on another position: they may be
        out of sight, and others be mistaken for them. Unless `briefly`, only established ones may
        have moved: wrong camera extrinsics look like moves of landmarks seen from few directions.
        """
        initialised = False
        for name in names:
            if name not in self.former and (briefly or self.mapped[name].established):
                initialised |= self._is_due(name) and self._initialise(name)
            else:
                self.drop(name)
                initialised = True
        return initialised

    def declare_moved(self, names: Collection[str], t: float) -> None:
        """Declare landmarks moved at `t` [s]; candidates, from a wrong pose, begin again."""
        for name in self.mapped.keys() & set(names):
            self.former.setdefault(name, self.mapped[name])
            if self.former[name] is self.mapped.pop(name):
                self.moved_at[name] = t
        self._candidates.clear()
        self.range_mixtures.clear()

    def revert_to(self, keyframe: int) -> None:
        """Remove landmarks initialised after a keyframe, and undo moves declared since."""
        for name in [n for n, m in self.mapped.items() if m.first > keyframe]:
            self.drop(name)
        for name in [n for n in self.former if n not in self.mapped]:
            self._restore(name)
        self._candidates.clear()
        self.range_mixtures.clear()

    def drop_misfits(self, residuals: np.ndarray) -> int:
        """Remove landmarks on which the sightings do not agree; return how many.

        `residuals` (m,) are those of all sightings in the window [rad].
        """
        rows, n = self.smoother.sightings, len(self.smoother.state.positions)
        index = self.smoother.index(rows[:, LANDMARK])
        off = np.abs(residuals) > GATE * rows[:, SIGMA]
        sightings, misfits = np.bincount(index, None, n), np.bincount(index, off, n)
        bad = (sightings >= MIN_SIGHTINGS) & (misfits > 0.5 * sightings)
        wrong = set(self.smoother.ids[bad].tolist())
        names = [m.name for m in self.mapped.values() if m.number in wrong] if wrong else []
        for name in names:
            self.drop(name)
        return len(names)

    def drop_undetermined(self, first: int) -> None:
        """Remove landmarks that were seen before keyframe `first`, if their positions are vague.

        Their sightings are not marginalised: linearised at a position that may be far away from
        the right one, they would count as measurements of distance and heading.
        """
        rows = self.smoother.sightings
        of, has_range = rows[:, LANDMARK], rows[:, RANGE_SIGMA] > 0.0
        leaving = np.setdiff1d(of[rows[:, KEYFRAME] < first], of[has_range])
        for m in [m for m in self.mapped.values() if m.number in leaving]:
            own = rows[of == m.number]
            if len(own) < m.sightings:
                continue  # the others are marginalised, when they did determine it
            place = self.smoother.state.positions[self.index([m])][0]
            if not is_determined(place, self.smoother.cameras(own), self._own_sigmas(own)):
                self.smoother.drop_sightings(LANDMARK, m.number)
                self.drop(m.name)

    def drop(self, name: str) -> None:
        """Remove a landmark from the map; it may be initialised again."""
        self.smoother.drop_landmark(self.mapped.pop(name).number)

    def first_needed(self, mature: float, since: int) -> int:
        """Return the oldest keyframe that saw a landmark of small parallax.

        A landmark seen from a narrow baseline is biased, and marginalising a keyframe that saw it
        would make that bias permanent. So keyframes stay in the window until their landmarks have
        the parallax `mature` [rad], or were initialised at keyframe `since` or before.
        """
        known = [*self.mapped.values(), *self.former.values()]
        young = [m.number for m in known if m.entered > since and m.parallax < mature]
        rows = self.smoother.sightings
        needed = rows[np.isin(rows[:, LANDMARK], young), KEYFRAME]
        return int(needed.min()) if needed.size else self.smoother.newest

    def drop_candidates_before(self, first: int) -> None:
        """Drop the candidates' sightings from before keyframe `first`."""
        for name, waiting in list(self._candidates.items()):
            while waiting.rows and waiting.rows[0][KEYFRAME] < first:
                waiting.rows.popleft()
            waiting.next_trial = min(waiting.next_trial, RETRY_GROWTH * len(waiting.rows) + 1)
            if not waiting.rows:
                del self._candidates[name]

    def _residuals(self, rows: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Return the absolute residuals (k, m) of m sightings for each of k positions [rad]."""
        expected = sight(self.smoother.cameras(rows), places[:, None]).bearing
        return np.asarray(np.abs(wrap(rows[:, BEARING] - expected)))

    def _line_sigmas(self, rows: np.ndarray) -> np.ndarray:
        """Return the standard deviations (m,) of sight lines, with that of the heading since."""
        return np.asarray(np.sqrt(rows[:, SIGMA] ** 2 + self._turn_variances_since(rows)))

    def _own_sigmas(self, rows: np.ndarray) -> np.ndarray:
        """Return the same, with that of the heading until the last of them."""
        since = self._turn_variances_since(rows)
        return np.asarray(np.sqrt(rows[:, SIGMA] ** 2 + since - since.min()))

    def _turn_variances_since(self, rows: np.ndarray) -> np.ndarray:
        """Return the variances (m,) of the turns since rows of the table [rad^2]."""
        turned = np.cumsum(np.append(0.0, self.smoother.variances.rows[::-1, 1]))[::-1]
        return np.asarray(turned[rows[:, KEYFRAME].astype(int) - self.smoother.first])


def numbers(landmarks: Iterable[Landmark]) -> np.ndarray:
    """Return the ids of landmarks in the smoother, shape (k,)."""
    return np.array([m.number for m in landmarks], int)
