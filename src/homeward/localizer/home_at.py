"""Home at any pose of a drive: its bearings, predicted by the map of the whole drive."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Callable

import numpy as np

from homeward.drives.drive import Drive
from homeward.drives.home.spin import JointHome
from homeward.drives.settings import Robot
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, between
from homeward.io.blas_threads import single_threaded_blas
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.state import Marginal
from homeward.localizer.motions import Motion
from homeward.localizer.reference.frame import predict_bearings
from homeward.localizer.smoothing import SolvedDrive, seen_from_keyframes, solved_after, within
from homeward.localizer.tunables import MAX_PREDICTED_SIGMA, NUM_NEAREST
from homeward.track import run


@single_threaded_blas()
def predicted_home(
    drive: Drive, t: float, on_progress: Callable[[float], None] | None = None
) -> JointHome:
    """Return the bearings at the robot's pose at `t` [s], predicted by the map of the drive.

    A localiser without home maps the drive, and all keyframes are solved at once. Each landmark is
    where it was at that time. The covariance is that of one observation there: it contains the
    camera noise, so that the sightings of the drive do not count twice. Without landmarks where
    there was no map at that time, or the robot was lost.
    """
    robot: Robot = {**drive.settings.robot, "start": None}
    localizer = Localizer({}, known=drive.known, **robot)
    localizer.retain_marginalised()
    alone = dataclasses.replace(drive, home={})
    solved = solved_after(alone, localizer, run(alone, localizer, on_progress))
    nothing = JointHome((), np.zeros(0), np.zeros((0, 0)))
    if solved is None:
        return nothing
    chart = localizer.chart
    lost = [(-np.inf, chart.map.begun), *chart.monitor.spells_lost, *solved.gaps()]
    return nothing if within(lost, np.array([t]))[0] else _predicted(solved, drive, t)


def _predicted(solved: SolvedDrive, drive: Drive, t: float) -> JointHome:
    """Return the predicted bearings at a time at which the robot was not lost."""
    whole, chart = solved.whole, solved.localizer.chart
    names = dict.fromkeys(drive.sightings.landmark.tolist())
    ids = chart.map.landmarks.ids_at(t, names)
    index = whole.index(np.array(list(ids.values()), int))
    k = max(int(np.searchsorted(whole.stamps, t, side="right")) - 1, 0)
    ends = [Pose(*pose) for pose in whole.poses[k : k + 2].tolist()]
    shift, covariance = solved.motions(k, [t], between(*ends) if len(ends) > 1 else None)[0]
    moved = dataclasses.replace(Motion.identity(), delta=shift, covariance=covariance)
    state_at = whole.marginal_of()
    state = state_at(k).propagate(moved)
    camera = state.pose_after(chart.map.camera(Motion.identity()))
    sigmas = chart.noise.sigmas(list(ids), {})
    zeros = np.zeros(index.size)
    expected = predict_bearings(state.mean, state.covariance, zeros, sigmas, camera, index)
    joint = expected.covariance
    kept = joint.diagonal() <= MAX_PREDICTED_SIGMA**2
    kept &= whole.p_static[index] >= 0.5
    kept &= ~np.isin(list(ids), _moved(solved, drive, state_at, t))
    bearings = np.asarray(wrap(-expected.residual))
    chosen = [name for name, is_kept in zip(ids, kept.tolist(), strict=True) if is_kept]
    return JointHome(tuple(chosen), bearings[kept], joint[np.ix_(kept, kept)])


def _moved(
    solved: SolvedDrive, drive: Drive, state_at: Callable[[int], Marginal], t: float
) -> list[str]:
    """Return landmarks that were elsewhere at a time [s]: their sightings next to it do not fit.

    The map has one position of a landmark that moved before it was established.
    """
    whole, chart = solved.whole, solved.localizer.chart
    misfits = defaultdict[str, tuple[list[bool], list[bool]]](lambda: ([], []))
    for seen in seen_from_keyframes(drive, chart, whole, t):
        wrong = seen.misfits(state_at(seen.keyframe - whole.first), chart.map, whole)
        for name, is_wrong in zip(seen.frame.names, wrong.tolist(), strict=True):
            misfits[name][seen.frame.t > t].append(is_wrong)
    nearest = {n: (b[-NUM_NEAREST:], a[:NUM_NEAREST]) for n, (b, a) in misfits.items()}
    return [n for n, sides in nearest.items() if any(2 * sum(s) > len(s) for s in sides)]
