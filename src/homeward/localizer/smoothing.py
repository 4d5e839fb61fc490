"""The final pass over a whole log: each keyframe is corrected by everything, later bearings too."""

from __future__ import annotations

import dataclasses

import numpy as np

from homeward.angles import wrap
from homeward.drives.drive import Drive
from homeward.drives.odometry_noise import noise_rates
from homeward.estimator import Status
from homeward.frames import Pose, between
from homeward.localizer.answer import Answer, in_home_frame
from homeward.localizer.fitting import fit
from homeward.localizer.home import HomeFit
from homeward.localizer.localizer import Localizer
from homeward.localizer.moved import Hypotheses, search
from homeward.localizer.odometry import LONGEST_LAG, Odometry
from homeward.localizer.preintegration import Motion
from homeward.localizer.problem import HomeProblem
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
    found = search(localizer.problem(marginal))
    if found is None:
        return track
    fits = _fits(localizer, whole, found)
    localizer.conclude(marginal, found)
    given = drive.settings.odometry.speed_scale_sigma
    scale = settings.odometry.speed_scale if given is None else given
    answers = [a.with_scale(scale) for a in _rows(track.t, fits, whole, drive, settings)]
    poses = np.array([a.pose for a in answers])
    status, reason = _verdict(found)
    return dataclasses.replace(
        track,
        x=poses[:, 0],
        y=poses[:, 1],
        heading=poses[:, 2],
        covariance=np.array([a.covariance for a in answers]),
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
    odometry = Odometry(noise_rates(drive.settings.odometry, settings.odometry))
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
) -> list[Answer]:
    """Return the poses in the home frame at all rows' times."""
    stamps = np.array(whole.stamps)
    keyframes = [Pose(*f.pose) for f in fits]
    index = np.clip(np.searchsorted(stamps, times, side="right") - 1, 0, None)
    answers: list[Answer] = []
    for k in np.unique(index).tolist():
        rows = times[index == k].tolist()
        last = k + 1 == stamps.size
        until = rows[-1] if last else float(stamps[k + 1])
        odometry = _stretch(drive, settings, float(stamps[k]), until)
        motions = [odometry.advance(t, whole.calibration) for t in rows]
        start = in_home_frame(fits[k])
        if last:
            answers.extend(start.after(m.delta, m.covariance) for m in motions)
            continue
        end = odometry.advance(until, whole.calibration)
        there = between(keyframes[k], keyframes[k + 1])
        off = np.array(there) - end.delta
        off[2] = wrap(off[2])
        answers.extend(start.after(*_bridged(m, end, off)) for m in motions)
    return answers


def _bridged(motion: Motion, end: Motion, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a motion on the way to where its end is known, and its covariance.

    Odometry ends at `end`, which is off by `off` (3,): what it was off on the way follows from how
    its noise gathered (a Brownian bridge).
    """
    swing = np.eye(3)
    swing[:2, 2] = motion.delta[1] - end.delta[1], end.delta[0] - motion.delta[0]
    cross = motion.covariance @ swing.T
    gain = np.linalg.solve(end.covariance + 1e-12 * np.eye(3), cross.T).T
    return motion.delta + gain @ off, motion.covariance - gain @ cross.T


def _verdict(found: Hypotheses) -> tuple[Status, str]:
    """Return the status of the whole track, with its reason."""
    agreeing = int(found.best.right.sum())
    if agreeing < 4:
        return Status.UNVERIFIED, f"only {agreeing} home bearings agree"
    return Status.LOCALISED, f"{agreeing} home bearings agree, over the whole drive"
