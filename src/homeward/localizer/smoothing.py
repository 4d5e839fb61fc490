"""Smoothing of a whole drive: each keyframe is estimated by all measurements, later ones too."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Sequence
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
from homeward.localizer.motion.process_noise import ProcessNoise
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
    localizer.retain_marginalised()
    track = run(drive, localizer)
    if localizer.is_convention_wrong:
        return track
    chart = localizer.chart
    chart.learn(float(track.t[-1]))
    whole = chart.map.smoother.whole()
    _solve(whole)
    if restore(_contradicted(drive, chart, whole), chart.map, whole):
        _solve(whole)
    lost = {seen.keyframe for seen in _contradicted(drive, chart, whole)}
    hypotheses = _at_keyframes(chart, whole) if chart.finalise(whole) else None
    if hypotheses is None:
        return track
    stayed = chart.home.stayed(chart.map)
    rows = _rows(track.t, hypotheses, stayed, whole, drive, localizer)
    spells_lost = [(-math.inf, chart.map.begun), *chart.monitor.spells_lost]
    for i in np.flatnonzero(_within(spells_lost, track.t)).tolist():
        rows[i] = _row(track, i)
    gaps = [*localizer.spells_blind, *_gaps(lost, hypotheses, whole, drive, localizer)]
    for i in np.flatnonzero(_within(gaps, track.t)).tolist():
        rows[i] = Estimate(rows[i].t, Status.MAPPING, Reason.LOST.words)
    return dataclasses.replace(
        track_of(localizer, rows),
        innovations=track.innovations,
        update_seconds=track.update_seconds,
        run_seconds=track.run_seconds,
        history=track.history,
    )


def _solve(whole: Smoother) -> None:
    """Solve the whole drive."""
    for _ in range(NUM_WHOLE_SOLVES):
        whole.solve()


def _contradicted(drive: Drive, chart: Chart, whole: Smoother) -> list[SeenAt]:
    """Return sightings from keyframes whose poses they contradict."""
    keyframes, states = {t: k for k, t in enumerate(whole.stamps)}, whole.marginals()
    found = []
    for t, bearings, given in drive.sightings.stamps():
        k = keyframes.get(t)
        if k is None:
            continue
        ids = chart.map.landmarks.ids_at(t, bearings)
        names = [n for n, number in ids.items() if math.isfinite(bearings[n])]
        seen = np.array([bearings[n] for n in names])
        frame = WeighedFrame(t, names, seen, chart.noise.sigmas(names, given))
        seen_at = SeenAt(whole.first + k, frame, np.array([ids[n] for n in names], int))
        if seen_at.contradicts(states[k], chart.map, whole):
            found.append(seen_at)
    return found


def _within(intervals: Sequence[tuple[float, float]], times: np.ndarray) -> np.ndarray:
    """Return which times lie in one of the intervals, shape (n,), bool."""
    begin, end = np.array(intervals).reshape(-1, 2).T[:, :, None]
    return np.asarray(((begin <= times) & (times < end)).any(axis=0))


def _gaps(
    lost: Collection[int],
    hypotheses: list[Hypotheses],
    whole: Smoother,
    drive: Drive,
    localizer: Localizer,
) -> list[tuple[float, float]]:
    """Return the intervals between keyframes with sightings in which odometry is contradicted.

    That is by the poses at both ends of a motion, or by the bearings from a keyframe. Where in such
    an interval odometry failed is unknown.
    """
    stamps = np.array(whole.stamps)
    seen = np.isin(whole.first + np.arange(stamps.size), whole.sightings[:, KEYFRAME])
    seen[[k - whole.first for k in lost]] = False
    seen[[0, -1]] = True
    keyframes = [Pose(*h.best.pose) for h in hypotheses]
    gaps = []
    for a, b in pairwise(np.flatnonzero(seen).tolist()):
        motions = zip(range(a, b), pairwise(keyframes[a : b + 1]), strict=True)
        ends = {whole.first + k for k in range(a, b + 1)}
        if not ends.isdisjoint(lost) or any(
            _is_denied(_motion(drive, localizer, whole, k), between(*poses)) for k, poses in motions
        ):
            gaps.append((float(stamps[a]), float(stamps[b])))
    return gaps


def _motion(drive: Drive, localizer: Localizer, whole: Smoother, k: int) -> Motion:
    """Return the motion of the odometry from the k-th keyframe in the window to the next one."""
    begin, end = whole.stamps[k : k + 2]
    odometry = _stretch(drive, localizer.chart.process_noise, begin, end)
    return odometry.advance(end, whole.state.calibration)


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


def _stretch(drive: Drive, noise: ProcessNoise, begin: float, end: float) -> OdometryIntegrator:
    """Return an odometry that starts at `begin` [s] and has the twists until `end` [s]."""
    twists = TwistHistory()
    t = drive.odometry.t
    for i in range(*np.searchsorted(t, [begin - 2.0 * MAX_LAG_S, end]).tolist()):
        twists.add(float(t[i]), float(drive.odometry.v[i]), float(drive.odometry.omega[i]))
    odometry = OdometryIntegrator(twists, noise)
    odometry.restart(begin)
    return odometry


def _rows(
    times: np.ndarray,
    hypotheses: list[Hypotheses],
    stayed: np.ndarray,
    whole: Smoother,
    drive: Drive,
    localizer: Localizer,
) -> list[Estimate]:
    """Return the estimates at the times of all rows, by the tests of the causal run."""
    stamps = np.array(whole.stamps)
    keyframes = [Pose(*h.best.pose) for h in hypotheses]
    index = np.clip(np.searchsorted(stamps, times, side="right") - 1, 0, None)
    rows: list[Estimate] = []
    for k in np.unique(index).tolist():
        integrity = IntegrityMonitor(localizer.settings, localizer.chart.scale.rest)
        localizer.chart.share_extrinsics(integrity)
        integrity.update(hypotheses[k], solved=True, stayed=stayed)
        now = times[index == k].tolist()
        last = k + 1 == stamps.size
        until = now[-1] if last else float(stamps[k + 1])
        odometry = _stretch(drive, localizer.chart.process_noise, float(stamps[k]), until)
        motions = [odometry.advance(t, whole.state.calibration) for t in now]
        moved = [(m.delta, m.covariance) for m in motions]
        if not last:
            end = odometry.advance(until, whole.state.calibration)
            off = np.array(between(keyframes[k], keyframes[k + 1])) - end.delta
            off[2] = wrap(off[2])
            moved = [bridged(m, end, off) for m in motions]
        # Later bearings count too, so that the robot never coasts.
        rows += [integrity.estimate(t, m, False) for t, m in zip(now, moved, strict=True)]
    return rows


def _is_denied(motion: Motion, known: Pose) -> bool:
    """Return whether the poses at both ends, `known` apart, contradict a motion of the odometry."""
    off = np.array(known) - motion.delta
    off[2] = wrap(off[2])
    return float(off @ np.linalg.solve(motion.covariance + 1e-12 * np.eye(3), off)) > CONTRADICTED


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
