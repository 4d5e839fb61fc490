"""Smoothing of a whole drive: each keyframe is estimated by all measurements, later ones too."""

from __future__ import annotations

import dataclasses
import math
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np

from homeward.drives.drive import Drive
from homeward.errors import REQUEST, Attempts, InternalFailure, failure_notes, require_kind
from homeward.estimator import Estimate, Status
from homeward.geometry.frames import Pose, between
from homeward.geometry.se2 import difference
from homeward.geometry.statistics import positive
from homeward.io.blas_threads import single_threaded_blas
from homeward.localizer.chart import Chart
from homeward.localizer.home.hypotheses import Hypotheses, with_pose
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.sightings import KEYFRAME, MIN_COVARIANCE
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.map.state import Marginal
from homeward.localizer.motion.odometry import OdometryIntegrator
from homeward.localizer.motions import Motion
from homeward.localizer.output.status import IntegrityMonitor
from homeward.localizer.recovery.restore import SeenAt, restore
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import CONTRADICTED, MAX_LAG_S, NUM_WHOLE_SOLVES
from homeward.odometry.history import TwistHistory
from homeward.reasons import Reason
from homeward.track import Track, run, track_of


@single_threaded_blas()
def smooth(drive: Drive, settings: LocalizerSettings | None = None) -> Track:
    """Return the smoothed track of a whole drive; not causal.

    The drive is run as by `homeward.track.run`. Then all its keyframes are solved at once, home is
    found again, and rows between keyframes follow from odometry with both ends known. Whether a row
    has a pose, and its status, depend on all hypotheses at the end, by the tests of the causal run.
    Where odometry is contradicted, as by slip, its error is as large as the motion.

    Parameters
    ----------
    drive : Drive
        What to smooth.
    settings : LocalizerSettings, optional
        As for the localiser.

    Returns
    -------
    Track
        With the rows of the causal track, which is returned itself if home or a keyframe is not
        determined, if bearings and turns have opposite senses, or after an internal error. Where
        the robot was lost in its last map, and before that map began, rows are the causal ones. No
        row next to a keyframe has a pose whose bearings contradict the solution, nor one where a
        new map replaced one.
    """
    require_kind(drive, Drive, "give the drive, not its track")
    settings = settings or LocalizerSettings()
    localizer = Localizer(drive.home, settings=settings, known=drive.known, **drive.settings.robot)
    localizer.retain_marginalised()
    track, attempts = run(drive, localizer), Attempts()
    end = drive.span[1]
    rows = attempts.attempt(end, None, _smoothed_rows, drive, localizer, track)
    return replaced(track, localizer, rows, attempts.failures)


def _smoothed_rows(drive: Drive, localizer: Localizer, track: Track) -> list[Estimate] | None:
    """Return smoothed estimates instead of those of a causal track; None where there are none."""
    solved = solved_after(drive, localizer, track)
    try:
        if solved is None or not localizer.chart.finalise(solved.whole):
            return None
        return solved.estimates([_row(track, i) for i in range(track.t.size)], track.t)
    except np.linalg.LinAlgError:
        return None


def replaced(
    track: Track,
    localizer: Localizer,
    rows: Sequence[Estimate] | None,
    failures: Sequence[InternalFailure],
) -> Track:
    """Return the causal track of a localiser with smoothed rows instead, if there are any.

    The `failures` are those of smoothing.
    """
    if rows is not None:
        smoothed = track_of(localizer, rows)
        track = dataclasses.replace(
            smoothed,
            innovations=track.innovations,
            update_seconds=track.update_seconds,
            run_seconds=track.run_seconds,
            history=track.history,
            failures=track.failures,
            notes=(*failure_notes(track.failures), *smoothed.notes),
        )
    if not failures:
        return track
    note = f"Smoothing failed, and its rows are causal: {failures[0]}. {REQUEST}"
    every = (*track.failures, *failures)
    return dataclasses.replace(track, failures=every, notes=(note, *track.notes))


@dataclass(frozen=True)
class SolvedDrive:
    """Keyframes that were solved at once: all of the last map of a drive, or those in a window."""

    localizer: Localizer
    """After a run of the drive, or of its beginning."""
    whole: Smoother
    twists: Callable[[float, float], TwistHistory]
    """Returns a history with the twists of an interval [s]."""
    since: float = -math.inf
    """Time from which on odometry is tested [s]."""
    lost: frozenset[int] = frozenset()
    """Numbers of the keyframes whose poses their bearings contradict."""
    slips: Mapping[int, float] = field(default_factory=dict)
    """Variances of slip, as shares of those of a motion without odometry, by the index of the
    keyframe where the motion begins [1]."""

    def estimates(self, rows: Sequence[Estimate], times: np.ndarray) -> list[Estimate] | None:
        """Return smoothed estimates instead of causal ones, by the tests of the causal run.

        `rows` are causal estimates, which remain where the robot was lost in its map, before that
        map began, and before the solved keyframes; `times` (n,) are theirs on the localiser's
        clock, in order [s]. None where the hypotheses on home do not determine the pose of a
        keyframe.
        """
        chart, stamps = self.localizer.chart, np.array(self.whole.stamps)
        index = np.searchsorted(stamps, times, side="right") - 1
        lost = [(-math.inf, chart.map.begun), *chart.monitor.spells_lost]
        causal = within(lost, times) | (index < 0) | (stamps[index] < self.since)
        used = np.unique(index[~causal])
        needed = np.union1d(used, np.minimum(used + 1, stamps.size - 1)).tolist()
        state_at = self.whole.marginal_of()
        hypotheses = {k: _at_pose(chart, state_at(k)) for k in needed}
        stayed, estimates = chart.home.stayed(chart.map), list(rows)
        for k in used.tolist():
            here = np.flatnonzero((index == k) & ~causal).tolist()
            now, then = hypotheses[k], hypotheses.get(k + 1)
            if now is None or (k + 1 < stamps.size and then is None):
                return None
            integrity = IntegrityMonitor(self.localizer.settings, chart.scale.rest)
            chart.share_state(integrity)
            integrity.update(now, solved=True, stayed=stayed)
            end = None if then is None else between(Pose(*now.best.pose), Pose(*then.best.pose))
            motions = self.motions(k, times[here].tolist(), end)
            twists = self.twists(stamps[k] - MAX_LAG_S, times[here[-1]])
            for i, moved in zip(here, motions, strict=True):
                coasts = chart.coasts(float(times[i]))
                late = chart.between_stamps(float(times[i]), twists)
                estimates[i] = integrity.estimate(rows[i].t, moved, late, coasts)
        for i in np.flatnonzero(within(self.gaps(), times)).tolist():
            estimates[i] = Estimate(rows[i].t, Status.MAPPING, Reason.LOST.words)
        return estimates

    def motions(
        self, k: int, times: Sequence[float], end: Pose | None
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the motions from a keyframe to times before the next one, given both poses.

        `k` is the index of the keyframe in the window, `times` are in order [s], and `end` is the
        pose of the next keyframe relative to it; None for the newest keyframe. Means (3,) [m, m,
        rad] and covariances (3, 3).
        """
        if end is None:
            found, drift = self._motions(k, times), self.localizer.chart.drift
            return [(m.delta, drift(t, m)) for t, m in zip(times, found, strict=True)]
        *found, last = self._motions(k, [*times, self.whole.stamps[k + 1]])
        off = difference(np.array(end), last.delta)
        return [bridged(m, last, off) for m in found]

    def gaps(self) -> list[tuple[float, float]]:
        """Return the intervals in which the robot was lost [s].

        Those before which a new map replaced one, and those in which odometry is contradicted, also
        where its noise includes slip.
        """
        stamps, doubted = self.whole.stamps, self.lost or self.slips
        denied = [(stamps[a], stamps[b]) for a, b, _ in self._denied()] if doubted else []
        return [*self.localizer.spells_blind, *denied]

    def with_slips(self) -> SolvedDrive:
        """Return it solved again, with slip in the motions that are contradicted.

        In each interval, slip is as large as in its worst motion: any of them may have slipped.
        """
        slips = {k: share for a, b, share in self._denied() for k in range(a, b)}
        solved = dataclasses.replace(self, slips=slips)
        for k in slips:
            self.whole.replace_motion(k, solved._motions(k, [self.whole.stamps[k + 1]])[0])
        if slips:
            _solve(self.whole)
        return solved

    def _denied(self) -> list[tuple[int, int, float]]:
        """Return the intervals between keyframes with sightings in which odometry is contradicted.

        By the poses at both ends of a motion, or by the bearings from a keyframe. Where in such an
        interval odometry failed is unknown. The third number is the share for `slips`.
        """
        whole, count = self.whole, len(self.whole.stamps)
        seen = np.isin(whole.first + np.arange(count), whole.sightings[:, KEYFRAME])
        lost = np.isin(whole.first + np.arange(count), list(self.lost))
        seen[lost] = False
        seen[[0, -1]] = True
        poses, off = [Pose(*pose) for pose in whole.poses.tolist()], np.zeros((count, 3))
        for k in range(bisect_left(whole.stamps, self.since), count - 1):
            motion = self._motions(k, [whole.stamps[k + 1]])[0]
            this = difference(np.array(between(*poses[k : k + 2])), motion.delta)
            if this @ np.linalg.solve(motion.covariance, this) > CONTRADICTED:
                off[k] = this
        denied = []
        for a, b in pairwise(np.flatnonzero(seen).tolist()):
            if off[a:b].any() or lost[a : b + 1].any():
                odometry, end = self._odometry(a, whole.stamps[b]), whole.stamps[b]
                odometry.advance(end, whole.state.calibration)
                squares = off[a:b] @ np.linalg.inv(_slip(odometry, end)) * off[a:b]
                share = float(squares.sum(axis=1).max()) / 3.0
                denied.append((a, b, max(share, float(lost[a : b + 1].any()))))
        return denied

    def _motions(self, k: int, times: Sequence[float]) -> list[Motion]:
        """Return the motions of the odometry from the k-th keyframe in the window to times [s]."""
        odometry, calibration = self._odometry(k, times[-1]), self.whole.state.calibration
        motions, share = [odometry.advance(t, calibration) for t in times], self.slips.get(k, 0.0)
        return [
            dataclasses.replace(m, covariance=m.covariance + MIN_COVARIANCE + share * slip)
            for m, slip in zip(motions, (_slip(odometry, t) for t in times), strict=True)
        ]

    def _odometry(self, k: int, end: float) -> OdometryIntegrator:
        """Return an odometry that starts at a keyframe and has the twists until `end` [s]."""
        begin = self.whole.stamps[k]
        twists = self.twists(begin - 2.0 * MAX_LAG_S, end)
        integrator = OdometryIntegrator(twists, self.localizer.chart.process_noise)
        integrator.restart(begin)
        return integrator


def _slip(odometry: OdometryIntegrator, t: float) -> np.ndarray:
    """Covariance (3, 3) of a motion of unknown speed up to `t` [s], positive for no time, too."""
    return odometry.dropout_motion(t + 1e-3).covariance


def solved_after(drive: Drive, localizer: Localizer, track: Track) -> SolvedDrive | None:
    """Return the solution of all keyframes of the last map after a run that retained them.

    None if bearings and turns have opposite senses, or do not determine all keyframes.
    """
    if localizer.is_convention_wrong:
        return None
    try:
        return _solved(drive, localizer, float(track.t[-1]))
    except np.linalg.LinAlgError:
        return None


def _solved(drive: Drive, localizer: Localizer, end: float) -> SolvedDrive:
    """Return the solution of all keyframes of the last map of a drive until `end` [s]."""
    chart = localizer.chart
    chart.learn(end, everything=True)
    whole = chart.map.smoother.whole()
    _solve(whole)
    if restore(_contradicted(drive, chart, whole), chart.map, whole):
        _solve(whole)
    lost = frozenset(seen.keyframe for seen in _contradicted(drive, chart, whole))
    solved = SolvedDrive(localizer, whole, partial(_twists, drive), lost=lost).with_slips()
    if solved.slips:
        used = set(whole.sightings[:, KEYFRAME].astype(int).tolist())
        for seen in seen_from_keyframes(drive, chart, whole):
            if seen.keyframe - whole.first in solved.slips and seen.keyframe not in used:
                seen.add_to(whole, chart.map)  # rejected by a pose that was wrong
        _solve(whole)
        lost = frozenset(seen.keyframe for seen in _contradicted(drive, chart, whole))
    return dataclasses.replace(solved, lost=lost)


def _twists(drive: Drive, begin: float, end: float) -> TwistHistory:
    """Return a history with the twists of a drive in an interval [s]."""
    twists, odometry = TwistHistory(), drive.odometry
    for i in range(*np.searchsorted(odometry.t, [begin, end]).tolist()):
        t, v, omega, vy = (
            float(c[i]) for c in (odometry.t, odometry.v, odometry.omega, odometry.vy)
        )
        twists.add(t, v, omega, vy=vy)
    return twists


def _solve(whole: Smoother) -> None:
    """Solve the whole drive."""
    for _ in range(NUM_WHOLE_SOLVES):
        whole.solve()


def _contradicted(drive: Drive, chart: Chart, whole: Smoother) -> list[SeenAt]:
    """Return sightings from keyframes whose poses they contradict."""
    state_at, known = whole.marginal_of(), chart.map
    found = seen_from_keyframes(drive, chart, whole)
    return [s for s in found if s.contradicts(state_at(s.keyframe - whole.first), known, whole)]


def seen_from_keyframes(
    drive: Drive, chart: Chart, whole: Smoother, where_at: float | None = None
) -> Iterator[SeenAt]:
    """Yield the sightings from keyframes, of landmarks in place then, or at a time [s]."""
    keyframes = {t: k for k, t in enumerate(whole.stamps)}
    offsets = map(drive.settings.in_first, drive.sightings.cameras())
    for (t, bearings, given), offset in zip(drive.sightings.stamps(), offsets, strict=True):
        k = keyframes.get(t)
        if k is None:
            continue
        ids = chart.map.landmarks.ids_at(t if where_at is None else where_at, bearings)
        names = [n for n, number in ids.items() if math.isfinite(bearings[n])]
        seen = np.array([bearings[n] for n in names])
        sigmas = chart.noise.sigmas(names, given)
        frame = WeighedFrame(t, names, seen, sigmas, offset=offset)
        yield SeenAt(whole.first + k, frame, np.array([ids[n] for n in names], int))


def within(intervals: Sequence[tuple[float, float]], times: np.ndarray) -> np.ndarray:
    """Return which times lie in one of the intervals, shape (n,), bool."""
    begin, end = np.array(intervals).reshape(-1, 2).T[:, :, None]
    return np.asarray(((begin <= times) & (times < end)).any(axis=0))


def _row(track: Track, i: int) -> Estimate:
    """Return a row of a track as an estimate."""
    t, status, reason = float(track.t[i]), track.status[i], track.reason[i]
    if not track.has_pose[i]:
        return Estimate(t, status, reason)
    pose = Pose(*(float(column[i]) for column in (track.x, track.y, track.heading)))
    return Estimate(t, status, reason, pose, track.covariance[i])


def _at_pose(chart: Chart, state: Marginal) -> Hypotheses | None:
    """Return the hypotheses with the pose of a keyframe; None if they do not determine it."""
    if (found := chart.home.hypotheses) is None:
        return None
    return with_pose(chart.home.problem(chart.map, chart.map.smoother, state), found)


def bridged(motion: Motion, end: Motion, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the Brownian bridge of a motion: mean (3,) and covariance (3, 3) given its end.

    `motion` is up to the time of interest and `end` up to the end, by odometry alone; the known end
    differs from that by `off` (3,) [m, m, rad].
    """
    swing = np.eye(3)
    swing[:2, 2] = motion.delta[1] - end.delta[1], end.delta[0] - motion.delta[0]
    cross = motion.covariance @ swing.T
    gain = np.linalg.solve(end.covariance, cross.T).T
    # Slip and the smallest covariance of a motion do not grow by composition, so that more than
    # rounding may be negative.
    covariance = motion.covariance - gain @ cross.T
    covariance = positive(covariance, "the covariance between two keyframes", math.inf)
    return motion.delta + gain @ off, covariance
