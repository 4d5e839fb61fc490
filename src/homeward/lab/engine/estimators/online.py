"""A filter as an online estimator: twists and sightings in, an `Estimate` out."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from homeward.errors import InputError
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
from homeward.lab.filters.backend import FilterBackend
from homeward.lab.filters.settings import Engine
from homeward.odometry.validity import TwistValidity
from homeward.reasons import Reason, Rejection, too_few_agree

RECENT = 20
"""Number of last sightings among which the rejected ones are counted."""


class OnlineFilter:
    """A filter with a start prior as an `homeward.estimator.Estimator`.

    `name` is its name in commands and files. `landmarks` are in the order of the states; sightings
    of other landmarks are counted and not used. `camera_yaw` [rad] is added to every bearing, which
    then refers to the robot's heading. `notes` are assumptions to report to the user.
    """

    def __init__(
        self,
        name: str,
        backend: FilterBackend,
        landmarks: Sequence[str],
        camera_yaw: float,
        notes: tuple[str, ...] = (),
    ) -> None:
        self._backend = backend
        self.name, self.notes, self.counts = name, notes + backend.notes, Counts()
        self._turn = threading.RLock()
        self._ids = list(landmarks)
        self._index = {landmark: i for i, landmark in enumerate(self._ids)}
        self._camera_yaw = camera_yaw
        self._belief = self._backend.start()
        self._sightings = np.zeros(len(self._ids), dtype=int)
        self._t = math.nan
        self._twist: tuple[float, float] | None = None
        self._twist_t, self._hold = -math.inf, TwistValidity()
        self._last_seen = -math.inf
        self._agrees = np.zeros(len(self._ids), dtype=bool)
        self._recent: deque[bool] = deque(maxlen=RECENT)

    def __reduce__(self) -> str:
        """Refuse to be copied or pickled: compiled code is tied to the arrays of this object."""
        advice = "make another one, and add the same samples"
        raise InputError(f"{self.name} cannot be copied or pickled", advice=advice)

    @property
    def engine(self) -> Engine:
        """Executor: native or interpreter."""
        return self._backend.engine

    @property
    def ids(self) -> tuple[str, ...]:
        """Landmarks, in the order of the states."""
        return tuple(self._ids)

    @property
    def backend(self) -> FilterBackend:
        """Representation of the belief, and its steps."""
        return self._backend

    @guarded
    def odometry(self, t: float, v: float, omega: float) -> None:
        """Add a twist that is valid from `t` [s] on: `v` [m/s], `omega` [rad/s]; NaN: unknown."""
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
        """Add all sightings of stamp `t` [s] as one update; see `homeward.estimator`."""
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
        before, diverged = self._belief.active, self._backend.diverged
        self._belief, out = self._backend.update(self._belief, seen, own)
        lost = self._backend.diverged - diverged
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
        """Predict to `t` [s], or to the last sample if it is later; the belief does not change."""
        if math.isnan(self._t):
            return Estimate(t, Status.WAITING, Reason.NO_SAMPLES.words)
        now = max(t, self._t) if math.isfinite(t) else self._t
        return replace(self._estimate(now, self._predicted(now), ()), t=t)

    @guarded
    def landmarks(self) -> list[LandmarkEstimate]:
        """Return the estimates of the landmarks."""
        belief, stored = self._belief, self._backend.stored
        home, distances, sigmas = self._backend.landmarks(belief)
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
        """Predict the belief to `t` [s]; time starts with the first sample."""
        if math.isnan(self._t):
            self._t = t
        before = self._backend.diverged
        self._belief, self._t = self._predicted(t), t
        self.counts.reject(Rejection.DIVERGED, self._backend.diverged - before)

    def _predicted(self, t: float) -> Any:
        """Predict the belief to `t`: with the twist while it is valid, then without one."""
        held = min(max(self._twist_t + self._hold.seconds, self._t), t)
        belief = self._backend.predict(self._belief, held - self._t, self._twist)
        return self._backend.predict(belief, t - held, None)

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
        """Return the innovations of landmarks seen before, and count rejected sightings."""
        if len(seen) < self._backend.minimum_visible:
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
        return Estimate(t, status, reason, *self._backend.pose(belief), innovations)

    def _status(self, t: float) -> tuple[Status, str]:
        agreeing = int(self._agrees.sum())
        age, silent = t - self._last_seen, t - self._twist_t
        if math.isinf(age):
            return Status.UNVERIFIED, "start prior and odometry only: no landmark of home seen yet"
        if silent > self._hold.seconds:
            return Status.UNVERIFIED, "no odometry: the pose is kept and its uncertainty grows"
        if 2 * sum(self._recent) < len(self._recent):
            return Status.UNVERIFIED, f"most of the last {len(self._recent)} sightings do not fit"
        if agreeing < MIN_AGREEING:
            return Status.UNVERIFIED, too_few_agree(agreeing)
        if age > NO_BEARINGS_S:
            return Status.COASTING, Reason.NO_BEARINGS.words
        return Status.LOCALISED, f"{agreeing} home bearings agree"
