"""Landmark life cycle: candidates, mapped landmarks, and those that moved."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from heapq import nlargest

import numpy as np

from homeward.angles import wrap
from homeward.localizer.map.range_mixture import RangeMixture, range_mixture
from homeward.localizer.map.sightings import (
    BEARING,
    KEYFRAME,
    LANDMARK,
    SIGMA,
    cameras,
    directions,
    scale_noise,
)
from homeward.localizer.map.smoother import Window
from homeward.localizer.map.triangulation import AGREES, SHARE, triangulate

BASE = 5.0
"""Landmarks start from a base so many times longer than odometry's uncertainty about it."""
MOST_STARTS = 6
"""Landmarks tried to be started at one keyframe."""
MORE = 1.1
"""Sight lines that did not tell a position are tried again when there are so many times more."""
REFUSED = 6
"""A landmark refused so much more often than not starts anew, when others fit."""
MOST_FROM_HOME = 48
"""Home is found among so many landmarks at most; those that came first are the nearest."""
PLACED = 0.3
"""Only a landmark seen under this angle can be said to have moved [rad] ..."""
ESTABLISHED = 12
"""... and seen so often before, and so often since where it is now."""
AS_WELL = 2.0
"""Where another landmark is off by less than so many times as much, it is that one."""
MISFIT, FEWEST_TO_JUDGE = 4.0, 6
"""A landmark is taken out when most of at least so many sightings are so many deviations off."""


@dataclass
class Landmark:
    """What is kept of a landmark in the map."""

    name: str
    number: int
    """In the window."""
    sightings: int = 0
    entered: int = 0
    """Keyframe at which it entered the map ..."""
    first: int = 0
    """... from which it was first seen ..."""
    last: int = 0
    """... and from which it was last seen where it stands."""
    refused: int = 0
    """By how many more sightings of late did not fit than, counted twice, did."""
    lines: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Direction of the first sight line [rad], and how far others lie to either side of it."""

    @property
    def parallax(self) -> float:
        """Angle between the outermost sight lines [rad]."""
        return self.lines[2] - self.lines[1]

    @property
    def established(self) -> bool:
        """Whether it was seen often enough, and from enough sides, to say that it moved."""
        return self.parallax >= PLACED and self.sightings >= ESTABLISHED

    def seen_along(self, direction: float) -> None:
        """Count a sighting along a direction in the odometry frame [rad]."""
        if not self.sightings:
            self.lines = (direction, 0.0, 0.0)
        first, low, high = self.lines
        off = wrap(direction - first)
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
    parallax : float
        Angle between two sight lines that a landmark needs to enter [rad].
    """

    def __init__(self, parallax: float) -> None:
        self._parallax = parallax
        self.mapped: dict[str, Landmark] = {}
        self.former: dict[str, Landmark] = {}
        """Where landmarks stood that moved during the drive."""
        self.moved_at: dict[str, float] = {}
        """When they moved [s]."""
        self.range_mixtures: dict[str, RangeMixture] = {}
        """Rays on which landmarks stand that have no place in the map."""
        self._candidates: dict[str, Candidate] = {}

    def seen_from(self, home: Collection[str]) -> list[str]:
        """Return the landmarks that home saw and the map has or had, in the order they came."""
        came = {**self.former, **self.mapped}
        return [name for name in came if name in home][:MOST_FROM_HOME]

    def number(self, names: list[str]) -> np.ndarray:
        """Return the numbers of landmarks in the window, shape (m,); -1 of those not mapped."""
        return np.array([self.mapped[n].number if n in self.mapped else -1 for n in names], int)

    def keep(self, window: Window, t: float, names: list[str], rows: np.ndarray) -> None:
        """Take sightings of `t` [s], rows of the table, into the window or aside."""
        lines = directions(rows, window.poses_of(rows), window.calibration).tolist()
        for name, row, line in zip(names, rows, lines, strict=True):
            landmark = self.mapped.get(name)
            if landmark is None:
                self._candidates.setdefault(name, Candidate(t)).rows.append(row)
            else:
                landmark.seen_along(line)
                landmark.last = window.newest
                if not landmark.refused:
                    self._candidates.pop(name, None)
        window.add_sightings(rows[rows[:, LANDMARK] >= 0])

    def set_aside(self, t: float, name: str, row: np.ndarray) -> None:
        """Put a sighting of `t` [s] aside that does not fit where its landmark is mapped."""
        self._candidates.setdefault(name, Candidate(t)).rows.append(row)

    def scale_noise(self, factor: float) -> None:
        """Let the own deviations of sightings put aside be so many times as large."""
        for waiting in self._candidates.values():
            for row in waiting.rows:
                scale_noise(row[None], factor)

    def initialise(self, window: Window, covariance: np.ndarray) -> bool:
        """Let the landmarks enter whose sight lines agree by now; return whether any did.

        Those seen most are tried first: where new ones come faster than they can be tried, many
        are never seen again.

        Parameters
        ----------
        window : Window
            The map.
        covariance : ndarray, shape (3, 3)
            Of the newest pose.
        """
        waiting = [n for n in self._candidates if n not in self.mapped and self._is_due(n)]
        due = nlargest(MOST_STARTS, waiting, key=lambda name: len(self._candidates[name].rows))
        started = [name for name in due if self._initialise(window, name)]
        for name in due:
            if name in started:
                self.range_mixtures.pop(name, None)
            else:
                self._fit_range_mixture(window, name, covariance)
        return bool(started)

    def _is_due(self, name: str) -> bool:
        """Return whether what is put aside of a landmark is worth a try."""
        waiting = self._candidates.get(name)
        return waiting is not None and len(waiting.rows) >= waiting.due

    def _initialise(self, window: Window, name: str) -> bool:
        """Let one landmark enter if its sight lines agree, even if it is mapped elsewhere."""
        waiting = self._candidates.pop(name)
        rows = np.array(waiting.rows)
        found = self._triangulate(window, rows)
        known = name in self.mapped
        if found is None or (known and not self._has_moved(window, name, rows[found[1]], found[0])):
            waiting.due = MORE * len(rows)
            self._candidates[name] = waiting  # behind the others
            return False
        position, agree = found
        if known and self._was_there(window, name, position):
            self._drop(window, name)  # it was never elsewhere, but wrongly started
        elif known:
            self.former[name] = self.mapped.pop(name)
            self.moved_at[name] = waiting.since
        rows = rows[agree]
        rows[:, LANDMARK] = number = window.add_landmark(position)
        window.add_sightings(rows)
        first, last = rows[[0, -1], KEYFRAME].astype(int).tolist()
        self.mapped[name] = Landmark(name, number, 0, window.newest, first, last)
        for line in directions(rows, window.poses_of(rows), window.calibration).tolist():
            self.mapped[name].seen_along(line)
        return True

    def _fit_range_mixture(self, window: Window, name: str, covariance: np.ndarray) -> None:
        """Keep on what ray a landmark without a place stands, if its sight lines agree on one."""
        rows = np.array(self._candidates[name].rows)
        eyes = cameras(rows, window.poses_of(rows), window.calibration)
        mapped = np.hypot(*(window.positions - eyes[-1, :2]).T)
        scale = float(np.median(mapped)) if mapped.size else math.nan
        seen = range_mixture(eyes, rows[:, BEARING], _line_sigmas(window, rows), covariance, scale)
        if seen is not None:
            self.range_mixtures[name] = seen

    def _triangulate(
        self, window: Window, rows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return position and agreeing sightings of a landmark, if its base is long enough."""
        eyes = cameras(rows, window.poses_of(rows), window.calibration)
        base = float(np.hypot(*np.ptp(eyes[:, :2], axis=0)))
        since = int(rows[0, KEYFRAME]) - window.first
        if base < BASE * math.sqrt(sum(window.shift_variances[since:])):
            return None
        return triangulate(eyes, rows[:, BEARING], _line_sigmas(window, rows), self._parallax)

    def _has_moved(self, window: Window, name: str, rows: np.ndarray, position: np.ndarray) -> bool:
        """Return whether sightings that agree on a position (2,) show that a landmark is there."""
        return len(rows) >= ESTABLISHED and not self._is_another(window, name, rows, position)

    def _was_there(self, window: Window, name: str, position: np.ndarray) -> bool:
        """Return whether what was seen of a landmark before fits a new position (2,) as well."""
        rows = window.sightings[window.sightings[:, LANDMARK] == self.mapped[name].number]
        off = _off(window, rows, position[None])[0]
        return bool((off < AGREES * rows[:, SIGMA]).sum() >= SHARE * max(len(rows), 1))

    def _is_another(
        self, window: Window, name: str, rows: np.ndarray, position: np.ndarray
    ) -> bool:
        """Return whether another landmark of the map explains sightings as well as a position."""
        others = np.delete(window.positions, self.mapped[name].number, axis=0)
        own, *off = np.median(_off(window, rows, np.vstack([position, others])), axis=1).tolist()
        return any(each < AS_WELL * own for each in off)

    def refused(self, fits: Mapping[str, bool]) -> list[str]:
        """Count which sightings of a stamp fitted; return the landmarks refused too often."""
        for name, fit in fits.items():
            landmark = self.mapped[name]
            refused = landmark.refused + (-2 if fit else 1)
            landmark.refused = min(max(refused, 0), 5 * REFUSED)
        return [name for name in fits if self.mapped[name].refused >= REFUSED]

    def reinitialise(self, window: Window, names: list[str]) -> bool:
        """Let landmarks start anew that are found not to be where they were; tell if any did.

        One that was established has moved, where its sightings since agree on another place. They
        need not: it may be out of sight, and others be mistaken for it.
        """
        started = False
        for name in names:
            if self.mapped[name].established and name not in self.former:
                started |= self._is_due(name) and self._initialise(window, name)
            else:
                self._drop(window, name)
                started = True
        return started

    def revert_to(self, window: Window, keyframe: int) -> None:
        """Drop what entered after a keyframe; what is said to have moved since did not."""
        for name in [n for n, m in self.mapped.items() if m.first > keyframe]:
            self._drop(window, name)
        for name in [n for n in self.former if n not in self.mapped]:
            self.mapped[name] = self.former.pop(name)
            self.mapped[name].refused = 0
            del self.moved_at[name]
        self._candidates.clear()
        self.range_mixtures.clear()

    def drop_misfits(self, window: Window) -> int:
        """Take landmarks out on which the sightings do not agree; return how many."""
        rows, n = window.sightings, len(window.positions)
        number = rows[:, LANDMARK].astype(int)
        off = np.abs(window.residuals()) > MISFIT * rows[:, SIGMA]
        sightings, misfits = np.bincount(number, None, n), np.bincount(number, off, n)
        bad = (sightings >= FEWEST_TO_JUDGE) & (misfits > 0.5 * sightings)
        names = [m.name for m in self.mapped.values() if bad[m.number]]
        for name in names:
            self._drop(window, name)
        return len(names)

    def _drop(self, window: Window, name: str) -> None:
        """Take a landmark out of the map; it may start anew."""
        gone = self.mapped.pop(name)
        window.drop_landmark(gone.number)
        for other in [*self.mapped.values(), *self.former.values()]:
            other.number -= other.number > gone.number

    def first_needed(self, window: Window, mature: float, since: int) -> int:
        """Return the oldest keyframe that saw a landmark which is not safely placed yet.

        A landmark seen from a narrow base is not where it seems, and closing a keyframe that saw it
        would keep that error for good; so keyframes stay open until their landmarks are seen from
        more sides, under the angle `mature` [rad], or entered at keyframe `since` or before.
        """
        young = np.zeros(len(window.positions), bool)
        for m in [*self.mapped.values(), *self.former.values()]:
            young[m.number] = m.parallax < mature and m.entered > since
        rows = window.sightings
        needed = rows[young[rows[:, LANDMARK].astype(int)], KEYFRAME]
        return int(needed.min()) if needed.size else window.newest

    def drop_rows_before(self, first: int) -> None:
        """Lose the sightings of waiting landmarks from before keyframe `first`."""
        for name, waiting in list(self._candidates.items()):
            while waiting.rows and waiting.rows[0][KEYFRAME] < first:
                waiting.rows.popleft()
            waiting.due = min(waiting.due, MORE * len(waiting.rows) + 1)
            if not waiting.rows:
                del self._candidates[name]


def _off(window: Window, rows: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return how far sightings (m) are off what places (k, 2) let expect, shape (k, m) [rad]."""
    eyes = cameras(rows, window.poses_of(rows), window.calibration)
    sight = places[:, None, :] - eyes[:, :2]
    expected = np.arctan2(sight[:, :, 1], sight[:, :, 0]) - eyes[:, 2]
    return np.asarray(np.abs(wrap(rows[:, BEARING] - expected)))


def _line_sigmas(window: Window, rows: np.ndarray) -> np.ndarray:
    """Return the deviations of sight lines, the heading's since then included, shape (m,)."""
    turned = np.cumsum([0.0, *window.turn_variances[::-1]])[::-1]
    since = turned[rows[:, KEYFRAME].astype(int) - window.first]
    return np.asarray(np.sqrt(rows[:, SIGMA] ** 2 + since))
