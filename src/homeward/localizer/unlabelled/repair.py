"""Repair of the map: landmarks that were mapped twice, and those whose positions are not proven."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Collection, Iterator

import numpy as np

from homeward.localizer.chart import Chart
from homeward.localizer.motions import HEAD
from homeward.localizer.tunables import (
    ANCHOR_S,
    ANCHORED,
    CLOSE,
    INLIER,
    LINK_FRAMES,
    LINK_SHARE,
    MIN_RETURNS,
    MINIMAL,
    TOGETHER,
)
from homeward.localizer.unlabelled.registry import NAME, Registry, in_order


def duplicates(chart: Chart, known: Registry) -> Iterator[tuple[str, str]]:
    """Yield landmarks at one place that were never seen together, the younger one first."""
    mapped, state = chart.map.landmarks.mapped, chart.map.smoother.state
    names = [n for n in mapped if n not in known.aliases]
    if len(names) <= MINIMAL:
        return
    places, ids = chart.map.landmarks.positions(names), chart.map.landmarks.ids(names)
    off = places[:, None] - places
    distance = np.hypot(off[..., 0], off[..., 1])
    close = np.argwhere(np.triu(distance < CLOSE * 3 * state.scale, 1))
    for i, j in close.tolist():
        old, new = names[i], names[j]
        if new in known.aliases or old in known.aliases or NAME not in new:
            continue
        if known.together[in_order(old, new)] > TOGETHER:
            continue
        if len({known.kinds.get(n, "") for n in (old, new)} - {""}) > 1:
            continue
        joint = chart.map.smoother.all_landmarks.joint(ids[[i, j]]).covariance[HEAD:, HEAD:]
        difference = np.hstack([np.eye(2), -np.eye(2)])
        covariance = difference @ joint @ difference.T
        covariance += (CLOSE * state.scale / 10) ** 2 * np.eye(2)
        if math.sqrt(float(np.linalg.eigvalsh(covariance)[-1])) > CLOSE * state.scale:
            continue
        if off[i, j] @ np.linalg.solve(covariance, off[i, j]) < INLIER**2:
            yield new, old


class Anchors:
    """Landmarks whose positions relative to those of home are proven.

    Those of home are the first, with those that had often been seen together with three of them.
    Later ones are often seen from poses that anchored ones prove, or found again where they are
    mapped after such a pose. If odometry or the robot has slipped, landmarks mapped later are seen
    with the former ones by chance only, and are not found where they are mapped from there; they
    are not anchored.
    """

    def __init__(self) -> None:
        self._anchored: set[str] = set()
        self._recent: deque[tuple[float, str]] = deque()
        """Times and landmarks of the newest sightings; empty for none."""
        self._is_met = False
        """Whether enough sightings are anchored in the newest frame of three or more."""
        self._enough_at = -math.inf
        """When enough sightings were of anchored ones last [s]."""
        self._seen_at: dict[str, float] = {}
        """When each landmark was seen last [s], ..."""
        self._returns = Counter[str]()
        """... and how often it was seen again after such a time."""
        self._from_proven = Counter[str]()
        """In how many frames each was seen with three anchored ones, or from a pose that enough of
        them prove with two."""

    def add_frame(self, t: float, names: Collection[str], fits: bool = True) -> None:
        """Add the landmarks of the sightings of a frame at `t` [s], empty for none.

        `fits` is whether the newest frames fit the map.
        """
        self._recent.extend((t, n) for n in names)
        if len(names) >= MINIMAL:
            self._is_met = sum(n in self._anchored for n in names) >= ANCHORED * len(names)
        while self._recent and self._recent[0][0] < t - ANCHOR_S:
            self._recent.popleft()
        seen = {*names} - {""}
        self._returns.update(n for n in seen if self._seen_at.get(n, t) < self._enough_at)
        self._seen_at |= dict.fromkeys(seen, t)
        least = MINIMAL
        if self.are_enough:
            self._enough_at, least = t, MINIMAL - 1
        if fits and len(seen & self._anchored) >= least:
            self._from_proven.update(seen)

    @property
    def are_enough(self) -> bool:
        """Whether enough of the newest sightings are of anchored landmarks."""
        seen = [n for _, n in self._recent]
        anchored = [n for n in seen if n in self._anchored]
        enough = len({*anchored}) >= MINIMAL and len(anchored) >= ANCHORED * len(seen)
        return self._is_met and enough

    def update(self, chart: Chart, known: Registry, of_home: Collection[str]) -> None:
        """Update the anchored landmarks of a map by those of home."""
        mapped = chart.map.landmarks.mapped.keys()
        first = {*of_home} & mapped
        is_new = not first & self._anchored  # another home
        if is_new:
            self._anchored = set()
            self._seen_at.clear()
            self._returns.clear()
            self._from_proven.clear()
        self._anchored |= first
        self._anchored -= known.aliases.keys()
        open_ = mapped - known.aliases.keys() - self._anchored
        grown = is_new
        while grown:
            new = {n for n in open_ if self._is_linked(n, known)}
            self._anchored |= new
            open_ -= new
            grown = bool(new)
        self._anchored |= {n for n in open_ if self._is_proven(n, known)}

    def _is_linked(self, name: str, known: Registry) -> bool:
        """Return whether a landmark was often seen together with three anchored ones."""
        least = _often(name, known)
        often = sum(known.linked[in_order(name, other)] >= least for other in self._anchored)
        return often >= MINIMAL

    def _is_proven(self, name: str, known: Registry) -> bool:
        """Return whether a landmark's position relative to anchored ones is proven."""
        often = self._from_proven[name] >= _often(name, known)
        return often or self._returns[name] >= MIN_RETURNS


def _often(name: str, known: Registry) -> float:
    """Return the number of frames that is more than by chance for a landmark."""
    return max(LINK_FRAMES, LINK_SHARE * known.seen.get(name, [0, 0])[0])
