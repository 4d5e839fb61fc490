"""Tracks: landmarks seen by one camera, in its local map, whether the chart has mapped them or not.

A track is confirmed by three hits, and by their likelihood ratio against clutter (a sequential
probability ratio test; Wald, 1945). Only confirmed tracks reach the chart's map. They stay in the
local map while their landmark is out of view, so that it is identified when it is seen again.
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from homeward.geometry.se2 import between, compose
from homeward.localizer.tunables import (
    ASSOCIATION_GATE,
    CLUTTER_KEPT,
    CONFIRMED_AGAIN,
    DETECTED,
    DUPLICATE_MARGIN,
    DUPLICATE_SIGMAS,
    FALSE_AT_FIRST,
    INLIER,
    LIVE_S,
    MAX_FALSE,
    MAX_MISSES,
    MAX_PREDICTED_SIGMA,
    MAX_TRACKS,
    MIN_CLUTTER,
    MIN_HITS,
    MIN_SEEN,
    NATS_APART,
    NEAR,
    NEAR_UNKNOWN_M,
    NOT_LIVE,
    RECENT_S,
    REFUTED,
    SEARCH_S,
    TOGETHER,
    TRACK_MEMORY_S,
    UNKNOWN_RATES,
)
from homeward.localizer.unlabelled.association import PossiblePairs, associate
from homeward.localizer.unlabelled.local_map import LocalMap
from homeward.localizer.unlabelled.registry import in_order
from homeward.odometry.history import Driven, Reckoned, TwistHistory


@dataclass
class BearingTrack:
    """A landmark of the local map."""

    name: str
    """Id that the landmark has, or gets once the track is confirmed."""
    kind: str
    """Its class, empty without one, ..."""
    hint: str
    """... and track number of the sensor, empty without one."""
    t: float
    """Stamp of the last hit [s]."""
    begun: float
    """Stamp of the first one [s]."""
    hits: int = 1
    score: float = 0.0
    """Log likelihood ratio against clutter."""
    is_confirmed: bool = False
    misses: int = 0
    """Successive frames in which no bearing was near its predicted one, though it should be."""


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

    @property
    def density(self) -> float:
        """Density of bearings that belong to no known landmark [1/rad]."""
        return max(self._false, FALSE_AT_FIRST) / self.width

    @property
    def _false(self) -> float:
        """Number of false bearings in a frame."""
        return min(self.per_frame, MAX_FALSE * self._seen)

    def is_in_view(self, bearing: float) -> bool:
        """Return whether a bearing [rad] is within the field of view."""
        return self._low < bearing < self._high

    def add_bearings(self, bearings: np.ndarray) -> None:
        """Add the bearings (m,) of a frame [rad]."""
        self._low = min(self._low, float(bearings.min()))
        self._high = max(self._high, float(bearings.max()))
        self._seen += (bearings.size - self._seen) * CLUTTER_KEPT

    def add_frame(self, false: int, hits: int, misses: int) -> None:
        """Add that false tracks ended with a frame, and live landmarks were hit or missed."""
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
        density = max(self._false, MIN_CLUTTER) / self.width
        return min(2.0 * ASSOCIATION_GATE * sigma * density, 0.5)


class Instant(NamedTuple):
    """Dead reckoning at the stamp of a frame."""

    t: float
    """[s]"""
    pose: np.ndarray
    """(3,): of the robot."""
    driven: Driven
    turn_rate: float
    """[rad/s]"""
    unknown_s: float
    """Time for which the motion has been unknown [s]."""

    @classmethod
    def of(cls, t: float, here: Reckoned, twists: TwistHistory) -> Instant:
        """Return it from dead reckoning and twists at `t` [s]."""
        pose = np.array([here.pose.x, here.pose.y, here.pose.heading], float)
        twist = twists.before(t)
        turn_rate = 0.0 if twist is None else twist.omega
        return cls(t, pose, here.driven, turn_rate, twists.unknown_time(t))


class Tracks:
    """The tracks of one camera, in the order of its local map."""

    def __init__(self) -> None:
        self.clutter = Clutter()
        self.clear()

    def clear(self) -> None:
        """Begin without tracks."""
        self.tracks: list[BearingTrack] = []
        self.map = LocalMap()
        self._before: Instant | None = None
        self._nearest, self._joined_at = NEAR_UNKNOWN_M, -math.inf

    def names(self) -> list[str]:
        """Return their names."""
        return [x.name for x in self.tracks]

    def move(self, now: Instant, rates: np.ndarray, camera: np.ndarray) -> None:
        """Predict the motion up to a frame, by noise rates (3, 3), of a camera at a pose (3,)."""
        before, self._before = self._before, now
        if before is None:
            return
        motion = between(compose(before.pose, camera), compose(now.pose, camera))
        variances = rates @ np.array(now.driven.since(before.driven))
        unknown = min(now.unknown_s, now.t - before.t)
        self.map.move(motion, variances + unknown * np.array(UNKNOWN_RATES), now.turn_rate)

    def turn_change(self, now: Instant) -> float:
        """Return the change of the turn rate since the last frame [rad/s]."""
        return 0.0 if self._before is None else abs(now.turn_rate - self._before.turn_rate)

    def begin(self, track: BearingTrack, bearing: float, variance: float, scale: float) -> None:
        """Begin a track; `scale` is the median distance of mapped landmarks [m]."""
        self._nearest = NEAR * scale if math.isfinite(scale) else NEAR_UNKNOWN_M
        self.map.add(bearing, variance, self._nearest)
        self.tracks.append(track)

    def is_live(self, t: float) -> np.ndarray:
        """Return which tracks were hit just before `t` [s], (n,), bool."""
        return np.array([t - x.t <= LIVE_S for x in self.tracks], bool)

    def test(
        self, track: BearingTrack, sigma: float, is_hit: bool, is_mapped: bool = False
    ) -> None:
        """Test a tentative track against clutter after a hit or a miss."""
        track.score += self.clutter.hit(sigma) if is_hit else self.clutter.miss(sigma)
        enough = track.hits >= MIN_HITS and track.score > NATS_APART
        track.is_confirmed = enough or (is_mapped and track.score > CONFIRMED_AGAIN)

    def forget(self, t: float, aliases: Container[str]) -> int:
        """Drop tracks that are refuted, or too vague to be found again; return how many were false.

        One that is missed where it should be has a wrong position here: that of the chart's map is
        used instead.
        If there are too many, those are dropped that were not hit for longest.
        """
        vague = self.map.bearing_covariance.diagonal() > MAX_PREDICTED_SIGMA**2
        kept, false = [], 0
        for i, track in enumerate(self.tracks):
            weak = not track.is_confirmed
            if weak and (track.score < REFUTED or t - track.t > TRACK_MEMORY_S):
                false += track.hits < MIN_HITS
            elif track.name not in aliases and not vague[i] and track.misses <= MAX_MISSES:
                kept.append(i)
        if len(kept) > MAX_TRACKS:
            kept = sorted(sorted(kept, key=lambda i: -self.tracks[i].t)[:MAX_TRACKS])
        self._keep(kept)
        return false

    def _keep(self, kept: list[int]) -> None:
        if len(kept) < len(self.tracks):
            self.map.keep(kept)
            self.tracks = [self.tracks[i] for i in kept]

    def join_duplicates(
        self, t: float, together: Mapping[tuple[str, str], int]
    ) -> list[tuple[str, str]]:
        """Join tracks of one landmark; return the names of the newer and the older ones.

        A landmark that was found again is first a new track; its position in the local map, and
        those of others that were found again with it, show which old one it is. `together` counts
        the frames in which two were seen.
        """
        if t - self._joined_at < SEARCH_S:
            return []
        self._joined_at = t
        known = [i for i, x in enumerate(self.tracks) if x.is_confirmed and x.hits > MIN_HITS]
        pairs = [
            (i, j) for i in known if t - self.tracks[i].t < RECENT_S
            for j in known if self._may_be_one(self.tracks[i], self.tracks[j], together)
        ]  # fmt: skip
        if not pairs:
            return []
        new, old = np.array(pairs).T
        difference, covariance = self._offsets(new, old)
        (news, rows), (olds, columns) = (np.unique(x, return_inverse=True) for x in (new, old))
        penalty = np.full(len(new), NOT_LIVE)
        none = 2.0 * math.log(math.sqrt(math.tau) * 0.5 / self._nearest)
        found = associate(
            PossiblePairs(rows, columns, difference, covariance, penalty),
            (len(news), len(olds)), none, DUPLICATE_MARGIN,
        )  # fmt: skip
        joined, gone = [], set[int]()
        for row in np.flatnonzero(found.is_sure & (found.column >= 0)).tolist():
            i, j = int(news[row]), int(olds[found.column[row]])
            if i in gone or j in gone:
                continue
            newer, older = self.tracks[i], self.tracks[j]
            self.map.join(i, j, np.array(DUPLICATE_SIGMAS))
            older.t, older.hits = max(older.t, newer.t), older.hits + newer.hits
            older.hint, older.kind = newer.hint or older.hint, older.kind or newer.kind
            joined.append((newer.name, older.name))
            gone.add(i)
        self._keep([i for i in range(len(self.tracks)) if i not in gone])
        return joined

    def are_close(self, i: int, j: int) -> bool:
        """Return whether two landmarks may be at one place; one that has no track may be."""
        if max(i, j) >= len(self.tracks):
            return True
        difference, covariance = self._offsets(np.array([i]), np.array([j]))
        square = difference[0] @ np.linalg.solve(covariance[0, :, 0], difference[0])
        return bool(square < INLIER**2)

    def _offsets(self, new: np.ndarray, old: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return differences of landmarks that may be one; see `differences` of the map."""
        difference, covariance = self.map.differences(new, old)
        q = np.arange(len(new))
        for e, sigma in enumerate(DUPLICATE_SIGMAS):
            covariance[q, e, q, e] += sigma**2
        return difference, covariance

    def rename(self, new: str, old: str) -> None:
        """Rename the track of the landmark `new`, which turned out to be the landmark `old`."""
        at = {x.name: i for i, x in enumerate(self.tracks)}
        if new in at and old not in at:
            self.tracks[at[new]].name = old
        elif new in at:
            self._keep([i for i in range(len(self.tracks)) if i != at[new]])

    def _may_be_one(
        self, new: BearingTrack, old: BearingTrack, together: Mapping[tuple[str, str], int]
    ) -> bool:
        """Return whether a newer track may be of the landmark of an older one."""
        same_kind = not new.kind or not old.kind or new.kind == old.kind
        seen = together.get(in_order(new.name, old.name), 0)
        return old.begun < new.begun and old.t < new.t and same_kind and seen <= TOGETHER
