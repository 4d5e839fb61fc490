"""The final pass over a whole log: each keyframe is corrected by everything, later bearings too."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from homeward.angles import wrap
from homeward.drives.drive import Drive
from homeward.estimator import Status
from homeward.frames import Pose, between, compose
from homeward.localizer.home import HomeFit, HomeProblem, fit
from homeward.localizer.localizer import Localizer, in_home_frame
from homeward.localizer.moved import Hypotheses, search
from homeward.localizer.odometry import LONGEST_LAG, NoiseModel, Odometry
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.window import Window
from homeward.track import Track, run

SOLVES = 6
"""The whole drive is solved so often, each time with some Gauss-Newton steps."""


def smooth(drive: Drive, settings: LocalizerSettings | None = None) -> Track:
    """Return the best track of a whole drive; not causal.

    The drive is run once as `homeward.track.run` does, then all its keyframes are solved at once,
    home is found anew, and the rows between keyframes follow the odometry from one to the next.

    Parameters
    ----------
    drive : Drive
        What to smooth.
    settings : LocalizerSettings, optional
        As for the localiser.

    Returns
    -------
    Track
        With the same rows as the causal one, which is returned as it is when home is not found.
    """
    settings = settings or LocalizerSettings()
    localizer = Localizer(drive.home, drive.settings, settings)
    localizer.mapper.window.keep_closed()
    track = run(drive, localizer)
    whole = localizer.mapper.window.whole()
    for _ in range(SOLVES):
        marginal = whole.solve()
    found = search(localizer.problem(marginal), None)
    if found is None:
        return track
    fits = _fits(localizer, whole, found)
    poses, covariances = _rows(track.t, fits, whole, drive, settings)
    given = drive.settings.odometry.speed_scale_sigma
    scale = settings.odometry.speed_scale if given is None else given
    out = np.stack([poses[:, 0], poses[:, 1], np.zeros(len(poses))], axis=1)
    covariances = covariances + scale**2 * out[:, :, None] * out[:, None, :]
    status, reason = _verdict(found)
    return dataclasses.replace(
        track,
        x=poses[:, 0],
        y=poses[:, 1],
        heading=poses[:, 2],
        covariance=covariances,
        status=[status] * track.t.size,
        reason=[reason] * track.t.size,
        landmarks=localizer.landmarks(),
    )


def _fits(localizer: Localizer, whole: Window, found: Hypotheses) -> list[HomeFit]:
    """Return home and each keyframe, corrected by the home bearings that are right."""
    best, fits = found.best, []
    for marginal in whole.marginals():
        problem: HomeProblem = localizer.problem(marginal)
        again = fit(problem, best.home, best.right, steps=2)
        fits.append(best if again is None else again)
    return fits


def _stretch(drive: Drive, settings: LocalizerSettings, begin: float, end: float) -> Odometry:
    """Return an odometry that starts at `begin` [s] and knows the twists until `end` [s]."""
    odometry = Odometry(NoiseModel(drive.settings.odometry, settings))
    t = drive.odometry.t
    for i in range(*np.searchsorted(t, [begin - 2.0 * LONGEST_LAG, end]).tolist()):
        odometry.add(float(t[i]), float(drive.odometry.v[i]), float(drive.odometry.omega[i]))
    odometry.restart(begin)
    return odometry


def _rows(
    times: np.ndarray,
    fits: list[HomeFit],
    whole: Window,
    drive: Drive,
    settings: LocalizerSettings,
) -> tuple[np.ndarray, np.ndarray]:
    """Return poses (n, 3) and covariances (n, 3, 3) in the home frame at all rows' times.

    Odometry leads from each keyframe to the next; what it is off there is taken out bit by bit.
    """
    stamps = np.array(whole.stamps)
    keyframes = [Pose(*f.pose) for f in fits]
    index = np.clip(np.searchsorted(stamps, times, side="right") - 1, 0, None)
    poses, covariances = np.empty((times.size, 3)), np.empty((times.size, 3, 3))
    for k in np.unique(index).tolist():
        rows = np.flatnonzero(index == k)
        last = k + 1 == stamps.size
        until = float(times[-1] if last else stamps[k + 1])
        odometry = _stretch(drive, settings, float(stamps[k]), until)
        deltas = [odometry.advance(t, whole.calibration) for t in times[rows].tolist()]
        off, span = Pose(0.0, 0.0, 0.0), math.inf
        if not last:
            span = until - float(stamps[k])
            end = odometry.advance(until, whole.calibration).delta
            off = between(compose(keyframes[k], Pose(*end)), keyframes[k + 1])
        for row, motion in zip(rows.tolist(), deltas, strict=True):
            share = (float(times[row]) - float(stamps[k])) / span
            step = Pose(share * off.x, share * off.y, share * wrap(off.heading))
            now = compose(compose(keyframes[k], Pose(*motion.delta)), step)
            home = Pose(*fits[k].home)
            poses[row] = between(home, now)
            covariances[row] = in_home_frame(
                fits[k], motion.delta, (1 - share) * motion.covariance
            )[1]
    return poses, covariances


def _verdict(found: Hypotheses) -> tuple[Status, str]:
    """Return the status of the whole track, with its reason."""
    agreeing = int(found.best.right.sum())
    if agreeing < 4:
        return Status.UNVERIFIED, f"only {agreeing} home bearings agree"
    return Status.LOCALISED, f"{agreeing} home bearings agree, over the whole drive"
