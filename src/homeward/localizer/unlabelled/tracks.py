"""Tracks: bearings of one unknown landmark, joined over a second by direction and parallax.

Directions are bearings plus the dead-reckoned heading, so that only parallax changes them. A track
is confirmed by three hits, and by their likelihood ratio against clutter (a sequential probability
ratio test; Wald, 1945). Only confirmed tracks reach the map.
"""

from __future__ import annotations

import math
from collections.abc import Container
from typing import NamedTuple

import numpy as np

from homeward.localizer.tunables import (
    ASSOCIATION_GATE,
    CLOSE,
    CLUTTER_KEPT,
    CONFIRMED,
    CONFIRMED_MEMORY,
    DETECTED,
    FALSE_AT_FIRST,
    MAX_FALSE,
    MIN_CLUTTER,
    MIN_HITS,
    MIN_SEEN,
    NEAR,
    NEAR_UNKNOWN_M,
    REFUTED,
    TRACK_DRIFT,
    TRACK_MEMORY_S,
    TRACK_TURN_ERROR,
)


class Instant(NamedTuple):
    """Dead reckoning at the stamp of a frame."""

    t: float
    """[s]"""
    place: tuple[float, float]
    """[m]"""
    heading: float
    """Not wrapped [rad]."""
    turn_rate: float
    """[rad/s]"""
    turned: float
    """Accumulated rotation [rad]."""
    late: float
    """Error of all bearings of the frame, by delay and jitter of the stamps [rad]."""


class Hit(NamedTuple):
    """A bearing of a track."""

    bearing: float
    """[rad]"""
    sigma: float
    """[rad]"""
    near: float
    """Smallest distance that its landmark may have [m]."""


class BearingTrack:
    """The recent bearings of one landmark, and its position relative to dead reckoning.

    The state of its Kalman filter is the direction from where it was first seen, and the inverse
    of the distance (Civera et al., 2008).
    """

    def __init__(self, name: str, kind: str, hint: str, now: Instant, seen: Hit) -> None:
        self.name = name
        """Id that the landmark has, or gets once the track is confirmed."""
        self.kind, self.hint = kind, hint
        """Class, and track number of the sensor; empty without one."""
        self.last = now
        """Dead reckoning at the last hit."""
        self.hits, self.score = 1, 0.0
        """Number of hits, and their log likelihood ratio against clutter."""
        self.is_confirmed = False
        self._anchor, self._direction = now.place, now.heading + seen.bearing
        self._inverse = 0.5 / seen.near
        self._covariance = seen.sigma**2, 0.0, self._inverse**2

    def add(self, now: Instant, seen: Hit, hint: str) -> None:
        """Add a hit."""
        bearing, variance, (a, b) = self._predict(now)
        xx, xy, yy = self._covariance
        xx += self._drift(now) ** 2
        gain_x, gain_y = (a * xx + b * xy), (a * xy + b * yy)
        total = variance + seen.sigma**2 + now.late**2
        off = math.remainder(seen.bearing - bearing, math.tau) / total
        self._direction += gain_x * off
        self._inverse = max(self._inverse + gain_y * off, 0.0)
        rest = xx - gain_x**2 / total, xy - gain_x * gain_y / total, yy - gain_y**2 / total
        self._covariance = rest
        self.last, self.hint = now, hint
        self.hits += 1

    def deviation(self, now: Instant, sigma: float) -> float:
        """Return the standard deviation of a new bearing from its prediction [rad]."""
        return math.sqrt(self._predict(now)[1] + now.late**2 + sigma**2)

    def predicted(self, now: Instant) -> tuple[float, float]:
        """Return its bearing, and the variance of that, without the noise of a new one."""
        return self._predict(now)[:2]

    def _drift(self, now: Instant) -> float:
        """Return the error of dead-reckoned directions since the last hit [rad]."""
        elapsed, turned = now.t - self.last.t, now.turned - self.last.turned
        return TRACK_DRIFT * elapsed + TRACK_TURN_ERROR * turned

    def _predict(self, now: Instant) -> tuple[float, float, tuple[float, float]]:
        """Return bearing, its variance, and its Jacobian by the state."""
        c, s = math.cos(self._direction), math.sin(self._direction)
        dx, dy = self._anchor[0] - now.place[0], self._anchor[1] - now.place[1]
        x, y = c + self._inverse * dx, s + self._inverse * dy
        square = max(x * x + y * y, CLOSE**2)
        a, b = (x * c + y * s) / square, (x * dy - y * dx) / square
        xx, xy, yy = self._covariance
        xx += self._drift(now) ** 2
        variance = a * a * xx + 2.0 * a * b * xy + b * b * yy
        return math.remainder(math.atan2(y, x) - now.heading, math.tau), variance, (a, b)


class Clutter:
    """Density of false bearings, detection of landmarks, and field of view, of one camera."""

    def __init__(self) -> None:
        self.per_frame, self.detected = FALSE_AT_FIRST, DETECTED
        self._seen = MIN_SEEN
        self._low, self._high = math.inf, -math.inf

    @property
    def width(self) -> float:
        """Width of the field of view [rad]."""
        return max(self._high - self._low, MIN_CLUTTER)

    def is_in_view(self, bearing: float) -> bool:
        """Return whether a bearing [rad] is within the field of view."""
        return self._low < bearing < self._high

    def add_frame(self, bearings: np.ndarray, false: int, hits: int, misses: int) -> None:
        """Add a frame of m bearings: some false ones ended, live landmarks were hit or missed."""
        self._low = min(self._low, float(bearings.min()))
        self._high = max(self._high, float(bearings.max()))
        self._seen += (bearings.size - self._seen) * CLUTTER_KEPT
        self.per_frame += (false - self.per_frame) * CLUTTER_KEPT
        if hits + misses:
            self.detected += (hits / (hits + misses) - self.detected) * CLUTTER_KEPT

    def hit(self, sigma: float) -> float:
        """Log likelihood ratio of a hit within a standard deviation [rad]."""
        return math.log(self.detected / self._in_gate(sigma))

    def miss(self, sigma: float) -> float:
        """Log likelihood ratio of a miss."""
        return math.log((1.0 - min(self.detected, DETECTED)) / (1.0 - self._in_gate(sigma)))

    def _in_gate(self, sigma: float) -> float:
        """Return the probability of a false bearing in a gate."""
        false = min(self.per_frame, MAX_FALSE * self._seen)
        density = max(false, MIN_CLUTTER) / self.width
        return min(2.0 * ASSOCIATION_GATE * sigma * density, 0.5)


class Tracks:
    """The live tracks of one camera, by name."""

    def __init__(self) -> None:
        self.live: dict[str, BearingTrack] = {}
        self.refuted: list[str] = []
        """Tracks that end with this frame."""
        self.clutter = Clutter()

    def forget(self, t: float, mapped: Container[str]) -> int:
        """Drop the tracks that were not hit recently before `t` [s]; return how many were false.

        A confirmed one lasts longer until its landmark is mapped: it would get another id.
        """
        kept, false = {}, 0
        for name, track in self.live.items():
            is_new = track.is_confirmed and name not in mapped
            memory = TRACK_MEMORY_S * (CONFIRMED_MEMORY if is_new else 1.0)
            if t - track.last.t <= memory and name not in self.refuted:
                kept[name] = track
            else:
                false += track.hits < MIN_HITS
        self.live, self.refuted = kept, []
        return false

    def tentative(self) -> list[BearingTrack]:
        """Return the tracks that are not confirmed."""
        return [x for x in self.live.values() if not x.is_confirmed]

    def test(self, track: BearingTrack, sigma: float, is_hit: bool) -> None:
        """Test a tentative track against clutter after a hit or a miss."""
        track.score += self.clutter.hit(sigma) if is_hit else self.clutter.miss(sigma)
        track.is_confirmed = track.hits >= MIN_HITS and track.score > CONFIRMED
        if track.score < REFUTED:
            self.refuted.append(track.name)


def nearest_distance(scale: float) -> float:
    """Return the smallest expected distance of a landmark [m], by the median of the mapped ones."""
    return NEAR * scale if math.isfinite(scale) else NEAR_UNKNOWN_M
