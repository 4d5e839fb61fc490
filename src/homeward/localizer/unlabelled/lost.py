"""A robot that is lost among landmarks without ids: the constellation of a frame in the map."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from homeward.localizer.chart import Chart
from homeward.localizer.tunables import (
    CLOSE,
    DETECTED,
    INLIER,
    LOST,
    MAJORITY,
    MINIMAL,
    NATS_APART,
    SEARCH_S,
    SUSPECTED,
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
        self.former: set[str] = set()
        """Landmarks that were mapped when the robot was lost."""
        self._evidence = 0.0
        """Log likelihood ratio of the map as estimated over any other pose, at most 0, by frames
        of three or more sightings, ..."""
        self._evidence_of_all = 0.0
        """... and by all."""

    @property
    def is_suspected(self) -> bool:
        """Whether the newest frames do not fit the map."""
        evidence = min(self._evidence, self._evidence_of_all)
        return self.at < math.inf or evidence < -SUSPECTED

    def add_frame(
        self, num_seen: int, detection: np.ndarray, chance: np.ndarray, is_met: np.ndarray
    ) -> None:
        """Add whether landmarks that are expected in view are met (Page, 1954).

        `detection` and `chance` (k,) are the probabilities that a landmark is seen, and that it is
        met by any bearing elsewhere. Where few are seen, the others may be hidden, or out of reach.
        """
        seen = np.minimum(detection, DETECTED)
        met = np.log((seen + (1.0 - seen) * chance) / np.maximum(chance, 1e-3))
        evidence = float(np.where(is_met, met, np.log1p(-seen)).sum())
        self._evidence_of_all = min(max(self._evidence_of_all + evidence, -LOST), 0.0)
        if num_seen >= MINIMAL:
            self._evidence = min(max(self._evidence + evidence, -LOST), 0.0)

    def begins(self, t: float, chart: Chart) -> bool:
        """Return whether landmarks that are expected in view are met by chance only."""
        if self._evidence > -LOST:
            return False
        self.at, self.former = t, set(chart.map.landmarks.mapped)
        return True

    def ends(self, names: Collection[str]) -> bool:
        """Return whether the sightings fit the former map again, and most are of its landmarks."""
        old = sum(n in self.former for n in names)
        return self._evidence == 0.0 and old >= MINIMAL and old > MAJORITY * len(names)

    def end(self, chart: Chart, known: Registry) -> None:
        """End the search: landmarks that began during it are mapped elsewhere than they are."""
        new = chart.map.landmarks.mapped.keys() - self.former
        known.aliases |= {n: "" for n in new if NAME in n}
        self.at, self.former = math.inf, set()
        self._evidence = self._evidence_of_all = 0.0

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
        if t - self._searched_at < SEARCH_S:
            return {}
        self._searched_at = t
        mapped = chart.map.landmarks.mapped
        names = [n for n in mapped if n in self.former and n not in known.aliases]
        if len(names) < MINIMAL or len(keys) <= MINIMAL:
            return {}
        points, covariance = relative_places(chart, names)
        state = chart.map.smoother.state
        near = float(state.mean[0]), float(state.mean[1]), CLOSE * INLIER * state.scale
        allowed = may_be(keys, names, known.kinds)
        lines = bearings, variances, allowed
        found = search(Sky(points, covariance, *lines, known.reach, known.edge, near))
        if found is None or min(found.margin, found.best.log_evidence) < NATS_APART:
            return {}
        pairs = enumerate(found.best.landmark.tolist())
        return {i: names[j] for i, j in pairs if j >= 0}
