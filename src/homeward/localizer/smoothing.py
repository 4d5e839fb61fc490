"""Smoothing of a whole drive: each keyframe is estimated by all measurements, later ones too."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from homeward.drives.drive import Drive
from homeward.estimator import Estimate, Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, between
from homeward.io.blas_threads import single_threaded_blas
from homeward.localizer.chart import Chart
from homeward.localizer.home.hypotheses import Hypotheses, with_pose
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.sightings import KEYFRAME
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.motion.odometry import OdometryIntegrator
from homeward.localizer.motion.preintegration import Motion
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

    Parameters
    ----------
    drive : Drive
        What to smooth.
    settings : LocalizerSettings, optional
        As for the localiser.

    Returns
    -------
    Track
        With the rows of the causal track, which is returned itself if home is not found, or if
        bearings and turns have opposite senses. Where the robot was lost in its last map, and
        before that map began, rows are the causal ones. No row next to a keyframe has a pose whose
        bearings contradict the solution, nor one on a motion that odometry contradicts.
    """
    settings = settings or LocalizerSettings()
    localizer = Localizer(drive.home, settings=settings, known=drive.known, **drive.settings.robot)
    track, solved = solve_whole(drive, localizer)
    if solved is None:
        return track
    chart, whole = localizer.chart, solved.whole
    hypotheses = _at_keyframes(chart, whole) if chart.finalise(whole) else None
    if hypotheses is None:
        return track
    stayed = chart.home.stayed(chart.map)
    keyframes = [Pose(*h.best.pose) for h in hypotheses]
    rows = _rows(track.t, hypotheses, keyframes, stayed, solved)
    spells_lost = [(-math.inf, chart.map.begun), *chart.monitor.spells_lost]
    for i in np.flatnonzero(within(spells_lost, track.t)).tolist():
        rows[i] = _row(track, i)
    for i in np.flatnonzero(within(solved.gaps(keyframes), track.t)).tolist():
        rows[i] = Estimate(rows[i].t, Status.MAPPING, Reason.LOST.words)
    return dataclasses.replace(
        track_of(localizer, rows),
        innovations=track.innovations,
        update_seconds=track.update_seconds,
        run_seconds=track.run_seconds,
        history=track.history,
    )


@dataclass(frozen=True)
class SolvedDrive:
    """A drive of which all keyframes of the last map were solved at once."""

    drive: Drive
    localizer: Localizer
    """After a run of the drive."""
    whole: Smoother
    lost: frozenset[int]
    """Numbers of the keyframes whose poses their bearings contradict."""

    def motions(
        self, k: int, keyframes: Sequence[Pose], times: Sequence[float]
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the motions from a keyframe to times before the next one, given both poses.

        Parameters
        ----------
        k : int
            Index of the keyframe in the window.
        keyframes : sequence of Pose
            Poses of all keyframes in one frame.
        times : sequence of float
            In order [s].

        Returns
        -------
        list of tuple of ndarray, shapes (3,) and (3, 3)
            Means [m, m, rad] and covariances.
        """
        is_last, calibration = k + 1 == len(keyframes), self.whole.state.calibration
        odometry = self._odometry(k, times[-1] if is_last else self.whole.stamps[k + 1])
        found = [odometry.advance(t, calibration) for t in times]
        if is_last:
            return [(m.delta, m.covariance) for m in found]
        end = odometry.advance(self.whole.stamps[k + 1], calibration)
        off = _off(end, between(*keyframes[k : k + 2]))
        return [bridged(m, end, off) for m in found]

    def gaps(self, keyframes: Sequence[Pose]) -> list[tuple[float, float]]:
        """Return the intervals in which the robot was lost.

        Those before which a new map replaced one, and those between keyframes with sightings in
        which odometry is contradicted: by the poses at both ends of a motion, or by the bearings
        from a keyframe. Where in such an interval odometry failed is unknown. Poses are as in
        `motions`.
        """
        whole, lost = self.whole, self.lost
        stamps = np.array(whole.stamps)
        seen = np.isin(whole.first + np.arange(stamps.size), whole.sightings[:, KEYFRAME])
        seen[[k - whole.first for k in lost]] = False
        seen[[0, -1]] = True
        gaps = list(self.localizer.spells_blind)
        for a, b in pairwise(np.flatnonzero(seen).tolist()):
            motions = zip(range(a, b), pairwise(keyframes[a : b + 1]), strict=True)
            ends = {whole.first + k for k in range(a, b + 1)}
            if not ends.isdisjoint(lost) or any(
                _is_denied(self._motion(k), between(*poses)) for k, poses in motions
            ):
                gaps.append((float(stamps[a]), float(stamps[b])))
        return gaps

    def _motion(self, k: int) -> Motion:
        """Return the motion of the odometry from the k-th keyframe in the window to the next."""
        end = self.whole.stamps[k + 1]
        return self._odometry(k, end).advance(end, self.whole.state.calibration)

    def _odometry(self, k: int, end: float) -> OdometryIntegrator:
        """Return an odometry that starts at a keyframe and has the twists until `end` [s]."""
        twists, begin, odometry = TwistHistory(), self.whole.stamps[k], self.drive.odometry
        for i in range(*np.searchsorted(odometry.t, [begin - 2.0 * MAX_LAG_S, end]).tolist()):
            twists.add(float(odometry.t[i]), float(odometry.v[i]), float(odometry.omega[i]))
        integrator = OdometryIntegrator(twists, self.localizer.chart.process_noise)
        integrator.restart(begin)
        return integrator


def solve_whole(
    drive: Drive, localizer: Localizer, on_progress: Callable[[float], None] | None = None
) -> tuple[Track, SolvedDrive | None]:
    """Run a new localiser on a drive, and solve all keyframes of its last map at once.

    Return the causal track, and the solution; None if bearings and turns have opposite senses.
    """
    localizer.retain_marginalised()
    track = run(drive, localizer, on_progress)
    if localizer.is_convention_wrong:
        return track, None
    chart = localizer.chart
    chart.learn(float(track.t[-1]))
    whole = chart.map.smoother.whole()
    _solve(whole)
    if restore(_contradicted(drive, chart, whole), chart.map, whole):
        _solve(whole)
    lost = frozenset(seen.keyframe for seen in _contradicted(drive, chart, whole))
    return track, SolvedDrive(drive, localizer, whole, lost)


def _solve(whole: Smoother) -> None:
    """Solve the whole drive."""
    for _ in range(NUM_WHOLE_SOLVES):
        whole.solve()


def _contradicted(drive: Drive, chart: Chart, whole: Smoother) -> list[SeenAt]:
    """Return sightings from keyframes whose poses they contradict."""
    states, known = whole.marginals(), chart.map
    found = seen_from_keyframes(drive, chart, whole)
    return [s for s in found if s.contradicts(states[s.keyframe - whole.first], known, whole)]


def seen_from_keyframes(
    drive: Drive, chart: Chart, whole: Smoother, where_at: float | None = None
) -> Iterator[SeenAt]:
    """Yield the sightings from keyframes, of landmarks in place then, or at a time [s]."""
    keyframes = {t: k for k, t in enumerate(whole.stamps)}
    for t, bearings, given in drive.sightings.stamps():
        k = keyframes.get(t)
        if k is None:
            continue
        ids = chart.map.landmarks.ids_at(t if where_at is None else where_at, bearings)
        names = [n for n, number in ids.items() if math.isfinite(bearings[n])]
        seen = np.array([bearings[n] for n in names])
        frame = WeighedFrame(t, names, seen, chart.noise.sigmas(names, given))
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


def _at_keyframes(chart: Chart, whole: Smoother) -> list[Hypotheses] | None:
    """Return the hypotheses with each keyframe's pose; None when they do not determine it."""
    hypotheses: list[Hypotheses] = []
    for state in whole.marginals():
        found = chart.home.hypotheses
        now = None if found is None else with_pose(chart.home.problem(chart.map, state), found)
        if now is None:
            return None
        hypotheses.append(now)
    return hypotheses


def _rows(
    times: np.ndarray,
    hypotheses: list[Hypotheses],
    keyframes: list[Pose],
    stayed: np.ndarray,
    solved: SolvedDrive,
) -> list[Estimate]:
    """Return the estimates at the times of all rows, by the tests of the causal run."""
    localizer, stamps = solved.localizer, np.array(solved.whole.stamps)
    index = np.clip(np.searchsorted(stamps, times, side="right") - 1, 0, None)
    rows: list[Estimate] = []
    for k in np.unique(index).tolist():
        integrity = IntegrityMonitor(localizer.settings, localizer.chart.scale.rest)
        localizer.chart.share_extrinsics(integrity)
        integrity.update(hypotheses[k], solved=True, stayed=stayed)
        now = times[index == k].tolist()
        moved = solved.motions(k, keyframes, now)
        # Later bearings count too, so that the robot never coasts.
        rows += [integrity.estimate(t, m, False) for t, m in zip(now, moved, strict=True)]
    return rows


def _is_denied(motion: Motion, known: Pose) -> bool:
    """Return whether the poses at both ends, `known` apart, contradict a motion of the odometry."""
    off = _off(motion, known)
    return float(off @ np.linalg.solve(motion.covariance + 1e-12 * np.eye(3), off)) > CONTRADICTED


def _off(motion: Motion, known: Pose) -> np.ndarray:
    """Return by how much the known pose at the end differs from a motion (3,) [m, m, rad]."""
    off = np.asarray(np.array(known) - motion.delta)
    off[2] = wrap(off[2])
    return off


def bridged(motion: Motion, end: Motion, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the Brownian bridge of a motion: mean and covariance given its end.

    Parameters
    ----------
    motion : Motion
        Up to the time of interest, by odometry alone.
    end : Motion
        Up to the end, by odometry alone.
    off : ndarray, shape (3,)
        By how much the known end differs from that [m, m, rad].

    Returns
    -------
    tuple of ndarray, shapes (3,) and (3, 3)
        Conditioned on the known end, by the joint covariance of both motions.
    """
    swing = np.eye(3)
    swing[:2, 2] = motion.delta[1] - end.delta[1], end.delta[0] - motion.delta[0]
    cross = motion.covariance @ swing.T
    gain = np.linalg.solve(end.covariance + 1e-12 * np.eye(3), cross.T).T
    return motion.delta + gain @ off, motion.covariance - gain @ cross.T
