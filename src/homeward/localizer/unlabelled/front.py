"""The front of the localiser: sightings without ids get the ids of landmarks of its map."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.geometry.angles import wrap
from homeward.localizer.chart import Chart
from homeward.localizer.inputs.reorder import BearingFrame
from homeward.localizer.motions import HEAD
from homeward.localizer.tunables import (
    ANCHOR_S,
    ANCHORED,
    ASSOCIATION_MARGIN,
    BORN_APART,
    BREAKS,
    CLOSE,
    CONFIRMED_AGAIN,
    FIT_AGAIN,
    GHOST,
    INLIER,
    LINEAR,
    LINK_FRAMES,
    LINK_SHARE,
    LOST_S,
    MAX_SHARP,
    MIN_EXPECTED,
    MIN_HITS,
    MIN_MISSES,
    MINIMAL,
    NATS_APART,
    NOT_LIVE,
    NUM_DISTANCES,
    REACH,
    REPAIR_S,
    SEARCH_LOST_S,
    TOGETHER,
    TURN_JITTER_S,
    TURN_LAG_S,
)
from homeward.localizer.unlabelled.association import Association, Forecast, associate
from homeward.localizer.unlabelled.constellation import Sky, search
from homeward.localizer.unlabelled.home import HomeFinder, may_be, relative_places
from homeward.localizer.unlabelled.tracks import (
    BearingTrack,
    Hit,
    Instant,
    Tracks,
    nearest_distance,
)
from homeward.odometry.history import Reckoned
from homeward.reasons import Reason, Rejection
from homeward.sighting_keys import TRACK, class_of, is_unlabelled

NAME = "~"
"""Sign in the ids of landmarks without an id of their own, between class and number."""


class UnlabelledLandmarks:
    """Landmarks without ids: tracks, association, home and repair of the map."""

    def __init__(self, home: Mapping[str, HomeBearing]) -> None:
        self.home = HomeFinder(home)
        self.at = -math.inf
        """Time of the newest frame with sightings without ids [s], ..."""
        self.names: dict[str, str] = {}
        """... and the landmarks of its sightings, by key."""
        self.aliases: dict[str, str] = {}
        """Landmarks that turned out to be others, which have a longer history; empty for none."""
        self._kinds: dict[str, str] = {}
        self._seen: dict[str, list[int]] = {}
        """Hits and misses of mapped landmarks."""
        self._tracks: dict[str, Tracks] = {}
        self._born = 0
        self._together: Counter[tuple[str, str]] = Counter()
        self._lost_at, self._searched_at, self._repaired_at = math.inf, -math.inf, -math.inf
        self._anchored: set[str] = set()
        """Landmarks whose positions relative to those of home are proven."""
        self._recent: deque[tuple[float, str]] = deque()
        """Times and landmarks of the newest sightings; empty for none."""
        self._in_frame: list[str] = []
        """Landmarks of those of the last frame."""
        self._before_loss: set[str] = set()
        """Landmarks that were mapped when the robot was lost."""
        self._breaks, self._turn_rate = 0, 0.0
        self._distances: deque[float] = deque(maxlen=NUM_DISTANCES)
        self.reach = math.inf
        """Distance within which most landmarks are seen [m]."""

    @property
    def is_lost(self) -> bool:
        """Whether sightings do not fit the map since a short time."""
        return self._lost_at < math.inf

    @property
    def doubt(self) -> Reason | None:
        """Why a pose is not verified, if it is not."""
        if not self._seen:  # all landmarks have ids
            return None
        seen = [n for _, n in self._recent]
        anchored = [n for n in seen if n in self._anchored]
        few = len({*anchored}) < MINIMAL or len(anchored) < ANCHORED * len(seen)
        is_doubtful = self.is_lost or self._breaks > 0 or few
        return Reason.NO_CONSTELLATION if is_doubtful else None

    def identify(
        self, frame: BearingFrame, here: Reckoned, turn_rate: float, chart: Chart
    ) -> BearingFrame:
        """Return a frame in which sightings have the ids of landmarks; others are left out.

        `here` is dead reckoning at its stamp.
        """
        keys = [k for k in frame.sightings if is_unlabelled(k)]
        self.at, self.names = frame.t, {}
        if keys:
            with_id = {n: b for n, b in frame.sightings.items() if not is_unlabelled(n)}
            pose, turned = here.pose, here.driven.turned
            place = float(pose.x), float(pose.y)
            late = TURN_LAG_S * abs(turn_rate - self._turn_rate) + TURN_JITTER_S * abs(turn_rate)
            self._turn_rate += (turn_rate - self._turn_rate) * 0.5
            now = Instant(frame.t, place, float(pose.heading), turn_rate, turned, late)
            bearings = np.array([frame.sightings[k] for k in keys])
            sigma = chart.noise.to_distinguish
            sigmas = np.array([frame.sigmas.get(k, sigma) for k in keys])
            seen = UnlabelledFrame(now, keys, bearings, sigmas, float(np.median(sigmas)))
            self.names = self._identified(seen, frame, with_id, chart)
            chart.counts.reject(Rejection.UNIDENTIFIED, len(keys) - len(self.names))
            together = sorted({*with_id, *self.names.values()})
            self._together.update(combinations(together, 2))
        if not keys:
            return frame
        self._in_frame = [self.names.get(k, "" if is_unlabelled(k) else k) for k in frame.sightings]
        name = {k: self.names.get(k, None if is_unlabelled(k) else k) for k in frame.sightings}

        def renamed(values: Mapping) -> dict:  # type: ignore[type-arg]
            return {n: values[k] for k, n in name.items() if n is not None and k in values}

        return frame._replace(
            sightings=renamed(frame.sightings),
            sigmas=renamed(frame.sigmas),
            ranges=renamed(frame.ranges),
        )

    def _identified(
        self, seen: UnlabelledFrame, frame: BearingFrame, with_id: Mapping[str, float], chart: Chart
    ) -> dict[str, str]:
        """Return the landmarks of sightings without ids."""
        tracks, keys = self._tracks.setdefault(frame.camera, Tracks()), seen.keys
        false = tracks.forget(frame.t, chart.map.landmarks.mapped)
        names, forecast = self._forecast(frame, with_id, seen, tracks, chart)
        allowed = may_be(keys, names, self._kinds) if names else np.zeros((len(keys), 0), bool)
        allowed[:, [n in with_id for n in names]] = False
        tentative = {x.name for x in tracks.tentative()} - chart.map.landmarks.mapped.keys()
        allowed[:, [n in tentative for n in names]] = False
        self._use_hints(seen, names, tracks, allowed)
        penalty = self._penalties(names, tracks, chart)
        found = associate(forecast, seen.bearings, seen.variances, allowed, penalty)
        if self._is_broken(seen, names, found, tracks, chart):
            again = self._search_again(seen, tracks, chart)
            if again or seen.t - self._lost_at <= LOST_S:
                return again
        matched = {keys[i]: names[j] for i, j in enumerate(found.landmark.tolist()) if j >= 0}
        near = self._is_near(found, names, seen, tracks)
        false += int(np.count_nonzero((found.landmark < 0) & near))
        free = (found.landmark < 0) & ~near
        for i, track in self._continued(seen, found, names, np.flatnonzero(free), tracks).items():
            matched[keys[i]] = track.name
            free[i] = False
        self._count_ghosts(found, names, tracks, chart)
        live = {
            n for n, x in tracks.live.items()
            if x.hits >= MIN_HITS and n in names
            and tracks.clutter.is_in_view(float(found.forecast.mean[names.index(n)]))
        } if len(keys) > 1 else set()  # fmt: skip
        hits = len(live & set(matched.values()))
        tracks.clutter.add_frame(seen.bearings, false, hits, len(live) - hits)
        return self._updated(seen, matched, np.flatnonzero(free), tracks, chart)

    def _forecast(
        self,
        frame: BearingFrame,
        with_id: Mapping[str, float],
        seen: UnlabelledFrame,
        tracks: Tracks,
        chart: Chart,
    ) -> tuple[list[str], Forecast]:
        """Return the predicted bearings of mapped landmarks and of confirmed tracks."""
        predicted = chart.predict(frame.t, frame.offset)
        kept = [i for i, n in enumerate(predicted.landmarks) if n not in self.aliases]
        names = [predicted.landmarks[i] for i in kept]
        mean, covariance = predicted.bearings[kept], predicted.covariance[np.ix_(kept, kept)]
        forecast = Forecast(mean, covariance)
        at = {n: i for i, n in enumerate(names)}
        if known := [n for n in with_id if n in at]:
            index = np.array([at[n] for n in known])
            sigma = np.array([frame.sigmas.get(n, chart.noise.sigma) for n in known])
            values = np.array([with_id[n] for n in known])
            fits = forecast.squares(values, sigma**2)[0][np.arange(len(known)), index]
            use = fits < INLIER**2
            if use.any():
                forecast = forecast.conditioned(index[use], values[use], sigma[use] ** 2)
        added, fused = [], []
        variance = forecast.covariance.diagonal()
        for name, track in tracks.live.items():
            bearing, own = track.predicted(seen.now)
            i = at.get(name)
            if i is None:
                added.append((name, bearing, own))
            elif track.is_confirmed and variance[i] > 4.0 * (own + seen.now.late**2):
                fused.append((i, bearing, own + seen.now.late**2))
        if fused:
            forecast = _fused(forecast, fused)
        if added:
            n, k = len(names), len(added)
            covariance = np.zeros((n + k, n + k))
            covariance[:n, :n] = forecast.covariance
            covariance[n:, n:] = np.diag([v for _, _, v in added]) + seen.now.late**2
            mean = np.concatenate([forecast.mean, [b for _, b, _ in added]])
            names, forecast = [*names, *(a for a, _, _ in added)], Forecast(mean, covariance)
        return names, forecast

    def _penalties(self, names: list[str], tracks: Tracks, chart: Chart) -> np.ndarray:
        """Return a penalty for each landmark (n,): those seen just before are seen again."""
        known = chart.map.landmarks
        away = known.distances(known.mapped)
        distance = np.array([away.get(n, 0.0) for n in names])
        beyond = np.maximum(distance / self.reach - 1.0, 0.0) / LINEAR
        penalty = np.minimum(2.0 * beyond**2, ASSOCIATION_MARGIN) + NOT_LIVE
        return np.where([n in tracks.live for n in names], 0.0, penalty)

    def _use_hints(
        self, seen: UnlabelledFrame, names: list[str], tracks: Tracks, allowed: np.ndarray
    ) -> None:
        """Let the track numbers of a sensor decide, where a live track has the same one."""
        hinted = {x.hint: x.name for x in tracks.live.values() if x.hint}
        for i, key in enumerate(seen.keys):
            if key.startswith(TRACK) and (name := hinted.get(key)) in names:
                j = names.index(str(name))
                allowed[:, j] = False
                allowed[i] = False
                allowed[i, j] = True

    def _count_ghosts(
        self, found: Association, names: list[str], tracks: Tracks, chart: Chart
    ) -> None:
        """Count hits and misses of mapped landmarks; those that are hardly ever seen are none."""
        known, hits = chart.map.landmarks, set(found.landmark.tolist())
        away = known.distances(known.mapped)
        mean, variance = found.forecast.mean.tolist(), found.forecast.covariance.diagonal()
        for j, name in enumerate(names):
            if NAME not in name or name not in away:
                continue
            count = self._seen.setdefault(name, [0, 0])
            if j in hits:
                count[0] += 1
            elif away[name] < 0.8 * self.reach and variance[j] < MAX_SHARP**2:
                count[1] += tracks.clutter.is_in_view(mean[j])
                if count[1] > MIN_MISSES and count[0] < GHOST * count[1]:
                    self.aliases[name] = ""
                    tracks.live.pop(name, None)

    def _is_near(
        self, found: Association, names: list[str], seen: UnlabelledFrame, tracks: Tracks
    ) -> np.ndarray:
        """Return which bearings (m,) are close to one of an unseen landmark: no new landmark.

        Landmarks whose prediction is vague do not count: if the new one is one of them, both are
        merged once the map is precise.
        """
        if not names:
            return np.zeros(seen.bearings.size, bool)
        squares, variance = found.forecast.squares(seen.bearings, seen.variances)
        free = ~np.isin(np.arange(len(names)), found.landmark)
        live = np.array([n in tracks.live and tracks.live[n].is_confirmed for n in names])
        tentative = np.array([n in tracks.live and not tracks.live[n].is_confirmed for n in names])
        free &= ~tentative
        close = (squares < BORN_APART**2) & ((variance < MAX_SHARP**2) | live) & free
        return np.asarray(close.any(axis=1))

    def _continued(
        self,
        seen: UnlabelledFrame,
        found: Association,
        names: list[str],
        rows: np.ndarray,
        tracks: Tracks,
    ) -> dict[int, BearingTrack]:
        """Return the tentative tracks that bearings continue, by row."""
        tentative = [x for x in tracks.tentative() if x.name in names]
        if not tentative or not rows.size:
            return {}
        at = np.array([names.index(x.name) for x in tentative])
        forecast = found.forecast
        forecast = Forecast(forecast.mean[at], forecast.covariance[np.ix_(at, at)])
        allowed = np.array(
            [[class_of(seen.keys[i]) == x.kind for x in tentative] for i in rows], bool
        )
        for a, i in enumerate(rows):
            if seen.keys[i].startswith(TRACK):
                same = np.array([x.hint == seen.keys[i] for x in tentative])
                allowed[a] = same if same.any() else allowed[a]
        pairs = associate(forecast, seen.bearings[rows], seen.variances[rows], allowed)
        return {int(rows[a]): tentative[j] for a, j in enumerate(pairs.landmark.tolist()) if j >= 0}

    def _updated(
        self,
        seen: UnlabelledFrame,
        matched: Mapping[str, str],
        free: np.ndarray,
        tracks: Tracks,
        chart: Chart,
    ) -> dict[str, str]:
        """Update the tracks by a frame; return the landmarks of sightings that reach the map."""
        mapped, result = chart.map.landmarks.mapped, {}
        near = nearest_distance(chart.map.smoother.state.scale)
        for i, key in enumerate(seen.keys):
            name = matched.get(key)
            if name is None:
                continue
            hint = key if key.startswith(TRACK) else ""
            track, hit = tracks.live.get(name), seen.hit(i, near)
            if track is None:
                kind = class_of(key)
                track = BearingTrack(name, kind, hint, seen.now, hit)
                tracks.live[name] = track
                spread = math.hypot(seen.sigma, seen.sigmas[i])
            else:
                spread = track.deviation(seen.now, seen.sigma)
                track.add(seen.now, hit, hint)
            if kind := class_of(key):
                self._kinds.setdefault(name, kind)
            if not track.is_confirmed:
                tracks.test(track, spread, True)
                if name in mapped:
                    track.is_confirmed = track.score > CONFIRMED_AGAIN
            if track.is_confirmed:
                result[key] = name
        if len(seen.keys) > 1:
            for track in [x for x in tracks.tentative() if x.last.t < seen.now.t]:
                if tracks.clutter.is_in_view(track.predicted(seen.now)[0]):
                    tracks.test(track, seen.sigma, False)
        for i in free:
            self._begin_track(seen, int(i), near, tracks)
        return result

    def _begin_track(self, seen: UnlabelledFrame, i: int, near: float, tracks: Tracks) -> None:
        """Begin a track, unless another bearing is too close to distinguish them."""
        off = np.abs(wrap(np.delete(seen.bearings, i) - seen.bearings[i]))
        if off.size and off.min() < INLIER * seen.sigmas[i]:
            return
        key = seen.keys[i]
        self._born += 1
        name = f"{class_of(key)}{NAME}{self._born}"
        hint = key if key.startswith(TRACK) else ""
        tracks.live[name] = BearingTrack(name, class_of(key), hint, seen.now, seen.hit(i, near))

    def _is_broken(
        self,
        seen: UnlabelledFrame,
        names: list[str],
        found: Association,
        tracks: Tracks,
        chart: Chart,
    ) -> bool:
        """Return whether most landmarks in view disappeared at once: the robot may be elsewhere."""
        mapped = chart.map.landmarks.mapped
        fits = [names[j] for j in found.landmark.tolist() if j >= 0]
        if self.is_lost:
            old = sum(n in self._before_loss for n in fits)
            if old >= MINIMAL and old > FIT_AGAIN * len(seen.keys):
                self._end_search(chart)
        else:
            expected = self._expected(found, names, tracks, chart)
            hits = sum(n in expected for n in fits) + int(np.count_nonzero(found.is_held))
            total = sum(expected.values())
            broken = hits <= (1.0 - FIT_AGAIN) * total
            enough = total >= MIN_EXPECTED and len(seen.keys) >= MINIMAL
            self._breaks = self._breaks + 1 if broken and enough else 0
            if self._breaks >= BREAKS:
                self._lost_at, self._before_loss = seen.t, set(mapped)
        return self.is_lost

    def _expected(
        self, found: Association, names: list[str], tracks: Tracks, chart: Chart
    ) -> dict[str, float]:
        """Return the landmarks that the map expects in a frame, with their detection rates."""
        known, mean = chart.map.landmarks, found.forecast.mean.tolist()
        away = known.distances(known.mapped)
        is_sharp = found.forecast.covariance.diagonal() < MAX_SHARP**2
        expected = {}
        for j, name in enumerate(names):
            hits, misses = self._seen.get(name, (0, 0))
            is_live = name in tracks.live and tracks.live[name].is_confirmed
            is_known = hits >= MIN_MISSES and away.get(name, math.inf) < 0.8 * self.reach
            is_expected = name in away and (is_live or (is_known and is_sharp[j]))
            if is_expected and tracks.clutter.is_in_view(mean[j]):
                expected[name] = (hits + 1.0) / (hits + misses + 1.0)
        return expected

    def _end_search(self, chart: Chart) -> None:
        """End the search: landmarks that began during it are mapped elsewhere than they are."""
        if self._before_loss:
            new = chart.map.landmarks.mapped.keys() - self._before_loss
            self.aliases |= {n: "" for n in new if NAME in n}
        self._lost_at, self._breaks, self._before_loss = math.inf, 0, set()

    def _search_again(self, seen: UnlabelledFrame, tracks: Tracks, chart: Chart) -> dict[str, str]:
        """Search for the constellation of a frame in the map; return its landmarks, if unique."""
        if seen.t - self._searched_at < SEARCH_LOST_S:
            return {}
        self._searched_at = seen.t
        known = self._before_loss & chart.map.landmarks.mapped.keys()
        names = [n for n in chart.map.landmarks.mapped if n in known and n not in self.aliases]
        if len(names) < MINIMAL or len(seen.keys) <= MINIMAL:
            return {}
        points, covariances = relative_places(chart, names)
        allowed = may_be(seen.keys, names, self._kinds)
        state = chart.map.smoother.state
        near = float(state.mean[0]), float(state.mean[1]), CLOSE * INLIER * state.scale
        lines = seen.bearings, seen.variances, allowed
        found = search(Sky(points, covariances, *lines, self.reach, near))
        if found is None or min(found.margin, found.best.log_evidence) < NATS_APART:
            return {}
        self._end_search(chart)
        tracks.live.clear()
        pairs = enumerate(found.best.landmark.tolist())
        matched = {seen.keys[i]: names[j] for i, j in pairs if j >= 0}
        for i, key in enumerate(seen.keys):
            if key in matched:
                name, hit = matched[key], seen.hit(i, chart.map.smoother.state.scale)
                track = BearingTrack(name, class_of(key), "", seen.now, hit)
                track.is_confirmed = True
                tracks.live[name] = track
        return matched

    def after_frame(self, t: float, chart: Chart) -> bool:
        """Repair the map and find home, where due; return whether home bearings changed."""
        if t - self._repaired_at >= REPAIR_S:
            self._repaired_at = t
            if self._distances:
                self.reach = float(np.quantile(self._distances, REACH))
            changed = self._merge(chart)
            self._anchor(chart)
        else:
            changed = False
        mapped = chart.map.landmarks.mapped
        usable = {n: self._kinds.get(n, "") for n in mapped if n not in self.aliases}
        self._recent.extend((t, n) for n in self._in_frame)
        while self._recent and self._recent[0][0] < t - ANCHOR_S:
            self._recent.popleft()
        self._distances.extend(chart.map.landmarks.distances(self.names.values()).values())
        return self.home.update(t, chart, usable, self.reach) or changed

    def _anchor(self, chart: Chart) -> None:
        """Anchor the landmarks that are often seen together with three anchored ones.

        Those of home are the first. If odometry or the robot has slipped, landmarks mapped later
        are seen with the former ones by chance only, and are not anchored.
        """
        of_home = set(self.home.named()) & chart.map.landmarks.mapped.keys()
        self._anchored = of_home if not of_home & self._anchored else self._anchored | of_home
        self._anchored -= self.aliases.keys()
        open_ = {n for n in chart.map.landmarks.mapped if n not in self.aliases} - self._anchored
        grown = True
        while grown:
            new = {n for n in open_ if self._is_linked(n)}
            self._anchored |= new
            open_ -= new
            grown = bool(new)

    def _is_linked(self, name: str) -> bool:
        """Return whether a landmark is often seen together with three anchored ones."""
        least = max(LINK_FRAMES, LINK_SHARE * self._seen.get(name, [0, 0])[0])
        pairs = (tuple(sorted((name, other))) for other in self._anchored)
        return sum(self._together[a, b] >= least for a, b in pairs) >= MINIMAL

    def _merge(self, chart: Chart) -> bool:
        """Merge landmarks at one place that were never seen together; return whether home changes.

        The younger one becomes an alias of the older one.
        """
        mapped, state = chart.map.landmarks.mapped, chart.map.smoother.state
        names = [n for n in mapped if n not in self.aliases]
        if len(names) <= MINIMAL:
            return False
        places, ids = chart.map.landmarks.positions(names), chart.map.landmarks.ids(names)
        off = places[:, None] - places
        distance = np.hypot(off[..., 0], off[..., 1])
        close = np.argwhere(np.triu(distance < CLOSE * 3 * state.scale, 1))
        changed = False
        for i, j in close.tolist():
            old, new = names[i], names[j]
            if new in self.aliases or old in self.aliases or NAME not in new:
                continue
            first, second = sorted((old, new))
            if self._together[first, second] > TOGETHER:
                continue
            if len({self._kinds.get(n, "") for n in (old, new)} - {""}) > 1:
                continue
            joint = chart.map.smoother.all_landmarks.joint(ids[[i, j]]).covariance[HEAD:, HEAD:]
            difference = np.hstack([np.eye(2), -np.eye(2)])
            covariance = difference @ joint @ difference.T
            covariance += (CLOSE * state.scale / 10) ** 2 * np.eye(2)
            if math.sqrt(float(np.linalg.eigvalsh(covariance)[-1])) > CLOSE * state.scale:
                continue
            if off[i, j] @ np.linalg.solve(covariance, off[i, j]) < INLIER**2:
                self.aliases[new] = old
                changed = changed or new in self.home.assigned.values()
                self.home.rename(new, old)
                for tracks in self._tracks.values():
                    if (track := tracks.live.pop(new, None)) is not None:
                        track.name = old
                        tracks.live.setdefault(old, track)
        return changed


class UnlabelledFrame(NamedTuple):
    """Sightings without ids of one frame."""

    now: Instant
    keys: list[str]
    bearings: np.ndarray
    """(m,) [rad]"""
    sigmas: np.ndarray
    """(m,): their standard deviations [rad] ..."""
    sigma: float
    """... and the median of these."""

    @property
    def t(self) -> float:
        """Stamp [s]."""
        return self.now.t

    def hit(self, i: int, near: float) -> Hit:
        """Return one of them for a track."""
        return Hit(float(self.bearings[i]), float(self.sigmas[i]), near)

    @property
    def variances(self) -> np.ndarray:
        """Variances of the bearings, (m,) [rad^2]."""
        return np.asarray(self.sigmas**2)


def _fused(forecast: Forecast, tracks: list[tuple[int, float, float]]) -> Forecast:
    """Return a forecast with the predictions of tracks: index, bearing [rad] and variance.

    Where both contradict each other, that of the track counts.
    """
    index = np.array([i for i, _, _ in tracks])
    bearings, variances = (np.array([t[k] for t in tracks]) for k in (1, 2))
    square = wrap(bearings - forecast.mean[index]) ** 2
    fits = square < 16.0 * (forecast.covariance[index, index] + variances)
    if fits.any():
        forecast = forecast.conditioned(index[fits], bearings[fits], variances[fits])
    if (~fits).any():
        mean, covariance = forecast.mean.copy(), forecast.covariance.copy()
        rest = index[~fits]
        mean[rest] = bearings[~fits]
        covariance[rest], covariance[:, rest] = 0.0, 0.0
        covariance[rest, rest] = variances[~fits]
        forecast = Forecast(mean, covariance)
    return forecast
