"""A front and a rear camera at different positions of one robot."""

import dataclasses
import math
import warnings

import numpy as np
import pytest
from two_cameras import SETTINGS, SIGMA, simulated

from homeward.drives.folder import read_folder, write_folder
from homeward.drives.home.when import with_home
from homeward.drives.opening import open_drive
from homeward.drives.settings import DriveSettings, HomeWhen
from homeward.errors import InputError
from homeward.geometry.angles import wrap
from homeward.localizer.home.problem import HomeProblem
from homeward.localizer.localizer import Localizer
from homeward.localizer.motions import NC, Motion, camera_after
from homeward.localizer.reference.sets import expected, linearised
from homeward.localizer.resection import poses_from_triples
from homeward.track import run

MOUNT, OFFSET = np.array([0.2, 0.05, 0.1]), np.array([-0.4, 0.03, 3.0])


def scores(drive, after=10.0):
    """Share of the time with a pose, RMSE [m] and mean NEES [1] after a time [s]."""
    track = run(drive, Localizer(drive.home, **drive.settings.robot))
    late = track.t > after
    rows = track.has_pose & late
    off = np.stack([track.x, track.y, track.heading], 1)[rows]
    off = off - np.stack(drive.truth.at(track.t[rows]), 1)
    off[:, 2] = wrap(off[:, 2])
    nees = np.einsum("ni,nij,nj->n", off, np.linalg.inv(track.covariance[rows]), off)
    return rows.sum() / late.sum(), math.sqrt((off[:, :2] ** 2).sum(1).mean()), nees.mean()


def test_two_cameras_give_a_consistent_pose_and_ignoring_their_distance_a_biased_one():
    side = {**SETTINGS, "cameras": {"rear": {"x": 0.2, "yaw": math.pi}}}
    drives = [simulated(seed) for seed in range(3)]
    right = np.mean([scores(drive) for drive in drives], axis=0)
    wrong = scores(dataclasses.replace(drives[0], settings=DriveSettings(**side)))
    assert right[0] > 0.98
    assert right[1] < 0.06 < 0.12 < wrong[1]
    assert 1.0 < right[2] < 5.0  # 3; one drive has few independent errors


def test_the_derivative_of_another_camera_by_the_calibration_is_that_of_its_pose():
    motion, calibration = (
        Motion(np.array([0.3, 0.1, 0.5]), np.eye(3), np.zeros((3, NC))),
        np.zeros(NC),
    )
    found = camera_after(motion, MOUNT, calibration, OFFSET)
    for k in range(NC):
        step = np.zeros(NC)
        step[k] = 1e-6
        ahead = camera_after(motion, MOUNT, step, OFFSET).delta
        behind = camera_after(motion, MOUNT, -step, OFFSET).delta
        np.testing.assert_allclose((ahead - behind) / 2e-6, found.jacobian[:, k], atol=1e-8)


def home_problem():
    places = np.array([[3.0, 1.0], [0.5, 3.0], [-3.0, 0.5], [-1.0, -3.0], [2.0, -2.5]])
    offsets = np.where(np.arange(5)[:, None] % 2, OFFSET, 0.0)
    problem = HomeProblem(
        mean=np.concatenate([np.zeros(4), places.ravel()]),
        covariance=np.eye(14) * 1e-4,
        bearings=np.zeros(5),
        sigmas=np.full(5, SIGMA),
        mount=MOUNT,
        same_camera=True,
        moved_prior=0.1,
        offsets=offsets,
    )
    return problem, places, offsets


def test_home_bearings_of_two_cameras_have_the_derivatives_of_their_positions():
    problem, places, offsets = home_problem()
    home = np.array([0.1, -0.2, 0.3])
    found = linearised(problem.arrays, home, problem.mean)
    _, _, by_home, by_yaw = expected(problem, home, places, 0.0, offsets)
    for k in range(3):
        step = np.eye(3)[k] * 1e-6
        ahead, behind = (
            expected(problem, home + s, places, 0.0, offsets)[0] for s in (step, -step)
        )
        np.testing.assert_allclose(wrap(ahead - behind) / 2e-6, by_home[:, k], atol=1e-7)
    ahead, behind = (expected(problem, home, places, s, offsets)[0] for s in (1e-6, -1e-6))
    np.testing.assert_allclose(wrap(ahead - behind) / 2e-6, by_yaw, atol=1e-7)
    np.testing.assert_allclose(found.by_yaw, by_yaw)


def test_three_bearings_of_two_cameras_give_the_pose_of_the_first():
    problem, places, offsets = home_problem()
    home = np.array([0.1, -0.2, 0.3])
    bearings = expected(problem, home, places, 0.0, offsets)[0]
    camera = np.array([0.1 + 0.2 * math.cos(0.3) - 0.05 * math.sin(0.3), 0.0, 0.4])
    camera[1] = -0.2 + 0.2 * math.sin(0.3) + 0.05 * math.cos(0.3)
    found = poses_from_triples(places, bearings, offsets)
    assert len(found) >= 8
    assert np.median(np.hypot(*(found[:, :2] - camera[:2]).T)) < 0.005


def test_a_folder_with_the_column_camera_reads_back(tmp_path):
    drive = simulated(0, seconds=5.0)
    write_folder(drive, tmp_path / "drive")
    read = read_folder(tmp_path / "drive")
    assert [*read.sightings.camera] == [*drive.sightings.camera]
    assert read.home == drive.home
    assert read.settings.cameras["rear"].yaw == math.pi
    assert "repeated" not in str(read.remarks)


def test_a_camera_without_extrinsics_is_named(tmp_path):
    drive = simulated(0, seconds=5.0)
    settings = DriveSettings(sensor=SETTINGS["sensor"])
    write_folder(dataclasses.replace(drive, settings=settings), tmp_path / "drive")
    with pytest.raises(InputError, match="cameras 'front' and 'rear': only one") as error:
        open_drive(str(tmp_path / "drive"))
    assert "\n" not in str(error.value)


def test_the_first_of_the_cameras_is_the_reference_where_all_are_listed(tmp_path):
    cameras = {"front": {"x": 0.2}, **SETTINGS["cameras"]}
    settings = DriveSettings(cameras=cameras, odometry=SETTINGS["odometry"])
    write_folder(dataclasses.replace(simulated(0, 5.0), settings=settings), tmp_path / "drive")
    assert open_drive(str(tmp_path / "drive")).settings.sensor.x == 0.2


def test_two_frames_of_one_stamp_give_one_row(tmp_path):
    drive = simulated(0, seconds=5.0)
    seen = drive.sightings
    together = dataclasses.replace(seen, t=np.floor(seen.t / 0.2 + 1e-6) * 0.2)
    drive = dataclasses.replace(drive, sightings=together)
    track = run(drive, Localizer(drive.home, **drive.settings.robot))
    assert (np.diff(track.t) > 0).all()
    assert track.has_pose[-1]


def test_home_at_rest_has_bearings_of_both_cameras():
    drive = simulated(0, seconds=5.0, speed=0.0, rate=0.0)
    rest = with_home(dataclasses.replace(drive, home={}), HomeWhen(during=(0.0, 4.0)))
    assert {seen.camera for seen in rest.home.values()} == {"front", "rear"}
    for name, seen in rest.home.items():
        if seen.camera == drive.home[name].camera:
            assert abs(wrap(seen.bearing - drive.home[name].bearing)) < 5 * SIGMA


def test_home_by_a_turn_is_from_the_first_camera_by_the_sightings_of_both():
    drive = simulated(0, seconds=16.0, speed=0.0)
    found = with_home(dataclasses.replace(drive, home={}), HomeWhen(spin=(0.0, 15.9)))
    assert {seen.camera for seen in found.home.values()} == {""}
    own = [n for n, seen in drive.home.items() if seen.camera == "front"]
    off = [wrap(found.home[n].bearing - drive.home[n].bearing) for n in own]
    assert len(found.home) == 14
    assert np.std(off) < 3 * SIGMA


def test_bearings_that_differ_by_next_to_nothing_give_no_warning():
    points = np.array([[1.0, 0.0], [2.0, 0.0], [0.0, 3.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(poses_from_triples(points, np.array([0.0, 1e-310, 1.2]))) <= 1
