"""Landmark life cycle: candidates, mapped landmarks, and those that moved."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from heapq import nlargest

import numpy as np

from homeward.angles import wrap
from homeward.localizer.geometry import sight
from homeward.localizer.map.range_mixture import RangeMixture, range_mixture
from homeward.localizer.map.sightings import (
    BEARING,
    KEYFRAME,
    LANDMARK,
    SIGMA,
    scale_noise,
)
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.map.triangulation import triangulate
from homeward.localizer.tunables import (
    BASELINE_RATIO,
    ESTABLISHED_SIGHTINGS,
    GATE,
    INLIER_GATE,
    LINEAR_RANGE,
    MAJORITY,
    MIN_SIGHTINGS,
    NEGLIGIBLE,
    SWAP_RATIO,
)

MOST_STARTS = 6
"""Landmarks tried to be started at one keyframe."""
MORE = 1.1
"""Sight lines that did not tell a position are tried again when there are so many times more."""
MOST_FROM_HOME = 48
"""Home is found among so many landmarks at most; those that came first are the nearest."""


@dataclass
class Landmark:
    """What is kept of a landmark in the map."""

    name: str
    number: int
    """Its id in the smoother."""
    sightings: int = 0
    entered: int = 0
    """Keyframe at which it entered the map ..."""
    first: int = 0
    """... from which it was first seen ..."""
    last: int = 0
    """... and from which it was last seen where it stands."""
    refused: int = 0
    """By how many more sightings of late did not fit than, counted twice, did."""
    astray: np.ndarray = field(default_factory=lambda: np.zeros((2, 2)))
    """Second moment of how far it is off its place if it walks about [m^2]."""
    lines: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Direction of the first sight line [rad], and how far others lie to either side of it."""

    @property
    def parallax(self) -> float:
        """Angle between the outermost sight lines [rad]."""
        return self.lines[2] - self.lines[1]

    @property
    def established(self) -> bool:
        """Whether it was seen often enough, and from enough sides, to say that it moved."""
        return self.parallax >= LINEAR_RANGE and self.sightings >= ESTABLISHED_SIGHTINGS

    def seen_along(self, direction: float) -> None:
        """Count a sighting along a direction in the odometry frame [rad]."""
        if not self.sightings:
            self.lines = (direction, 0.0, 0.0)
        first, low, high = self.lines
        off = math.remainder(direction - first, math.tau)
        self.lines = (first, min(low, off), max(high, off))
        self.sightings += 1


@dataclass
class Candidate:
    """Candidate: sightings of a landmark that is not in the map yet, or not where it was mapped."""

    since: float
    """When the first of them was seen [s]."""
    rows: deque[np.ndarray] = field(default_factory=deque)
    due: float = 0.0
    """It is worth a try when there are so many rows."""


class Landmarks:
    """Which landmarks the map has, and how they come and go.

    Parameters
    ----------
    smoother : Smoother
        What they enter and leave.
    parallax : float
        Angle between two sight lines that a landmark needs to enter [rad].
    """

    def __init__(self, smoother: Smoother, parallax: float) -> None:
        self.smoother, self._parallax = smoother, parallax
        self.mapped: dict[str, Landmark] = {}
        self.former: dict[str, Landmark] = {}
        """Where landmarks stood that moved during the drive."""
        self.moved_at: dict[str, float] = {}
        """When they moved [s]."""
        self.range_mixtures: dict[str, RangeMixture] = {}
        """Rays on which landmarks stand that have no place in the map."""
        self.expected: dict[str, np.ndarray] = {}
        """Where surveyed landmarks are to be that are not mapped yet, (2,) [m]."""
        self._candidates: dict[str, Candidate] = {}

    def seen_from(self, home: Collection[str]) -> list[str]:
        """Return the landmarks that home saw and the map has or had, in the order they came."""
        came = {**self.former, **self.mapped}
        return [name for name in came if name in home][:MOST_FROM_HOME]

    def ids(self, names: Iterable[str]) -> np.ndarray:
        """Return the ids of landmarks where they stand, shape (m,); -1 of those not mapped."""
        return np.array([self.mapped[n].number if n in self.mapped else -1 for n in names], int)

    def index(self, landmarks: Iterable[Landmark]) -> np.ndarray:
        """Return which landmarks of the state these are, shape (k,)."""
        return self.smoother.index(np.array([m.number for m in landmarks], int))

    def walking(self, landmarks: Iterable[Landmark]) -> np.ndarray:
        """Return how probable landmarks are to walk about, shape (k,)."""
        return np.asarray(1.0 - self.smoother.stands[self.index(landmarks)])

    def places(self, landmarks: Iterable[Landmark]) -> tuple[np.ndarray, np.ndarray]:
        """Return where landmarks stand, (k, 2) [m], and the covariances of that, (k, 2, 2)."""
        return self.smoother.state.places(self.index(landmarks))

    def expect(self, places: dict[str, np.ndarray]) -> None:
        """Expect landmarks that are not mapped yet at places, (2,) [m]; try what waits there."""
        for name in places.keys() - self.expected.keys() & self._candidates.keys():
            self._candidates[name].due = 0
        self.expected = places

    def keep(self, t: float, names: list[str], rows: np.ndarray, directions: np.ndarray) -> None:
        """Take sightings of `t` [s], rows of the table, along directions [rad]."""
        newest = self.smoother.newest
        for name, row, line in zip(names, rows, directions.tolist(), strict=True):
            landmark = self.mapped.get(name)
            if landmark is None:
                self._candidates.setdefault(name, Candidate(t)).rows.append(row)
            else:
                landmark.seen_along(line)
                landmark.last = newest
                if not landmark.refused:
                    self._candidates.pop(name, None)
        self.smoother.add_sightings(rows[rows[:, LANDMARK] >= 0])

    def set_aside(self, t: float, name: str, row: np.ndarray) -> None:
        """Put a sighting of `t` [s] aside that does not fit where its landmark is mapped."""
        self._candidates.setdefault(name, Candidate(t)).rows.append(row)

    def scale_noise(self, factor: float) -> None:
        """Let the own deviations of sightings put aside be so many times as large."""
        for waiting in self._candidates.values():
            for row in waiting.rows:
                scale_noise(row[None], factor)

    def initialise(self) -> bool:
        """Let the landmarks enter whose sight lines agree by now; return whether any did.

        Those seen most are tried first: where new ones come faster than they can be tried, many
        are never seen again.
        """
        waiting = [n for n in self._candidates if n not in self.mapped and self._is_due(n)]
        most = max(MOST_STARTS, sum(name in self.expected for name in waiting))
        due = nlargest(most, waiting, key=lambda name: len(self._candidates[name].rows))
        started = [name for name in due if self._initialise(name)]
        for name in due:
            if name in started:
                self.range_mixtures.pop(name, None)
            else:
                self._fit_range_mixture(name)
        return bool(started)

    def _is_due(self, name: str) -> bool:
        """Return whether what is put aside of a landmark is worth a try."""
        waiting = self._candidates.get(name)
        return waiting is not None and len(waiting.rows) >= waiting.due

    def _initialise(self, name: str) -> bool:
        """Let one landmark enter if its sight lines agree, even if it is mapped elsewhere."""
        waiting = self._candidates.pop(name)
        rows = np.array(waiting.rows)
        found = self._as_expected(name, rows) or self._triangulate(rows)
        known = name in self.mapped
        if found is None or (known and not self._has_moved(name, rows[found[1]], found[0])):
            waiting.due = MORE * len(rows)
            self._candidates[name] = waiting  # behind the others
            return False
        position, agree = found
        rows = rows[agree]
        if known and self._was_there(name, position):
            self._drop(name)  # it was never elsewhere, but wrongly started
        elif known:
            self.former[name] = self.mapped.pop(name)
            self.moved_at[name] = waiting.since
        elif self._is_back(name, rows):
            self._take_back(name)
        first, last = rows[[0, -1], KEYFRAME].astype(int).tolist()
        if name not in self.mapped:
            number = self.smoother.add_landmark(position)
            self.mapped[name] = Landmark(name, number, 0, self.smoother.newest, first)
        self.mapped[name].last = last
        rows[:, LANDMARK] = self.mapped[name].number
        self.smoother.add_sightings(rows)
        directions = self.smoother.cameras(rows)[0][:, 2] + rows[:, BEARING]
        for line in directions.tolist():
            self.mapped[name].seen_along(line)
        return True

    def _fit_range_mixture(self, name: str) -> None:
        """Keep on what ray a landmark without a place stands, if its sight lines agree on one."""
        rows = np.array(self._candidates[name].rows)
        eyes = self.smoother.cameras(rows)[0]
        mapped = np.hypot(*(self.smoother.positions - eyes[-1, :2]).T)
        scale = float(np.median(mapped)) if mapped.size else math.nan
        now = self.smoother.state.covariance[:3, :3]
        seen = range_mixture(eyes, rows[:, BEARING], self._line_sigmas(rows), now, scale)
        if seen is not None:
            self.range_mixtures[name] = seen

    def _as_expected(self, name: str, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return a place that is known beforehand, and which sightings agree, if most do."""
        place = self.expected.get(name)
        if place is None or name in self.mapped:
            return None
        agree = self._off(rows, place[None])[0] < INLIER_GATE * self._line_sigmas(rows) + NEGLIGIBLE
        return (place, agree) if agree.sum() >= MAJORITY * len(rows) else None

    def _triangulate(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return position and agreeing sightings of a landmark, if its base is long enough."""
        eyes = self.smoother.cameras(rows)[0]
        base = float(np.hypot(*np.ptp(eyes[:, :2], axis=0)))
        since = int(rows[0, KEYFRAME]) - self.smoother.first
        if base < BASELINE_RATIO * math.sqrt(sum(self.smoother.shift_variances[since:])):
            return None
        return triangulate(eyes, rows[:, BEARING], self._line_sigmas(rows), self._parallax)

    def _has_moved(self, name: str, rows: np.ndarray, position: np.ndarray) -> bool:
        """Return whether sightings that agree on a position (2,) show that a landmark is there."""
        return len(rows) >= ESTABLISHED_SIGHTINGS and not self._is_another(name, rows, position)

    def _was_there(self, name: str, position: np.ndarray) -> bool:
        """Return whether what was seen of a landmark before fits a new position (2,) as well."""
        rows = self.smoother.sightings
        rows = rows[rows[:, LANDMARK] == self.mapped[name].number]
        off = self._off(rows, position[None])[0]
        return bool((off < INLIER_GATE * rows[:, SIGMA]).sum() >= MAJORITY * max(len(rows), 1))

    def _is_back(self, name: str, rows: np.ndarray) -> bool:
        """Return whether sightings fit where a landmark stood that was said to have moved."""
        if name not in self.former:
            return False
        off = self._off(rows, self.places([self.former[name]])[0])[0]
        return bool((off < INLIER_GATE * self._line_sigmas(rows)).mean() >= MAJORITY)

    def _take_back(self, name: str) -> None:
        """Let a landmark stand where it stood before it was said to have moved."""
        self.mapped[name] = self.former.pop(name)
        self.mapped[name].refused = 0
        del self.moved_at[name]

    def _is_another(self, name: str, rows: np.ndarray, position: np.ndarray) -> bool:
        """Return whether another landmark of the map explains sightings as well as a position.

        One that is refused itself explains nothing: two may stand mapped in each other's place.
        """
        sound = [m for n, m in self.mapped.items() if n != name and m.refused < MIN_SIGHTINGS]
        others = self.places([*sound, *self.former.values()])[0]
        own, *off = np.median(self._off(rows, np.vstack([position, others])), axis=1).tolist()
        return any(each < SWAP_RATIO * own for each in off)

    def refused(self, fits: Mapping[str, bool]) -> list[str]:
        """Count which sightings of a stamp fitted; return the landmarks refused too often."""
        for name, fit in fits.items():
            landmark = self.mapped[name]
            refused = landmark.refused + (-2 if fit else 1)
            landmark.refused = min(max(refused, 0), 5 * MIN_SIGHTINGS)
        return [name for name in fits if self.mapped[name].refused >= MIN_SIGHTINGS]

    def reinitialise(self, names: list[str]) -> bool:
        """Let landmarks start anew that are found not to be where they were; tell if any did.

        One that was established has moved, where its sightings since agree on another place. They
        need not: it may be out of sight, and others be mistaken for it.
        """
        started = False
        for name in names:
            if self.mapped[name].established and name not in self.former:
                started |= self._is_due(name) and self._initialise(name)
            else:
                self._drop(name)
                started = True
        return started

    def revert_to(self, keyframe: int) -> None:
        """Drop what entered after a keyframe; what is said to have moved since did not."""
        for name in [n for n, m in self.mapped.items() if m.first > keyframe]:
            self._drop(name)
        for name in [n for n in self.former if n not in self.mapped]:
            self._take_back(name)
        self._candidates.clear()
        self.range_mixtures.clear()

    def drop_misfits(self, residuals: np.ndarray) -> int:
        """Take landmarks out on which the sightings do not agree; return how many.

        Parameters
        ----------
        residuals : ndarray, shape (m,)
            Of all sightings in the map [rad].
        """
        rows, n = self.smoother.sightings, len(self.smoother.positions)
        index = self.smoother.index(rows[:, LANDMARK])
        off = np.abs(residuals) > GATE * rows[:, SIGMA]
        sightings, misfits = np.bincount(index, None, n), np.bincount(index, off, n)
        bad = (sightings >= MIN_SIGHTINGS) & (misfits > 0.5 * sightings)
        mapped = list(self.mapped.values())
        names = [m.name for m, off in zip(mapped, bad[self.index(mapped)], strict=True) if off]
        for name in names:
            self._drop(name)
        return len(names)

    def _drop(self, name: str) -> None:
        """Take a landmark out of the map; it may start anew."""
        self.smoother.drop_landmark(self.mapped.pop(name).number)

    def first_needed(self, mature: float, since: int) -> int:
        """Return the oldest keyframe that saw a landmark which is not safely placed yet.

        A landmark seen from a narrow base is not where it seems, and closing a keyframe that saw it
        would keep that error for good; so keyframes stay open until their landmarks are seen from
        more sides, under the angle `mature` [rad], or entered at keyframe `since` or before.
        """
        known = [*self.mapped.values(), *self.former.values()]
        young = [m.number for m in known if m.parallax < mature and m.entered > since]
        rows = self.smoother.sightings
        needed = rows[np.isin(rows[:, LANDMARK], young), KEYFRAME]
        return int(needed.min()) if needed.size else self.smoother.newest

    def drop_rows_before(self, first: int) -> None:
        """Lose the sightings of waiting landmarks from before keyframe `first`."""
        for name, waiting in list(self._candidates.items()):
            while waiting.rows and waiting.rows[0][KEYFRAME] < first:
                waiting.rows.popleft()
            waiting.due = min(waiting.due, MORE * len(waiting.rows) + 1)
            if not waiting.rows:
                del self._candidates[name]

    def _off(self, rows: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Return how far sightings (m) are off what places (k, 2) let expect, (k, m) [rad]."""
        expected = sight(self.smoother.cameras(rows)[0], places[:, None]).bearing
        return np.asarray(np.abs(wrap(rows[:, BEARING] - expected)))

    def _line_sigmas(self, rows: np.ndarray) -> np.ndarray:
        """Return the deviations of sight lines, the heading's since then included, shape (m,)."""
        turned = np.cumsum([0.0, *self.smoother.turn_variances[::-1]])[::-1]
        since = turned[rows[:, KEYFRAME].astype(int) - self.smoother.first]
        return np.asarray(np.sqrt(rows[:, SIGMA] ** 2 + since))
