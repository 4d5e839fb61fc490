"""The sideways scale of a robot that strafes is estimated, relative to the forward scale."""

from dataclasses import replace

import numpy as np
import pytest

from homeward import open_drive
from homeward.lab.simulation import scenario as sim
from homeward.lab.simulation.simulate import Simulation, simulate
from homeward.localizer.localizer import Localizer
from homeward.localizer.motions import DELAY, SIDEWAYS_SCALE
from homeward.runs.scoring import score
from homeward.track import run


def strafing(seed: int, scale: float, duration: float = 60.0) -> Simulation:
    """Drive with mecanum wheels, whose speed to the left has a relative error `scale`."""
    rng = np.random.default_rng([seed, 69])
    far, way = rng.uniform(0.5, 2.0, 30), rng.uniform(-np.pi, np.pi, 30)
    points = tuple(zip((far * np.cos(way)).tolist(), (far * np.sin(way)).tolist(), strict=True))
    x, y = points[0]
    return simulate(
        sim.Scenario(
            seed=seed,
            robot=sim.Robot(drive="mecanum"),
            landmarks=sim.Ring(count=12, distance=(2.5, 5.0)),
            visibility=sim.Visibility(probability=0.8),
            noise=sim.Noise(bearing_sigma=0.01, home_sigma=0.01),
            odometry=sim.OdometryErrors(
                speed_sigma=0.01, turn_sigma=0.01, speed_scale=0.03, sideways_scale=scale
            ),
            start=sim.StartPose(x=x, y=y, heading=float(way[0]), prior=False),
            trajectory=sim.Waypoints(speed=0.3, duration=duration, points=points[1:]),
        )
    )


def localised(drive):
    """Localiser after a drive of which the error of the sideways scale is not given; its track."""
    known = drive.settings.odometry.model_copy(
        update={"sideways_scale_sigma": None, "speed_scale_sigma": None}
    )
    given = drive.settings.model_copy(update={"odometry": known})
    localizer = Localizer(drive.home, **given.robot)
    return localizer, run(drive, localizer)


@pytest.mark.parametrize("scale", [0.1, -0.1])
def test_a_wrong_sideways_scale_is_within_2_percent_after_60_s(scale):
    """And its standard deviation is that of the errors."""
    errors, deviations, inside = [], [], []
    for seed in range(6):
        drive = strafing(seed, scale).drive
        localizer, track = localised(drive)
        calibration = localizer.calibration()
        assert calibration.is_open[SIDEWAYS_SCALE]
        assert not any(landmark.moved for landmark in track.landmarks)
        off = 1.0 + calibration.mean[SIDEWAYS_SCALE] - 1.0 / (1.0 + scale)
        variance = calibration.covariance[SIDEWAYS_SCALE, SIDEWAYS_SCALE]
        errors.append((1.0 + scale) * off)
        deviations.append(off**2 / variance)
        inside.append(score(track, drive.truth).accuracy.position_inside_sigma_shares[2])
    assert np.sqrt(np.mean(np.square(errors))) < 0.02
    assert 0.2 < np.mean(deviations) < 2.1  # 99 % of chi-square with six degrees of freedom, over 6
    assert np.mean(inside) > 0.97


def test_before_it_is_known_the_pose_is_consistent():
    """Over drives of 15 s: the estimate of the scale is still rough."""
    inside = []
    for seed in range(8):
        drive = strafing(seed, 0.1, 15.0).drive
        _, track = localised(drive)
        accuracy = score(track, drive.truth).accuracy
        inside.append(accuracy.position_inside_sigma_shares[2])
    assert np.mean(inside) > 0.97


def test_rotation_caused_by_strafing_needs_no_calibration():
    """Of 0.15 rad/m, which odometry does not measure: the bearings correct it."""
    drive = strafing(0, 0.0).drive
    odometry = replace(drive.odometry, omega=drive.odometry.omega - 0.15 * drive.odometry.vy)
    track = run(drive, Localizer(drive.home, **drive.settings.robot))
    turned = replace(drive, odometry=odometry)
    found = run(turned, Localizer(turned.home, **turned.settings.robot))
    plain, off = (score(one, drive.truth).accuracy for one in (track, found))
    assert off.position.rmse < 1.2 * plain.position.rmse
    assert not any(landmark.moved for landmark in found.landmarks)


def test_the_noise_of_odometry_is_not_taken_for_a_lag():
    """The noise of a twist is part of the motion, and of its change by the delay."""
    delays = []
    for seed in range(3):
        drive = strafing(seed, 0.0).drive
        localizer = Localizer(drive.home, **drive.settings.robot)
        run(drive, localizer)
        delays.append(localizer.calibration().mean[DELAY])
    assert abs(np.mean(delays)) < 0.02


def test_a_robot_that_never_strafes_leaves_the_scale_as_it_is():
    sample = open_drive("sample")
    localizer = Localizer(sample.home, **sample.settings.robot)
    run(sample, localizer)
    calibration = localizer.calibration()
    assert calibration.mean[SIDEWAYS_SCALE] == 0.0
    assert not calibration.is_open[SIDEWAYS_SCALE]
