"""The front of the localiser: sightings without ids get the ids of landmarks of its map."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.geometry.angles import wrap
from homeward.localizer.chart import Chart
from homeward.localizer.inputs.reorder import BearingFrame
from homeward.localizer.tunables import (
    ASSOCIATION_GATE,
    ASSOCIATION_MARGIN,
    INLIER,
    LINEAR,
    LOST_S,
    MAX_SHARP,
    MIN_HITS,
    MIN_MISSES,
    NATS_APART,
    NATS_DIFFERENT,
    NOT_LIVE,
    REPAIR_S,
    TENTATIVE,
    TOGETHER,
    TURN_JITTER_S,
)
from homeward.localizer.unlabelled.association import PossiblePairs, associate, chosen
from homeward.localizer.unlabelled.home import HomeFinder, may_be
from homeward.localizer.unlabelled.lost import Loss
from homeward.localizer.unlabelled.registry import NAME, Registry, in_order
from homeward.localizer.unlabelled.repair import Anchors, duplicates
from homeward.localizer.unlabelled.tracks import BearingTrack, Instant, Tracks
from homeward.odometry.history import Reckoned, TwistHistory
from homeward.reasons import Reason, Rejection
from homeward.sighting_keys import TRACK, class_of, is_unlabelled

EXPERIMENTAL_NOTE = (
    "Landmarks without ids are identified by the map. This is experimental: a pose may be localised"
    " and wrong for some seconds. Give ids or classes where you can."
)
NEVER_PROVEN_NOTE = (
    "No pose could be localised yet: home bearings have no ids, and may be of other landmarks, too."
    "{} Give ids or classes to some landmarks, also at home, or drive past those of home again."
)
NARROW_NOTE = (
    " The camera's view of {:.0f} degrees shows few landmarks at once; a wider one, or a second"
    " camera, distinguishes places sooner."
)


class UnlabelledLandmarks:
    """Landmarks without ids: tracks, association, home and repair of the map."""

    def __init__(self, home: Mapping[str, HomeBearing]) -> None:
        self.home = HomeFinder(home)
        self.known = Registry()
        self.at = -math.inf
        """Time of the newest frame with sightings without ids [s], ..."""
        self.names: dict[str, str] = {}
        """... and the landmarks of its sightings, by key."""
        self._tracks: dict[str, Tracks] = {}
        """By camera."""
        self._loss, self._anchors = Loss(), Anchors()
        self._repaired_at, self._is_home_renamed = -math.inf, False
        self._path = 0.0
        """Path length at that time [m]."""
        self._in_frame: list[str] = []
        """Landmarks of the last frame, empty for none."""

    @property
    def is_lost(self) -> bool:
        """Whether sightings do not fit the map since a short time."""
        return self._loss.at < math.inf

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
        reaches = NATS_APART - NATS_DIFFERENT  # of path, after which a home that fits is proven
        is_early = not self._tracks or self._path < reaches * self.known.reach
        if is_early or not self.home.is_needed or self.home.was_proven:
            return (EXPERIMENTAL_NOTE,)
        view = max(tracks.clutter.width for tracks in self._tracks.values())
        narrow = NARROW_NOTE.format(math.degrees(view)) if view < math.pi else ""
        return EXPERIMENTAL_NOTE, NEVER_PROVEN_NOTE.format(narrow)

    @property
    def doubt(self) -> Reason | None:
        """Why a pose is not verified, if it is not."""
        if not self.known.seen:  # all landmarks have ids
            return None
        if self._loss.is_suspected:
            return Reason.NO_CONSTELLATION
        if self.home.is_needed and not self.home.is_proven:
            return Reason.HOME_UNPROVEN
        return None if self._anchors.are_enough else Reason.NO_ANCHORS

    def identify(
        self, frame: BearingFrame, here: Reckoned, twists: TwistHistory, chart: Chart
    ) -> BearingFrame:
        """Return a frame in which sightings have the ids of landmarks; others are left out.

        `here` is dead reckoning at its stamp, by these twists.
        """
        keys = [k for k in frame.sightings if is_unlabelled(k)]
        self.at, self.names, self._path = frame.t, {}, here.driven.path
        if not keys and not self._tracks:
            return frame
        tracks = self._tracks.setdefault(frame.camera, Tracks())
        now = Instant.of(frame.t, here, twists)
        change = tracks.turn_change(now)
        tracks.move(now, chart.process_noise.rates, chart.map.camera_pose(frame.offset))
        for new, old in tracks.join_duplicates(frame.t, self.known.together):
            self._is_home_renamed |= self._rename(new, old, chart)
        late = TURN_JITTER_S * (change + abs(now.turn_rate))
        sigma = chart.noise.to_distinguish
        with_id = _seen(frame, [k for k in frame.sightings if k not in keys], sigma, late)
        self._add_with_ids(with_id, tracks, chart)
        if keys:
            seen = _seen(frame, keys, sigma, late)
            tracks.clutter.add_bearings(seen.bearings)
            self.names = self._identified(seen, frame, set(with_id.keys), tracks, chart)
            chart.counts.reject(Rejection.UNIDENTIFIED, len(keys) - len(self.names))
        name = {k: self.names.get(k, None if is_unlabelled(k) else k) for k in frame.sightings}
        self._in_frame = [n or "" for n in name.values()]

        def renamed(values: Mapping) -> dict:  # type: ignore[type-arg]
            return {n: values[k] for k, n in name.items() if n is not None and k in values}

        return frame._replace(
            sightings=renamed(frame.sightings),
            sigmas=renamed(frame.sigmas),
            ranges=renamed(frame.ranges),
        )

    def _add_with_ids(self, seen: SeenFrame, tracks: Tracks, chart: Chart) -> None:
        """Add sightings with ids to the local map: they show where the others are."""
        at = {x.name: i for i, x in enumerate(tracks.tracks)}
        for i, name in enumerate(seen.keys):
            if name in at:
                tracks.tracks[at[name]].t = seen.t
            else:
                track = BearingTrack(name, "", "", seen.t, seen.t, is_confirmed=True)
                tracks.begin(track, *seen.first(i), chart.map.smoother.state.scale)
        known = [i for i, name in enumerate(seen.keys) if name in at]
        of = np.array([at[seen.keys[i]] for i in known], int)
        variance = tracks.map.bearing_covariance.diagonal()[of] + seen.variances[known]
        off = wrap(seen.bearings[known] - tracks.map.bearings[of])
        fits = off**2 < INLIER**2 * (variance + seen.late**2)
        rows = np.array(known, int)[fits]
        if rows.size:
            lines = seen.bearings[rows], seen.variances[rows]
            tracks.map.add_bearings(of[fits], *lines, seen.late**2)

    def _identified(
        self,
        seen: SeenFrame,
        frame: BearingFrame,
        with_id: set[str],
        tracks: Tracks,
        chart: Chart,
    ) -> dict[str, str]:
        """Return the landmarks of sightings without ids."""
        forecast = self._forecast(frame, with_id, tracks, chart)
        hits, is_held, is_met = self._associated(seen, forecast, with_id, tracks, chart)
        if self._is_lost_now(seen, forecast, is_met, tracks, chart):
            again = self._found_again(seen, tracks, chart)
            if again or seen.t - self._loss.at <= LOST_S:
                return again
            forecast = self._forecast(frame, with_id, tracks, chart)
            hits, is_held, is_met = self._associated(seen, forecast, with_id, tracks, chart)
        self._count(forecast, is_met, {*hits.values()}, tracks, chart)
        return self._updated(seen, forecast, hits, is_held, tracks, chart)

    def _forecast(
        self, frame: BearingFrame, with_id: set[str], tracks: Tracks, chart: Chart
    ) -> Forecast:
        """Return the predicted bearings of tracks, and of mapped landmarks without a track."""
        names, local = tracks.names(), tracks.map
        mean, covariance = local.bearings, local.bearing_covariance
        excluded = self.known.aliases.keys() | {*names, *with_id}
        if chart.map.landmarks.mapped.keys() - excluded:
            predicted = chart.predict(frame.t, frame.offset)
            kept = [i for i, n in enumerate(predicted.landmarks) if n not in excluded]
            n, k = len(names), len(kept)
            whole = np.zeros((n + k, n + k))
            whole[:n, :n] = covariance
            whole[n:, n:] = predicted.covariance[np.ix_(kept, kept)]
            names += [predicted.landmarks[i] for i in kept]
            mean, covariance = np.concatenate([mean, predicted.bearings[kept]]), whole
        is_live, is_tentative = np.zeros((2, len(names)), bool)
        is_live[: len(tracks.tracks)] = tracks.is_live(frame.t)
        is_tentative[: len(tracks.tracks)] = [not x.is_confirmed for x in tracks.tracks]
        away = chart.map.landmarks.distances(names)
        inverse = np.maximum(local.inverse_distances, 1e-9).tolist()
        distance = np.array([away.get(n) or 1.0 / inverse[j] for j, n in enumerate(names)])
        return Forecast(names, mean, covariance, is_live, is_tentative, distance)

    def _associated(
        self, seen: SeenFrame, forecast: Forecast, with_id: set[str], tracks: Tracks, chart: Chart
    ) -> tuple[dict[int, str], np.ndarray, np.ndarray]:
        """Associate sightings with landmarks.

        Return the landmarks by sighting, which sightings (m,) may be of a known landmark without
        being sure, and to which landmarks (n,) any sighting is close, or has their id.
        """
        names = forecast.names
        allowed = may_be(seen.keys, names, self.known.kinds)
        has_id = np.array([n in with_id for n in names], bool)
        allowed[:, has_id] = False
        self._use_hints(seen, forecast, tracks, allowed)
        covariance = forecast.covariance + seen.late**2
        off = wrap(seen.bearings[:, None] - forecast.mean)
        variance = covariance.diagonal() + seen.variances[:, None]
        is_near = (off**2 < ASSOCIATION_GATE**2 * variance) & allowed
        rows, columns = np.nonzero(is_near & ~self._are_of_live(is_near, forecast, tracks))
        joint = covariance[np.ix_(columns, columns)]
        joint = joint + np.where(rows[:, None] == rows, seen.variances[rows], 0.0)
        penalty = self._penalties(forecast)[columns]
        residuals = off[rows, columns][:, None]
        pairs = PossiblePairs(rows, columns, residuals, joint[:, None, :, None], penalty)
        none, shape = -2.0 * math.log(tracks.clutter.density * math.sqrt(math.tau)), off.shape
        found = associate(pairs, shape, none, ASSOCIATION_MARGIN)
        sharp = forecast.is_live & ~forecast.is_tentative
        sharp &= forecast.covariance.diagonal() < MAX_SHARP**2
        is_held = ~found.is_sure
        is_held &= np.bincount(rows[sharp[columns]], minlength=len(seen.keys)) > 0
        column = found.column
        again = (~found.is_sure & ~is_held)[rows] & forecast.is_tentative[columns]
        again &= ~np.isin(columns, column)
        if again.any():  # nothing is lost if one of these is wrong
            guess = associate(chosen(pairs, again), shape, none, 0.0)
            column = np.where(guess.likely >= 0, guess.likely, column)
        hits = {i: names[j] for i, j in enumerate(column.tolist()) if j >= 0}
        return hits, is_held, is_near.any(axis=0) | has_id

    def _are_of_live(self, is_near: np.ndarray, forecast: Forecast, tracks: Tracks) -> np.ndarray:
        """Return which pairs (m, n) are of a landmark that may be that of a live track nearby.

        Such a landmark is no rival of the live track: if they are one, they are joined later.
        """
        names, live = forecast.names, forecast.is_live
        both = is_near.T @ is_near & ~live & (live & ~forecast.is_tentative)[:, None]
        for i, j in np.argwhere(both).tolist():
            together = self.known.together[in_order(names[i], names[j])]
            both[i, j] = together <= TOGETHER and tracks.are_close(i, j)
        return np.asarray(is_near & (is_near @ both))

    def _penalties(self, forecast: Forecast) -> np.ndarray:
        """Return twice the negative log probabilities to see landmarks, (n,).

        Those seen just before are seen again.
        """
        beyond = np.maximum(forecast.distance / self.known.reach - 1.0, 0.0) / LINEAR
        penalty = np.minimum(2.0 * beyond**2, ASSOCIATION_MARGIN) + NOT_LIVE
        tentative = np.where(forecast.is_tentative, TENTATIVE, 0.0)
        return np.where(forecast.is_live, tentative, penalty)

    def _use_hints(
        self, seen: SeenFrame, forecast: Forecast, tracks: Tracks, allowed: np.ndarray
    ) -> None:
        """Let the track numbers of a sensor decide, where a live track has the same one."""
        live = forecast.is_live
        hinted = {x.hint: j for j, x in enumerate(tracks.tracks) if x.hint and live[j]}
        for i, key in enumerate(seen.keys):
            if key.startswith(TRACK) and (j := hinted.get(key)) is not None:
                allowed[:, j] = False
                allowed[i] = False
                allowed[i, j] = True

    def _count(
        self,
        forecast: Forecast,
        is_met: np.ndarray,
        hits: set[str],
        tracks: Tracks,
        chart: Chart,
    ) -> None:
        """Count hits and misses of mapped landmarks; `is_met` if any bearing may be of them."""
        mapped = chart.map.landmarks.mapped
        is_missed = self._is_near(forecast, tracks) & ~is_met
        for j, name in enumerate(forecast.names):
            if name not in mapped:
                continue
            if j < len(tracks.tracks):
                tracks.tracks[j].misses = tracks.tracks[j].misses + 1 if is_missed[j] else 0
            if NAME in name and (name in hits or is_missed[j]):
                self.known.count(name, name in hits)

    def _is_near(self, forecast: Forecast, tracks: Tracks) -> np.ndarray:
        """Return which landmarks (n,) are certainly in view and in reach, if nothing hides them."""
        in_view = [tracks.clutter.is_in_view(b) for b in forecast.mean.tolist()]
        near = forecast.distance < 0.8 * self.known.reach
        near &= forecast.covariance.diagonal() < MAX_SHARP**2
        return np.asarray(near & np.array(in_view, bool))

    def _is_lost_now(
        self,
        seen: SeenFrame,
        forecast: Forecast,
        is_met: np.ndarray,
        tracks: Tracks,
        chart: Chart,
    ) -> bool:
        """Return whether the robot is lost at a frame: then it has no tracks of before.

        `is_met` is whether any bearing may be of a landmark.
        """
        live = forecast.is_live & ~forecast.is_tentative
        names, mapped = forecast.names, chart.map.landmarks.mapped
        known = [self.known.seen.get(n, [0, 0])[0] >= MIN_MISSES for n in names]
        is_expected = np.array(known, bool) & self._is_near(forecast, tracks)
        in_view = [tracks.clutter.is_in_view(b) for b in forecast.mean.tolist()]
        if self.is_lost:  # a wrong identity stays while its landmark is live
            is_expected &= ~live & np.array([n in self._loss.former for n in names], bool)
        else:
            is_expected |= live & np.array(in_view, bool)
            is_expected &= np.array([n in mapped for n in names], bool)
        expected = np.flatnonzero(is_expected)
        detection = np.array([self.known.detection(names[j]) for j in expected.tolist()])
        variance = forecast.covariance.diagonal()[expected] + seen.sigma**2 + seen.late**2
        gate = np.minimum(2.0 * ASSOCIATION_GATE * np.sqrt(variance) / tracks.clutter.width, 1.0)
        chance = 1.0 - (1.0 - gate) ** len(seen.keys)
        self._loss.add_frame(len(seen.keys), detection, chance, is_met[expected])
        if self.is_lost:
            if self._loss.ends([names[j] for j in np.flatnonzero(live)]):
                self._loss.end(chart, self.known)
        elif self._loss.begins(seen.t, chart):
            tracks.clear()
        return self.is_lost

    def _found_again(self, seen: SeenFrame, tracks: Tracks, chart: Chart) -> dict[str, str]:
        """Search for the robot that is lost; return the landmarks of sightings if it is found."""
        lines = seen.bearings, seen.variances
        found = self._loss.search(seen.t, seen.keys, *lines, chart, self.known)
        if not found:
            return {}
        self._loss.end(chart, self.known)
        tracks.clear()
        for i, name in found.items():
            track = BearingTrack(
                name, class_of(seen.keys[i]), "", seen.t, seen.t, is_confirmed=True
            )
            tracks.begin(track, *seen.first(i), chart.map.smoother.state.scale)
        return {seen.keys[i]: name for i, name in found.items()}

    def _updated(
        self,
        seen: SeenFrame,
        forecast: Forecast,
        hits: Mapping[int, str],
        is_held: np.ndarray,
        tracks: Tracks,
        chart: Chart,
    ) -> dict[str, str]:
        """Update the tracks by a frame; return the landmarks of sightings that reach the map."""
        mapped, scale = chart.map.landmarks.mapped, chart.map.smoother.state.scale
        at, former = {n: j for j, n in enumerate(forecast.names)}, tracks.tracks[:]
        rows = np.array([i for i, n in hits.items() if at[n] < len(former)], int)
        of = np.array([at[hits[i]] for i in rows.tolist()], int)
        in_view = [tracks.clutter.is_in_view(b) for b in tracks.map.bearings.tolist()]
        if rows.size:
            lines = seen.bearings[rows], seen.variances[rows]
            tracks.map.add_bearings(of, *lines, seen.late**2)
        result, hit = {}, set()
        for i, key in enumerate(seen.keys):
            kind, hint = class_of(key), key if key.startswith(TRACK) else ""
            name = hits.get(i)
            if name is not None and at[name] < len(former):
                track = former[at[name]]
                track.t, track.hint, track.hits = seen.t, hint or track.hint, track.hits + 1
            elif name is None and (is_held[i] or seen.is_crowded(i)):
                continue
            else:
                track = BearingTrack(name or self.known.new_name(kind), kind, hint, seen.t, seen.t)
                tracks.begin(track, *seen.first(i), scale)
            hit.add(track.name)
            if kind:
                self.known.kinds.setdefault(track.name, kind)
            if not track.is_confirmed and name is not None:
                own = float(forecast.covariance[at[name], at[name]])
                sigma = math.sqrt(own + float(seen.variances[i]) + seen.late**2)
                tracks.test(track, sigma, True, track.name in mapped)
            if track.is_confirmed:
                result[key] = track.name
        is_now_live = tracks.is_live(seen.t).tolist()
        live = {x.name for x, now in zip(tracks.tracks, is_now_live, strict=True) if now}
        self.known.add_frame(hit, live & mapped.keys())
        found = []
        if len(seen.keys) > 1:
            for j, track in enumerate(former):
                if not track.is_confirmed and track.name not in hit and in_view[j]:
                    tracks.test(track, seen.sigma, False)
                if forecast.is_live[j] and in_view[j] and track.hits >= MIN_HITS:
                    found.append(track.name in hit)
        false = tracks.forget(seen.t, self.known.aliases)
        tracks.clutter.add_frame(false, sum(found), len(found) - sum(found))
        return result

    def after_frame(self, t: float, chart: Chart) -> bool:
        """Repair the map and find home, where due; return whether home bearings changed."""
        changed, self._is_home_renamed = self._is_home_renamed, False
        if t - self._repaired_at >= REPAIR_S:
            self._repaired_at = t
            self.known.update_reach()
            for new, old in duplicates(chart, self.known):
                changed |= self._rename(new, old, chart)
            self._anchors.update(chart, self.known, self.home.named())
        mapped = chart.map.landmarks.mapped
        usable = {n: self.known.kinds.get(n, "") for n in mapped if n not in self.known.aliases}
        self._anchors.add_frame(t, self._in_frame, fits=not self._loss.is_suspected)
        seen = {*self.names.values()}
        distances = chart.map.landmarks.distances(n for n in usable if n in seen)
        established = {n: d for n, d in distances.items() if mapped[n].established}
        self.known.add_distances(distances.values(), established.values())
        return self.home.update(t, self._path, chart, usable, self.known) or changed

    def _rename(self, new: str, old: str, chart: Chart) -> bool:
        """Record that two landmarks are one; return whether home changes."""
        mapped = chart.map.landmarks.mapped
        if new in mapped and old not in mapped and NAME in old:
            new, old = old, new
        changed = new in self.home.assigned.values()
        self.home.rename(new, old)
        self.known.rename(new, old)
        for tracks in self._tracks.values():
            tracks.rename(new, old)
        return changed


class Forecast(NamedTuple):
    """Predicted bearings of n landmarks at a frame: the tracks first, in their order."""

    names: list[str]
    mean: np.ndarray
    """(n,) [rad]"""
    covariance: np.ndarray
    """(n, n) [rad^2]"""
    is_live: np.ndarray
    """(n,), bool: whether it was hit just before."""
    is_tentative: np.ndarray
    """(n,), bool: whether its track is not confirmed."""
    distance: np.ndarray
    """(n,) [m]"""


class SeenFrame(NamedTuple):
    """Sightings of one frame."""

    t: float
    """Stamp [s]."""
    keys: list[str]
    bearings: np.ndarray
    """(m,) [rad]"""
    variances: np.ndarray
    """(m,) [rad^2]"""
    late: float
    """Error that all of them have in common, by delay and jitter of the stamps [rad]."""

    @property
    def sigma(self) -> float:
        """Median standard deviation of the bearings [rad]."""
        return math.sqrt(float(np.median(self.variances)))

    def first(self, i: int) -> tuple[float, float]:
        """Return bearing and variance of one of them, for a new track."""
        return float(self.bearings[i]), float(self.variances[i]) + self.late**2

    def is_crowded(self, i: int) -> bool:
        """Return whether another bearing is too close to one of them to distinguish them."""
        off = np.abs(wrap(np.delete(self.bearings, i) - self.bearings[i]))
        return bool(off.size and off.min() < INLIER * math.sqrt(self.variances[i]))


def _seen(frame: BearingFrame, keys: list[str], sigma: float, late: float) -> SeenFrame:
    """Return sightings of a frame; `sigma` is the noise of those that come without one [rad]."""
    bearings = np.array([frame.sightings[k] for k in keys])
    sigmas = np.array([frame.sigmas.get(k, sigma) for k in keys])
    return SeenFrame(frame.t, keys, bearings, sigmas**2, late)
