"""A drive of a study, and what no estimator is told of it: what is wrong, and the bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from homeward.angles import wrap
from homeward.bounds import posterior_bound
from homeward.drives.drive import Drive
from homeward.frames import polar_covariance_to_pose, to_polar
from homeward.simulation.simulate import Simulation

Bound = tuple[np.ndarray, np.ndarray]
"""Stamps (n,) and covariances (n, 3, 3) of `simulation_bound`."""


def simulation_bound(simulation: Simulation) -> Bound | None:
    """Return the bound at the bearing stamps of a drive, given its own sightings.

    Which landmarks have moved counts as known, and constant errors of the odometry as zero, so the
    bound is one from below. None where it is not known: a bearing has no noise, or the camera does
    not sit at the centre.

    Returns
    -------
    stamps : ndarray, shape (n,)
        [s]
    bound : ndarray, shape (n, 3, 3)
        Of (x [m], y [m], heading [rad]); infinite while the pose is not fixed.
    """
    drive, case = simulation.drive, simulation.scenario
    centred = all(mount.x == 0 and mount.y == 0 for mount in (case.sensor, case.home_mount))
    if not (centred and case.noise.bearing_sigma > 0 and case.noise.home_sigma > 0):
        return None
    stamps = np.unique(drive.sightings.t)
    if drive.truth is None or not stamps.size:
        return stamps, np.empty((0, 3, 3))
    poses = np.stack(drive.truth.at(stamps), axis=1)
    ids = list(simulation.world.ids)
    visible = np.zeros((stamps.size, len(ids)), bool)
    row = np.searchsorted(stamps, drive.sightings.t)
    visible[row, [ids.index(n) for n in drive.sightings.landmark]] = True
    dt, step = np.diff(stamps), np.diff(poses, axis=0)
    twists = np.stack([np.hypot(step[:, 0], step[:, 1]) / dt, wrap(step[:, 2]) / dt], axis=1)
    return stamps, posterior_bound(
        poses,
        twists,
        dt,
        simulation.world.in_home_frame,
        visible,
        bearing_sigma=case.noise.bearing_sigma,
        home_sigma=case.noise.home_sigma,
        speed_sigma=case.odometry.speed_sigma,
        turn_sigma=case.odometry.turn_sigma,
        # Landmarks that home did not see have no home bearing either.
        moved=(simulation.world.fault != 0) | np.array([i not in drive.home for i in ids]),
        start_covariance=_start_covariance(simulation),
    )


def _start_covariance(simulation: Simulation) -> np.ndarray | None:
    """Return the covariance of the start prior, (x, y, heading); None where there is none."""
    case = simulation.scenario
    if not case.start.prior:
        return None
    start = to_polar(case.start.in_home_frame(case.home.pose))
    sigmas = case.start.sigma_R, case.start.sigma_theta, case.start.sigma_alpha
    return polar_covariance_to_pose(start, np.diag(np.square(sigmas)))


@dataclass(frozen=True)
class Trial:
    """A drive with truth, and by what its estimators are judged."""

    drive: Drive
    moved: frozenset[str]
    """Landmarks whose home bearing is wrong."""
    none_else: bool
    """Whether it is known that no other's is."""
    true_home: dict[str, float]
    """Right home bearings of all landmarks, in the robot's home frame [rad]."""
    final_distance: float
    """True distance from home at the end [m]."""
    bound: Bound | None


def simulated_trial(simulation: Simulation) -> Trial:
    """Return the trial of a simulation: where landmarks stand is known."""
    world = simulation.world
    return Trial(
        simulation.drive,
        frozenset(world.moved),
        True,
        dict(zip(world.ids, np.arctan2(*world.in_home_frame.T[::-1]).tolist(), strict=True)),
        simulation.final_distance,
        simulation_bound(simulation),
    )
