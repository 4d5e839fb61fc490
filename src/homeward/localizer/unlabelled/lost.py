"""A robot that is lost among landmarks without ids: the constellation of a frame in the map."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from homeward.localizer.chart import Chart
from homeward.localizer.tunables import (
    BREAKS,
    CLOSE,
    FIT_AGAIN,
    INLIER,
    MIN_EXPECTED,
    MINIMAL,
    NATS_APART,
    SEARCH_LOST_S,
)
from homeward.localizer.unlabelled.constellation import Sky, search
from homeward.localizer.unlabelled.home import may_be, relative_places
from homeward.localizer.unlabelled.registry import NAME, Registry


class Loss:
    """Whether sightings do not fit the map, and the search for the robot in it."""

    def __init__(self) -> None:
        self.at = math.inf
        """When the robot was lost [s]; infinite if it is not."""
        self._searched_at = -math.inf
        self._mapped: set[str] = set()
        """Landmarks that were mapped when the robot was lost."""
        self._breaks = 0

    @property
    def is_suspected(self) -> bool:
        """Whether the newest frames do not fit the map."""
        return self.at < math.inf or self._breaks > 0

    def begins(self, t: float, num_seen: int, total: float, hits: int, chart: Chart) -> bool:
        """Return whether most landmarks that are expected in view have disappeared at once.

        `total` is the expected number of them, and `hits` the number that may have been seen.
        """
        is_broken = hits <= (1.0 - FIT_AGAIN) * total
        enough = total >= MIN_EXPECTED and num_seen >= MINIMAL
        self._breaks = self._breaks + 1 if is_broken and enough else 0
        if self._breaks < BREAKS:
            return False
        self.at, self._mapped = t, set(chart.map.landmarks.mapped)
        return True

    def ends(self, names: Collection[str]) -> bool:
        """Return whether most landmarks in view are of the former map again."""
        old = sum(n in self._mapped for n in names)
        return old >= MINIMAL and old > FIT_AGAIN * len(names)

    def end(self, chart: Chart, known: Registry) -> None:
        """End the search: landmarks that began during it are mapped elsewhere than they are."""
        new = chart.map.landmarks.mapped.keys() - self._mapped
        known.aliases |= {n: "" for n in new if NAME in n}
        self.at, self._breaks, self._mapped = math.inf, 0, set()

    def search(
        self,
        t: float,
        keys: list[str],
        bearings: np.ndarray,
        variances: np.ndarray,
        chart: Chart,
        known: Registry,
    ) -> dict[int, str]:
        """Search for the constellation of a frame in the map; return its landmarks by bearing.

        Without a unique one, the result is empty.
        """
        if t - self._searched_at < SEARCH_LOST_S:
            return {}
        self._searched_at = t
        mapped = chart.map.landmarks.mapped
        names = [n for n in mapped if n in self._mapped and n not in known.aliases]
        if len(names) < MINIMAL or len(keys) <= MINIMAL:
            return {}
        points, covariance = relative_places(chart, names)
        state = chart.map.smoother.state
        near = float(state.mean[0]), float(state.mean[1]), CLOSE * INLIER * state.scale
        allowed = may_be(keys, names, known.kinds)
        lines = bearings, variances, allowed
        found = search(Sky(points, covariance, *lines, known.reach, near))
        if found is None or min(found.margin, found.best.log_evidence) < NATS_APART:
            return {}
        pairs = enumerate(found.best.landmark.tolist())
        return {i: names[j] for i, j in pairs if j >= 0}
