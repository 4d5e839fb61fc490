"""Landmark report: positions in the home frame, and which landmarks moved."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.estimator import LandmarkEstimate
from homeward.geometry.angles import wrap
from homeward.io.naming import natural
from homeward.localizer.home.hypotheses import Hypotheses
from homeward.localizer.map.landmarks import Landmark, Landmarks
from homeward.localizer.map.survey.survey import Survey
from homeward.localizer.map.triangulation import RangeMixture


@dataclass(frozen=True)
class LandmarkReport:
    """Landmark report of a map and of home."""

    home: Mapping[str, HomeBearing]
    """Stored home bearings."""
    home_yaw: float
    """Yaw of the camera on the robot at home [rad]."""
    known: Landmarks
    """Landmarks of the map."""
    used: list[str]
    """Names of the landmarks used to find home."""
    hypotheses: Hypotheses | None
    """Hypotheses on home; None while it is not found."""
    places: Callable[[Collection[Landmark]], tuple[np.ndarray, np.ndarray]]
    """Places of landmarks in the frame in which home is; see `Registration.places`."""
    survey: Survey
    """Survey of landmarks."""
    exchanged: Mapping[str, str]
    """The other landmark, of each that is exchanged with another one."""
    offsets: Callable[[Sequence[str]], np.ndarray | None]
    """Cameras of home bearings; see `HomeObservation.offsets`."""

    def landmarks(self) -> list[LandmarkEstimate]:
        """Return the estimate of each landmark, in natural order of name."""
        moved, places = self._moved_probabilities(), self._in_home_frame()
        return [
            self._landmark(name, moved.get(name), places.get(name, 3 * (math.nan,)))
            for name in sorted({*self.home, *self.known.mapped}, key=natural)
        ]

    def _landmark(
        self, name: str, tested: float | None, place: tuple[float, float, float]
    ) -> LandmarkEstimate:
        """Return the estimate of one landmark, at its present position."""
        stored, surveyed = math.nan, self.survey.wrong.get(name, math.nan)
        if name in self.home:
            offset = self.offsets([name])
            yaw = self.home_yaw + (0.0 if offset is None else offset[0, 2])
            stored = float(wrap(self.home[name].bearing + yaw))
        mapped, moved_at = self.known.mapped.get(name), self.known.moved_at.get(name, math.nan)
        untested = 1.0 if math.isfinite(moved_at) else math.nan
        reasons = [untested if tested is None else tested, surveyed]
        if tested is not None and mapped is not None:
            reasons.extend(self.known.walking_probabilities([mapped]).tolist())
        probability = max((p for p in reasons if math.isfinite(p)), default=math.nan)
        x, y, deviation = place
        return LandmarkEstimate(
            landmark=name,
            x=x,
            y=y,
            distance=math.hypot(x, y),
            sigma_distance=deviation,
            home_bearing_stored=stored,
            home_bearing_estimated=math.atan2(y, x),
            moved_probability=probability,
            moved=probability > 0.5 if math.isfinite(probability) else None,
            moved_at=moved_at,
            sightings=0 if mapped is None else mapped.sightings,
            exchanged_with=self.exchanged.get(name, ""),
        )

    def _moved_probabilities(self) -> dict[str, float]:
        """Return the probability of landmarks to have moved since home was stored, if evaluated."""
        if self.hypotheses is None:
            return {}
        found = dict(zip(self.used, self.hypotheses.moved_probabilities().tolist(), strict=True))
        ask = [n for n in self.home if n not in found or n in self.known.former]
        others = {n: where for n in ask if (where := self._position(n))}
        if others:
            bearings = [self.home[n].bearing for n in others]
            sigmas = [self.home[n].sigma for n in others]
            counts = [len(where.weights) for where in others.values()]
            places, covariances, weights = (
                np.concatenate([getattr(where, part) for where in others.values()])
                for part in ("places", "covariances", "weights")
            )
            stored = np.repeat(bearings, counts), np.repeat(sigmas, counts)
            offsets = self.offsets([*others])
            repeated = None if offsets is None else np.repeat(offsets, counts, axis=0)
            odds = self.hypotheses.best.odds_of(places, covariances, *stored, repeated)
            odds += np.log(np.maximum(weights, 1e-300))
            together = np.logaddexp.reduceat(odds, np.cumsum([0, *counts[:-1]]))
            wrong = 1.0 / (1.0 + np.exp(np.clip(together, -500.0, 500.0)))
            now = dict(zip(others, wrong.tolist(), strict=True))
            prior = self.hypotheses.best.problem.moved_prior
            found |= {n: _p_moved(found[n], w, prior) if n in found else w for n, w in now.items()}
        return found

    def _position(self, name: str) -> RangeMixture | None:
        """Return a landmark's position as a mixture; None where nothing is known of it."""
        if name not in self.known.mapped:
            # Range mixtures are in the odometry frame, home is not if it was surveyed from.
            surveyed = self.hypotheses is not None and self.hypotheses.best.problem.surveyed.size
            return None if surveyed else self.known.range_mixtures.get(name)
        return RangeMixture(*self.places([self.known.mapped[name]]), np.ones(1))

    def _in_home_frame(self) -> dict[str, tuple[float, float, float]]:
        """Return landmarks' positions in the home frame, and deviations of distance [m]."""
        mapped = self.known.mapped
        if self.hypotheses is None or not mapped:
            return {}
        best = self.hypotheses.best
        at, covariance = self.places(mapped.values())
        index = {name: i for i, name in enumerate(mapped)}
        for name, place in zip(self.used, best.landmarks, strict=True):
            if name in index and name not in self.known.former:
                at[index[name]] = place
        covariance += best.covariance[:2, :2]
        away = at - best.home[:2]
        c, s = math.cos(best.home[2]), math.sin(best.home[2])
        towards = away / np.maximum(np.hypot(*away.T), 1e-9)[:, None]
        variances = np.einsum("ki,kij,kj->k", towards, covariance, towards)
        deviation = np.sqrt(np.maximum(variances, 0.0))  # across a long ray, rounding is left
        table = np.column_stack([away @ np.array([[c, -s], [s, c]]), deviation])
        return dict(zip(mapped, map(tuple, table.tolist()), strict=True))


def _p_moved(former_wrong: float, now_wrong: float, prior: float) -> float:
    """Return the probability that a landmark that moved meanwhile is not where home saw it.

    Home saw it at its former position; or at its present one, if it moved twice, as when it was
    mistaken for another one meanwhile; or elsewhere.

    Parameters
    ----------
    former_wrong, now_wrong : float
        Probability that the home bearing is not of its former position, and not of the present.
    prior : float
        Prior probability that a landmark moved.
    """
    former, now = ((1.0 - p) / max(p, 1e-300) for p in (former_wrong, now_wrong))
    return (1.0 + former) / (1.0 + former + prior * now)
