"""Extrinsics of a second camera from a drive, with known truth."""

import math
from dataclasses import replace

import numpy as np
import pytest
from two_cameras import simulated

from homeward.drives.drive import Drive, Odometry, Sightings
from homeward.drives.settings import DriveSettings, RobotSettings, Sensor
from homeward.errors import HomewardError
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, Twist, advance, between, compose
from homeward.runs.second_camera import calibrated_second, second_camera

FRONT, REAR = Pose(0.2, 0.05, 0.1), Pose(-0.25, 0.1, math.pi - 0.2)
SPEED_SIGMA, TURN_SIGMA, BEARING_SIGMA = 0.01, 0.01, 0.005


def drives(seed, rest=False, front=FRONT, rear=REAR, shared=12, seconds=60.0):
    """A drive on an eight among 12 landmarks; each camera sees 70 degrees."""
    rng, dt = np.random.default_rng(seed), 0.1
    t = np.arange(0.0, seconds, dt)
    v = np.where(rest, 0.0, np.full(t.size, 0.3))
    omega = np.where(rest, 0.0, 0.35 * np.sign(np.sin(2 * np.pi * t / 36.0) + 1e-9))
    around = rng.uniform(-0.2, 0.2, 12) + np.arange(12) * math.tau / 12
    away = rng.uniform(2.0, 4.0, 12)
    places = np.stack([away * np.cos(around), away * np.sin(around)], axis=1)
    pose, rows = Pose(0.0, 0.0, 0.0), ([], [])
    for k in range(t.size):
        for camera, seen, names in ((front, rows[0], range(12)), (rear, rows[1], range(shared))):
            if (k + (camera is rear)) % 3 == 0:
                eye = compose(pose, camera)
                for i in names:
                    to = between(eye, Pose(*places[i], 0.0))
                    bearing = math.atan2(to.y, to.x)
                    if abs(bearing) < math.radians(35):
                        noisy = float(wrap(bearing + rng.normal(0.0, BEARING_SIGMA)))
                        seen.append((t[k], f"L{i}", noisy, math.nan))
        pose = advance(pose, Twist(v[k], omega[k]), dt)
    measured = Odometry(
        t,
        v + (not rest) * rng.normal(0.0, SPEED_SIGMA / math.sqrt(dt), t.size),
        1.02 * omega + (not rest) * rng.normal(0.0, TURN_SIGMA / math.sqrt(dt), t.size),
    )
    known = {"speed_sigma": SPEED_SIGMA, "turn_sigma": TURN_SIGMA, "speed_scale_sigma": 0.0}
    known |= {"turn_slip_sigma": 0.0}
    settings = DriveSettings(odometry=known, sensor={"bearing_sigma": BEARING_SIGMA})
    first, second = (Sightings.of_rows(r) for r in rows)
    return Drive("eight", measured, first, {}, settings), second


def test_a_rear_camera_is_found_within_its_covariance_though_the_first_is_not_calibrated():
    truth, squared, off = between(FRONT, REAR), [], []
    for seed in range(8):
        found = second_camera(*drives(seed))
        error = np.array([*np.subtract(found.pose[:2], truth[:2]), 0.0])
        error[2] = wrap(found.pose.heading - truth.heading)
        off.append(error)
        squared.append(error @ np.linalg.solve(found.covariance, error))
    assert 0.4 < np.mean(squared) < 5.6  # 3; 3 standard deviations of the mean of 8
    assert found.note.startswith("# second camera relative to the first: x ")
    assert np.abs(off).max() < 0.1


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"rest": True}, "landmarks are seen by both"), ({"shared": 2}, "landmarks are seen by both")],
)
def test_a_drive_that_does_not_determine_it_ends_with_one_line(changes, words):
    with pytest.raises(HomewardError, match=words):
        second_camera(*drives(0, **changes))


def test_bearings_on_another_clock_end_with_one_line():
    drive, second = drives(0)
    later = Sightings(second.t + 1e5, second.landmark, second.bearing, second.sigma)
    with pytest.raises(HomewardError, match="0 landmarks are seen by both"):
        second_camera(drive, later)


def test_bearings_that_are_too_noisy_do_not_determine_it():
    drive, second = drives(0)
    noisy = drive.settings.model_copy(update={"sensor": Sensor(bearing_sigma=0.3)})
    with pytest.raises(HomewardError, match="does not determine the second camera"):
        second_camera(replace(drive, settings=noisy), second)


def test_a_camera_of_the_column_is_found_and_written_for_the_next_run():
    drive = simulated(5)
    rough = {"rear": {"x": 0.0, "yaw": 3.0}}
    settings = DriveSettings(sensor=drive.settings.sensor, cameras=rough)
    found = calibrated_second(replace(drive, settings=settings), "rear", RobotSettings()).on_robot
    off = np.array([found.x + 0.2, found.y, wrap(found.yaw - math.pi)])
    sigmas = np.array([found.x_sigma, found.y_sigma, found.yaw_sigma])
    assert (np.abs(off) < 4.0 * sigmas).all()
    assert (sigmas < [0.05, 0.05, 0.02]).all()
