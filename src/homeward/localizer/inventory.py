"""What is known of each landmark: where it stands in the home frame, and whether it was moved."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from homeward.angles import wrap
from homeward.drives.drive import HomeBearing
from homeward.estimator import LandmarkEstimate
from homeward.frames import Pose, between
from homeward.localizer.landmarks import Landmark, Landmarks
from homeward.localizer.marginal import Marginal, landmark_columns
from homeward.localizer.moved import Hypotheses


@dataclass(frozen=True)
class Inventory:
    """The landmarks of a map and of home."""

    home: Mapping[str, HomeBearing]
    """What home stored."""
    home_yaw: float
    """Of the camera on the robot, at home [rad]."""
    known: Landmarks
    marginal: Marginal
    """The map."""
    used: list[str]
    """The landmarks among which home was found."""
    hypotheses: Hypotheses | None
    """None while home is not found."""

    def landmarks(self) -> list[LandmarkEstimate]:
        """Return everything known of each landmark, in order of name."""
        return [self._landmark(name) for name in sorted({*self.home, *self.known.mapped}, key=str)]

    def _landmark(self, name: str) -> LandmarkEstimate:
        """Return what is known of one landmark; one that moved on the way is where it is now."""
        now = self.known.mapped.get(name)
        stored = x = y = distance = deviation = np.nan
        if name in self.home:
            stored = float(wrap(self.home[name].bearing + self.home_yaw))
        moved_at = self.known.moved_at.get(name, np.nan)
        probability = 1.0 if math.isfinite(moved_at) else self._moved_probability(name)
        if self.hypotheses is not None and now is not None:
            x, y, deviation = self._from_home(now, self.hypotheses)
            distance = math.hypot(x, y)
        return LandmarkEstimate(
            landmark=name,
            x=x,
            y=y,
            distance=distance,
            sigma_distance=deviation,
            home_bearing_stored=stored,
            home_bearing_estimated=math.atan2(y, x) if math.isfinite(distance) else np.nan,
            moved_probability=probability,
            moved=probability > 0.5 if math.isfinite(probability) else None,
            moved_at=moved_at,
            sightings=0 if now is None else now.sightings,
        )

    @cached_property
    def _of_used(self) -> np.ndarray:
        """Return the probability of each used landmark that it was moved, shape (q,)."""
        return np.zeros(0) if self.hypotheses is None else self.hypotheses.moved_probabilities()

    def _moved_probability(self, name: str) -> float:
        """Return the probability that a landmark was moved since home was stored; NaN unjudged."""
        if self.hypotheses is None:
            return math.nan
        if name in self.used:
            return float(self._of_used[self.used.index(name)])
        if name not in self.home:
            return math.nan
        stored, best = self.home[name], self.hypotheses.best
        if name in self.known.mapped:
            columns = landmark_columns(self.known.mapped[name].number)
            places = self.marginal.mean[None, columns]
            covariances, weights = self.marginal.covariance[None, columns, columns], np.ones(1)
        elif name in self.known.glimpsed:
            ray = self.known.glimpsed[name]
            places, covariances, weights = ray.places, ray.covariances, ray.weights
        else:
            return math.nan
        odds = best.odds_of(places, covariances, stored.bearing, stored.sigma)
        together = float(np.logaddexp.reduce(odds + np.log(np.maximum(weights, 1e-300))))
        return 1.0 / (1.0 + math.exp(min(max(together, -500.0), 500.0)))

    def _from_home(self, now: Landmark, hypotheses: Hypotheses) -> tuple[float, float, float]:
        """Return where a landmark stands in the home frame, and how uncertain its distance is."""
        best, columns = hypotheses.best, landmark_columns(now.number)
        at = self.marginal.mean[columns]
        if now.name in self.used and now.name not in self.known.former:
            at = best.landmarks[self.used.index(now.name)]
        x, y, _ = between(Pose(*best.home), Pose(at[0], at[1], 0.0))
        spread = self.marginal.covariance[columns, columns] + best.covariance[:2, :2]
        towards = (at - best.home[:2]) / max(math.hypot(x, y), 1e-9)
        return float(x), float(y), math.sqrt(float(towards @ spread @ towards))
