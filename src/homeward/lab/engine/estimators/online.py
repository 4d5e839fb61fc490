"""A filter that runs: twists and sightings in by their stamps, an `Estimate` out."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from homeward.estimator import (
    MIN_AGREEING,
    NO_BEARINGS_S,
    Counts,
    Estimate,
    Innovation,
    LandmarkEstimate,
    Status,
    guarded,
)
from homeward.geometry.angles import wrap
from homeward.io.naming import natural
from homeward.lab.filters.carrier import FilterBackend
from homeward.lab.filters.settings import Engine
from homeward.odometry.validity import TwistValidity
from homeward.reasons import Reason, Rejection, too_few_agree

RECENT = 20
"""Number of the last sightings that decide whether most are rejected."""


class OnlineFilter:
    """A filter with a start prior as an `homeward.estimator.Estimator`.

    Its name is the word for it in commands and files. Landmarks are in the order of the states;
    sightings of others are counted and left out. `camera_yaw` is added to every bearing to make it
    one from the robot's heading [rad]; notes are assumptions to report to the user.
    """

    def __init__(
        self,
        name: str,
        carrier: FilterBackend,
        landmarks: Sequence[str],
        camera_yaw: float,
        notes: tuple[str, ...] = (),
    ) -> None:
        self._carrier = carrier
        self.name, self.notes, self.counts = name, notes + carrier.notes, Counts()
        self._turn = threading.RLock()
        self._ids = list(landmarks)
        self._index = {landmark: i for i, landmark in enumerate(self._ids)}
        self._camera_yaw = camera_yaw
        self._belief = self._carrier.start()
        self._sightings = np.zeros(len(self._ids), dtype=int)
        self._t = math.nan
        self._twist: tuple[float, float] | None = None
        self._twist_t, self._hold = -math.inf, TwistValidity()
        self._last_seen = -math.inf
        self._agrees = np.zeros(len(self._ids), dtype=bool)
        self._recent: deque[bool] = deque(maxlen=RECENT)

    @property
    def engine(self) -> Engine:
        """What executes it: native or interpreter."""
        return self._carrier.engine

    @property
    def ids(self) -> tuple[str, ...]:
        """Landmarks, in the order of the states."""
        return tuple(self._ids)

    @property
    def carrier(self) -> FilterBackend:
        """What its belief is, and its steps."""
        return self._carrier

    def adopt(self, belief: Any, t: float, sightings: np.ndarray) -> None:
        """Take over what the same filter, run elsewhere, had come to at `t` [s].

        `sightings` (q,) are how many of each landmark it used.
        """
        self._belief, self._t, self._sightings = belief, t, sightings
        self.counts.used = int(sightings.sum())

    @guarded
    def odometry(self, t: float, v: float, omega: float) -> None:
        """Take a twist that holds from `t` [s] on: `v` [m/s], `omega` [rad/s]; NaN: unknown."""
        unknown = math.isnan(v) and math.isnan(omega)
        if not (math.isfinite(t) and (unknown or (math.isfinite(v) and math.isfinite(omega)))):
            self.counts.reject(Rejection.BAD_ODOMETRY)
            if math.isfinite(t) and t >= self._t:  # unknown motion from here on
                self._advance(t)
                self._twist_t = -math.inf
            return
        if t < self._t:
            self.counts.reject(Rejection.LATE_ODOMETRY)
            return
        self._advance(t)
        self._twist, self._twist_t = (v, omega), -math.inf if unknown else t
        if not unknown:
            self._hold.add(t)

    @guarded
    def bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float] | None = None
    ) -> Estimate:
        """Take all sightings of stamp `t` [s] as one update; see `homeward.estimator`."""
        if not math.isfinite(t) or t < self._t:
            late = Rejection.LATE_BEARINGS if math.isfinite(t) else Rejection.BAD_BEARING
            self.counts.reject(late, len(sightings))
            return self.estimate(t)
        self._advance(t)
        seen = self._usable(sightings)
        own = {
            self._index[k]: s
            for k, s in (sigmas or {}).items()
            if k in self._index and 0 < s < math.inf
        }
        before, diverged = self._belief.active, self._carrier.diverged
        self._belief, out = self._carrier.update(self._belief, seen, own)
        lost = self._carrier.diverged - diverged
        self.counts.reject(Rejection.DIVERGED, lost)
        innovations = self._innovations(seen, before, out)
        used = ((out["accepted"] > 0) | (self._belief.active > before)) & (not lost)
        self._sightings += used
        self._agrees[list(seen)] = used[list(seen)]
        self._recent.extend(i.accepted for i in innovations)
        self.counts.used += int(used.sum())
        if used.any():
            self._last_seen = t
        return self._estimate(t, self._belief, innovations)

    @guarded
    def estimate(self, t: float) -> Estimate:
        """Predict to `t` [s], not before the last sample, and change nothing."""
        if math.isnan(self._t):
            return Estimate(t, Status.WAITING, Reason.NO_SAMPLES.words)
        now = max(t, self._t) if math.isfinite(t) else self._t
        return replace(self._estimate(now, self._predicted(now), ()), t=t)

    @guarded
    def landmarks(self) -> list[LandmarkEstimate]:
        """Return where each landmark must stand, as far as the belief says."""
        belief, stored = self._belief, self._carrier.stored
        home, distances, sigmas = self._carrier.landmarks(belief)
        known = []
        for i, landmark in enumerate(self._ids):
            entry: dict[str, Any] = {"home_bearing_stored": float(wrap(stored[i]))}
            if belief.active[i]:
                entry["home_bearing_estimated"] = float(home[i])
                entry["sightings"] = int(self._sightings[i])
                if 0 < (distance := float(distances[i])) < math.inf:
                    entry |= {"distance": distance, "sigma_distance": float(sigmas[i])}
                    entry["x"] = float(distances[i] * np.cos(home[i]))
                    entry["y"] = float(distances[i] * np.sin(home[i]))
            known.append(LandmarkEstimate(landmark, **entry))
        return sorted(known, key=lambda m: natural(m.landmark))

    def _advance(self, t: float) -> None:
        """Carry the belief to `t` [s]; with the first sample time begins."""
        if math.isnan(self._t):
            self._t = t
        before = self._carrier.diverged
        self._belief, self._t = self._predicted(t), t
        self.counts.reject(Rejection.DIVERGED, self._carrier.diverged - before)

    def _predicted(self, t: float) -> Any:
        """Carry the belief to `t`: by the twist while it holds, then by its absence."""
        held = min(max(self._twist_t + self._hold.seconds, self._t), t)
        belief = self._carrier.predict(self._belief, held - self._t, self._twist)
        return self._carrier.predict(belief, t - held, None)

    def _usable(self, sightings: Mapping[str, float]) -> dict[int, float]:
        """Return the sightings of known landmarks by index, from the robot's heading [rad]."""
        usable = {}
        for landmark, beta in sightings.items():
            if landmark not in self._index:
                self.counts.reject(Rejection.NO_HOME_BEARING)
            elif not math.isfinite(beta):
                self.counts.reject(Rejection.BAD_BEARING)
            else:
                usable[self._index[landmark]] = float(wrap(beta + self._camera_yaw))
        return usable

    def _innovations(
        self, seen: Mapping[int, float], active: np.ndarray, out: Mapping[str, np.ndarray]
    ) -> tuple[Innovation, ...]:
        """Return those of the landmarks that had been seen before, and count what was left out."""
        if len(seen) < self._carrier.minimum_visible:
            self.counts.reject(Rejection.TOO_FEW, len(seen))
            return ()
        innovations = tuple(
            Innovation(
                self._ids[i],
                float(out["innovation"][i]),
                math.sqrt(max(float(out["innovation_variance"][i]), 0.0)),
                bool(out["accepted"][i]),
            )
            for i in seen
            if active[i]
        )
        self.counts.reject(Rejection.OUTSIDE_GATE, sum(not i.accepted for i in innovations))
        return innovations

    def _estimate(self, t: float, belief: Any, innovations: tuple[Innovation, ...]) -> Estimate:
        status, reason = self._status(t)
        return Estimate(t, status, reason, *self._carrier.pose(belief), innovations)

    def _status(self, t: float) -> tuple[Status, str]:
        agreeing = int(self._agrees.sum())
        age, silent = t - self._last_seen, t - self._twist_t
        if math.isinf(age):
            return Status.UNVERIFIED, "start prior and odometry alone: no landmark of home seen yet"
        if silent > self._hold.seconds:
            return Status.UNVERIFIED, "no odometry: only its uncertainty grows"
        if 2 * sum(self._recent) < len(self._recent):
            return Status.UNVERIFIED, f"most of the last {len(self._recent)} sightings do not fit"
        if agreeing < MIN_AGREEING:
            return Status.UNVERIFIED, too_few_agree(agreeing)
        if age > NO_BEARINGS_S:
            return Status.COASTING, Reason.NO_BEARINGS.words
        return Status.LOCALISED, f"{agreeing} home bearings agree"
