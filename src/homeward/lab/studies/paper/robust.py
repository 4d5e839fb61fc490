"""The robust localiser and the Cramer-Rao bound in the worlds of the paper's cases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from homeward.control.laws import homing
from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings
from homeward.drives.settings import DriveSettings, OdometryNoise, Sensor, Start
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import (
    Polar,
    Pose,
    Twist,
    advance,
    bearing,
    from_polar,
    polar_covariance_to_pose,
    to_polar,
)
from homeward.lab.bounds import posterior_bound
from homeward.lab.studies.paper.cases import Errors, errors_over, polar_errors
from homeward.lab.studies.paper.settings import PaperSettings
from homeward.lab.studies.paper.world import CaseName, PaperWorld
from homeward.registry import make_estimator

EXACT = 1e-5
"""Standard deviation of exact quantities, small enough to change no bound by 0.1 % [m, rad]."""


def drive_of(world: PaperWorld, settings: PaperSettings) -> Drive:
    """Return home, true noise and start prior of a world as a drive without samples."""
    assumed, dt = settings.assumed, settings.printed.sample_time
    guess = world.guess if world.guess.R >= 0 else to_polar(from_polar(world.guess))
    sigmas = np.maximum(assumed.initial_error, EXACT)
    density = np.array(assumed.disturbance) * np.sqrt(dt)
    return Drive(
        name="the paper's case",
        odometry=Odometry(*np.empty((3, 0))),
        sightings=Sightings.of_rows(()),
        home={str(i): HomeBearing(float(b), EXACT) for i, b in enumerate(world.stored)},
        settings=DriveSettings(
            sensor=Sensor(bearing_sigma=max(assumed.bearing_sigma, EXACT)),
            odometry=OdometryNoise(
                speed_sigma=float(density[0]),
                turn_sigma=float(density[1]),
                speed_scale_sigma=0.0,
                turn_scale_sigma=0.0,
                turn_bias_sigma=0.0,
            ),
            start=Start.about(Polar(guess.R, *map(wrap, guess[1:])), *sigmas),
        ),
    )


def run_robust(case: CaseName, world: PaperWorld, settings: PaperSettings) -> Errors:
    """Run the robust localiser through a world, in closed loop in Cases 1 to 3.

    Unlike the paper's filters it is given the true noise; homing ends as for them. Errors are over
    the samples with a pose, NaN when there was none.
    """
    estimator = make_estimator("robust", drive_of(world, settings))
    dt, pose = settings.printed.sample_time, world.start
    answers: list[Polar] = []
    poses: list[Pose] = []
    for k, visible in enumerate(world.visible):
        answer = estimator.estimate(k * dt)
        polar = answer.polar
        if polar is not None:
            answers.append(polar)
            poses.append(pose)
        localised = answer.status in (Status.LOCALISED, Status.COASTING)
        twist = _command(case, settings, polar, localised)
        if twist is None:
            break
        estimator.odometry(k * dt, float(twist.v), float(twist.omega))
        pose = advance(pose, Twist(*(np.array(twist) + world.disturbance[k])), dt)
        seen = bearing(pose, *world.landmarks.T) + world.noise[k]
        sightings = {str(i): float(wrap(seen[i])) for i in np.flatnonzero(visible)}
        if sightings:
            estimator.bearings((k + 1) * dt, sightings)
    distance = np.array([np.hypot(pose.x, pose.y)])
    if not answers:
        nothing = np.full((1, 3), np.nan)
        return Errors(nothing, nothing[:, 0], nothing, distance)
    true = np.array(poses)
    errors = polar_errors(np.array(answers, float), true)
    return replace(errors_over(errors, true), final_distance=distance)


def bound_errors(case: CaseName, world: PaperWorld, settings: PaperSettings) -> Errors:
    """Return the Cramer-Rao bound on the errors over a run.

    It is along the path steered by the true pose; the wrong home bearings count as known.
    """
    poses, twists = _true_path(case, world, settings)
    assumed, dt = settings.assumed, settings.printed.sample_time
    n = len(poses)
    start = np.diag(np.square(np.maximum(assumed.initial_error, EXACT)))
    # The update of sample k follows its motion: at the start no landmark is in view.
    visible = np.vstack([np.zeros((1, len(world.landmarks)), bool), world.visible[: n - 1] > 0])
    bound = posterior_bound(
        poses,
        twists,
        np.full(n - 1, dt),
        world.landmarks,
        visible,
        bearing_sigma=max(assumed.bearing_sigma, EXACT),
        home_sigma=EXACT,
        speed_sigma=assumed.disturbance[0] * np.sqrt(dt),
        turn_sigma=assumed.disturbance[1] * np.sqrt(dt),
        moved=world.faults != 0,
        start_covariance=polar_covariance_to_pose(to_polar(world.start), start),
    )
    return errors_over(np.sqrt(_polar_variances(poses, bound)), poses)


def _true_path(
    case: CaseName, world: PaperWorld, settings: PaperSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Return poses (n, 3) and twists (n - 1, 2) of the path steered by the true pose."""
    pose = world.start
    poses, twists = [np.array(pose, float)], []
    for disturbance in world.disturbance[:-1]:
        twist = _command(case, settings, to_polar(pose), True)
        if twist is None:
            break
        pose = advance(pose, Twist(*(np.array(twist) + disturbance)), settings.printed.sample_time)
        poses.append(np.array(pose, float))
        twists.append(np.array(twist, float))
    return np.array(poses), np.array(twists).reshape(-1, 2)


def _command(
    case: CaseName, settings: PaperSettings, polar: Polar | None, localised: bool
) -> Twist | None:
    """Return the twist of a case at a pose, straight ahead without one; None at home."""
    speed, assumed = settings.printed.speed_cm / 100, settings.assumed
    if case == "4":
        return Twist(speed, assumed.circle_turn_rate)
    if polar is None:
        return Twist(speed, 0.0)
    return None if localised and assumed.stop_radius > polar.R else homing(polar, speed)


def _polar_variances(poses: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Return the variances of R, theta, alpha, (n, 3), of covariances of poses (n, 3, 3)."""
    R, theta = np.hypot(poses[:, 0], poses[:, 1]), np.arctan2(poses[:, 1], poses[:, 0])
    c, s, zero = np.cos(theta), np.sin(theta), np.zeros(len(poses))
    rows = np.array([[c, s, zero], [-s / R, c / R, zero], [zero, zero, zero + 1]])
    jacobian = rows.transpose(2, 0, 1)
    return np.asarray(np.einsum("kij,kjl,kil->ki", jacobian, covariances, jacobian))
