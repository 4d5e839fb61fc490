"""Names, classes and counts of landmarks without ids."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterable
from itertools import combinations

import numpy as np

from homeward.localizer.tunables import CLOSE, GHOST, LAST, LINEAR, MIN_MISSES, NUM_DISTANCES, REACH

NAME = "~"
"""Sign in the ids of landmarks without an id of their own, between class and number."""


class Registry:
    """Landmarks without ids: their names, classes and counts."""

    def __init__(self) -> None:
        self.aliases: dict[str, str] = {}
        """Landmarks that turned out to be others, which have a longer history; empty for none."""
        self.kinds: dict[str, str] = {}
        """Classes of landmarks that have one."""
        self.seen: dict[str, list[int]] = {}
        """Hits and misses of mapped landmarks."""
        self.together: Counter[tuple[str, str]] = Counter()
        """Frames in which two landmarks were seen, by their names in order, ..."""
        self.linked: Counter[tuple[str, str]] = Counter()
        """... and in which both had been seen just before."""
        self.reach = math.inf
        """Distance within which most landmarks are seen [m], ..."""
        self.edge = LINEAR
        """... and over which detection falls off beyond it [reach]."""
        self._distances: deque[float] = deque(maxlen=NUM_DISTANCES)
        self._established: deque[float] = deque(maxlen=NUM_DISTANCES)
        self._born = 0

    def new_name(self, kind: str) -> str:
        """Return the name of a new landmark of a class, which may be empty."""
        self._born += 1
        return f"{kind}{NAME}{self._born}"

    def add_frame(self, names: Iterable[str], live: Iterable[str]) -> None:
        """Count that landmarks were seen in one frame, and others just before."""
        self.together.update(combinations(sorted({*names}), 2))
        self.linked.update(combinations(sorted({*names, *live}), 2))

    def add_distances(self, seen: Iterable[float], established: Iterable[float]) -> None:
        """Add the distances of landmarks that are seen [m], and of those that are established.

        The distance of a landmark that was mapped just now may be far too large.
        """
        self._distances.extend(seen)
        self._established.extend(established)

    def update_reach(self) -> None:
        """Update the reach and its edge by all known distances."""
        if self._distances:
            self.reach = float(np.quantile(self._distances, REACH))
        if self._established:
            last = float(np.quantile(self._established, LAST))
            self.edge = min(max(last / self.reach - 1.0, CLOSE / 2), LINEAR)

    def count(self, name: str, is_hit: bool) -> None:
        """Count a hit or a miss; one that is hardly ever seen where it should be is no landmark."""
        count = self.seen.setdefault(name, [0, 0])
        count[0 if is_hit else 1] += 1
        if not is_hit and count[1] > MIN_MISSES and count[0] < GHOST * count[1]:
            self.aliases[name] = ""

    def detection(self, name: str) -> float:
        """Return the probability that a landmark in view is detected."""
        hits, misses = self.seen.get(name, (0, 0))
        return (hits + 1.0) / (hits + misses + 1.0)

    def rename(self, new: str, old: str) -> None:
        """Record that the landmark `new` is the landmark `old`."""
        self.aliases[new] = old
        counts = self.seen.pop(new, [0, 0]), self.seen.get(old, [0, 0])
        self.seen[old] = [sum(each) for each in zip(*counts, strict=True)]
        for counter in (self.together, self.linked):
            for pair, number in [(p, k) for p, k in counter.items() if new in p]:
                del counter[pair]
                other = pair[pair[0] == new]
                if other != old:
                    counter[in_order(other, old)] += number


def in_order(one: str, other: str) -> tuple[str, str]:
    """Return two names in order, as counters of pairs have them."""
    return (one, other) if one < other else (other, one)
