"""A filter online: what a user of `odometry`, `bearings` and `estimate` would name."""

import math

import numpy as np
import pytest
from lab.model_by_hand import scene

from homeward.drives.drive import Drive, HomeBearing, Odometry, Sightings
from homeward.drives.settings import DriveSettings, Mount, Sensor, Start
from homeward.errors import InputError
from homeward.estimator import Status
from homeward.geometry.frames import Pose, Twist, advance, bearing, compose, from_polar
from homeward.lab.engine.estimators.runner import MAX_BELIEF
from homeward.reasons import Rejection
from homeward.registry import NEED_START, make_estimator

NAMES = NEED_START
NOTHING = np.empty(0)
CENTRE = Pose(0.0, 0.0, 0.0)


def make_drive(q=7, seed=1, start=None, **settings):
    landmarks, polar, _, stored = scene(q, seed)
    start = start or Start(R=polar.R, theta=polar.theta, alpha=polar.alpha)
    drive = Drive(
        name="test",
        odometry=Odometry(NOTHING, NOTHING, NOTHING),
        sightings=Sightings(NOTHING, np.empty(0, object), NOTHING, NOTHING),
        home={f"L{i}": HomeBearing(float(b)) for i, b in enumerate(stored)},
        settings=DriveSettings(start=start, **settings),
    )
    return drive, landmarks, from_polar(polar)


def look(pose, landmarks):
    return {f"L{i}": float(bearing(pose, *mark)) for i, mark in enumerate(landmarks)}


def follow(estimator, landmarks, pose, seconds=12.0, mount=CENTRE):
    """Drive a small circle with exact odometry at 20 Hz and exact sightings at 5 Hz."""
    twist = Twist(0.125, 0.5)
    for k in range(round(seconds * 20)):
        t = k / 20
        estimator.odometry(t, *twist)
        if k % 4 == 0:
            estimate = estimator.bearings(t, look(compose(pose, mount), landmarks))
        pose = advance(pose, twist, 0.05)
    return estimate, pose


# The pi-ekf steers itself off; the others take no guard, or the mean over their prior.
@pytest.mark.parametrize("name", ["ekf", "a-ekf", "schmidt"])
def test_a_filter_stays_on_the_truth_without_noise(name):
    drive, landmarks, pose = make_drive()
    estimator = make_estimator(name, drive, {"guard": 1e-4})
    follow(estimator, landmarks, pose)
    estimate = estimator.estimate(12.0)
    _, truth = follow(make_estimator(name, drive), landmarks, pose)
    assert math.hypot(estimate.pose.x - truth.x, estimate.pose.y - truth.y) < 0.02
    assert estimate.status is Status.LOCALISED
    for known, mark in zip(estimator.landmarks(), landmarks, strict=True):
        if known.sigma_distance < 0.1:
            assert math.hypot(known.x - mark[0], known.y - mark[1]) < 0.3


def test_bearings_correct_a_wrong_start():
    off = Start(R=0.85, theta=-0.8, alpha=0.25, sigma_R=0.1)
    drive, landmarks, pose = make_drive(start=off)
    estimator = make_estimator("ekf", drive)
    before = estimator.estimate(0.0)
    assert before.status is Status.WAITING
    follow(estimator, landmarks, pose, 20.0)
    # A straight look at dead reckoning from the same start shows what the bearings are worth.
    blind = make_estimator("ekf", drive)
    _, truth = follow(blind, landmarks[:0], pose, 20.0)
    errors = [
        math.hypot(e.estimate(20.0).pose.x - truth.x, e.estimate(20.0).pose.y - truth.y)
        for e in (estimator, blind)
    ]
    assert errors[0] < 0.5 * errors[1]


@pytest.mark.parametrize("name", NAMES)
def test_estimate_changes_nothing(name):
    drive, landmarks, pose = make_drive()
    asked, left = make_estimator(name, drive), make_estimator(name, drive)
    for estimator in (asked, left):
        follow(estimator, landmarks, pose, 2.0)
        if estimator is asked:
            for t in (2.0, 2.7, 60.0):
                estimator.estimate(t)
        follow_on = estimator.bearings(3.0, look(pose, landmarks))
    assert asked.estimate(3.0).pose == left.estimate(3.0).pose
    assert follow_on.pose == asked.estimate(3.0).pose


def test_uncertainty_grows_in_a_gap_and_more_without_odometry():
    drive, landmarks, pose = make_drive()
    estimator = make_estimator("ekf", drive)
    follow(estimator, landmarks, pose, 5.0)
    sigmas = [np.linalg.norm(estimator.estimate(t).sigmas[:2]) for t in (5.0, 5.9, 10.0, 60.0)]
    assert sigmas == sorted(sigmas)
    assert sigmas[2] > sigmas[1] + 0.5
    assert estimator.estimate(5.9).status is Status.LOCALISED
    silent = estimator.estimate(60.0)
    assert silent.status is Status.UNVERIFIED
    assert "no odometry" in silent.reason
    # The twist holds for a second, then the robot counts as standing: it does not drive on.
    assert estimator.estimate(10.0).pose == pytest.approx(estimator.estimate(60.0).pose)


def test_late_and_broken_samples_are_counted_and_change_nothing():
    drive, landmarks, pose = make_drive()
    estimator = make_estimator("ekf", drive)
    follow(estimator, landmarks, pose, 5.0)
    before = estimator.estimate(5.0)
    estimator.odometry(1.0, 0.5, 0.5)
    estimator.odometry(math.nan, 0.5, 0.5)
    estimator.odometry(5.0, math.inf, 0.5)
    estimator.bearings(2.0, {"L0": 1.0})
    estimator.bearings(5.0, {"L0": math.nan, "stranger": 0.3})
    assert estimator.estimate(5.0).pose == before.pose
    assert estimator.counts.rejected == {
        Rejection.LATE_ODOMETRY: 1,
        Rejection.BAD_ODOMETRY: 2,
        Rejection.LATE_BEARINGS: 1,
        Rejection.BAD_BEARING: 1,
        Rejection.NO_HOME_BEARING: 1,
    }


def test_the_gate_rejects_a_wrong_sighting_and_reports_it():
    drive, landmarks, pose = make_drive()
    results = {}
    for gate in (0.999, None):
        estimator = make_estimator("ekf", drive, {"gate": gate})
        _, there = follow(estimator, landmarks, pose, 8.0)
        seen = look(there, landmarks)
        seen["L3"] += 1.5
        estimate = estimator.bearings(8.0, seen)
        results[gate] = math.hypot(estimate.pose.x - there.x, estimate.pose.y - there.y)
        wrong = next(i for i in estimate.innovations if i.landmark == "L3")
        assert wrong.accepted is (gate is None)
        assert wrong.value == pytest.approx(1.5, abs=0.1)
        assert (Rejection.OUTSIDE_GATE in estimator.counts.rejected) is (gate is not None)
    assert results[0.999] < results[None]


def test_minimum_visible_leaves_poor_stamps_out():
    drive, _, _ = make_drive()
    estimator = make_estimator("ekf", drive, {"minimum_visible": 2})
    estimator.odometry(0.0, 0.1, 0.0)
    estimator.bearings(0.1, {"L0": 1.0})
    assert all(known.sightings == 0 for known in estimator.landmarks())
    estimator.bearings(0.2, {"L0": 1.0, "L1": -1.0})
    assert sum(known.sightings for known in estimator.landmarks()) == 2


@pytest.mark.parametrize("name", NAMES)
def test_every_filter_is_finite_whatever_comes(name):
    drive, _, _ = make_drive(start=Start(R=0.0, theta=0.0, alpha=0.0))
    rng = np.random.default_rng(5)
    estimator = make_estimator(name, drive)
    t = 0.0
    for _ in range(400):
        t += float(rng.choice([0.0, 0.05, 1.0, 300.0], p=[0.1, 0.8, 0.08, 0.02]))
        estimator.odometry(t, rng.normal() * 5, rng.normal() * 5)
        seen = {f"L{i}": rng.uniform(-9, 9) for i in range(7) if rng.random() < 0.4}
        estimate = estimator.bearings(t, seen)
        assert np.all(np.isfinite(estimate.pose))
        assert np.all(np.isfinite(estimate.covariance))
        assert np.all(np.isfinite(estimate.sigmas))


def test_a_belief_that_diverges_is_not_taken():
    drive, _, _ = make_drive()
    estimator = make_estimator("ekf", drive)
    estimator.odometry(0.0, 1e300, 0.0)
    assert np.all(np.abs(estimator.estimate(0.5).pose) < MAX_BELIEF)
    estimator.odometry(0.5, 0.1, 0.0)
    assert estimator.counts.rejected[Rejection.DIVERGED] >= 1


def test_yaw_of_the_camera_is_taken_out_and_its_offset_is_owned_up_to():
    mount = Mount(yaw=0.7)
    drive, landmarks, pose = make_drive(sensor=Sensor(yaw=0.7), home_sensor=mount)
    home = {k: HomeBearing(b.bearing - 0.7) for k, b in drive.home.items()}
    turned = Drive(drive.name, drive.odometry, drive.sightings, home, drive.settings)
    plain, _, _ = make_drive()
    yawed, straight = make_estimator("ekf", turned), make_estimator("ekf", plain)
    a, _ = follow(yawed, landmarks, pose, 6.0, mount.pose)
    b, _ = follow(straight, landmarks, pose, 6.0)
    assert a.pose == pytest.approx(b.pose, abs=1e-9)
    assert yawed.notes == ()
    ahead, _, _ = make_drive(sensor=Sensor(x=0.2))
    assert "0.20 m" in make_estimator("ekf", ahead).notes[0]


def test_an_estimated_home_bearing_finds_its_value():
    drive, landmarks, pose = make_drive()
    home = dict(drive.home)
    home["L2"] = HomeBearing(home["L2"].bearing + 0.3)
    wrong = Drive(drive.name, drive.odometry, drive.sightings, home, drive.settings)
    settings = {"parameters": ["L2"], "parameter_sigma": 0.5}
    estimator = make_estimator("a-ekf", wrong, settings)
    follow(estimator, landmarks, pose, 40.0)
    found = estimator.landmarks()[2]
    true = math.atan2(landmarks[2][1], landmarks[2][0])
    assert abs(found.home_bearing_estimated - true) < 0.1
    assert found.home_bearing_stored == pytest.approx(true + 0.3)


def test_hundreds_of_landmarks_are_no_obstacle():
    drive, landmarks, pose = make_drive(q=200)
    estimator = make_estimator("ekf", drive)
    estimate, _ = follow(estimator, landmarks, pose, 1.0)
    assert np.all(np.isfinite(estimate.covariance))


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("kalman", {}, "no estimator 'kalman'"),
        ("ekf", {"gate": 2.0}, "gate"),
        ("ekf", {"speed": 1.0}, "speed"),
        ("a-ekf", {"parameters": ["L9"]}, "'L9'"),
        ("a-ekf", {"parameters": ["L1", "L1"]}, "twice"),
        ("pi-ekf", {"integral_gain": [[1.0]]}, "10 rows of 7"),
    ],
)
def test_settings_that_do_not_fit_are_named(name, settings, words):
    drive, _, _ = make_drive()
    with pytest.raises(InputError, match=words) as caught:
        make_estimator(name, drive, settings)
    assert "\n" not in str(caught.value)


def test_filters_ask_for_a_start_prior_and_for_landmarks():
    drive, _, _ = make_drive()
    lost = Drive(drive.name, drive.odometry, drive.sightings, drive.home)
    with pytest.raises(InputError, match="start prior"):
        make_estimator("ekf", lost)
    blind = Drive(drive.name, drive.odometry, drive.sightings, {}, drive.settings)
    with pytest.raises(InputError, match="saw no landmark"):
        make_estimator("ekf", blind)


@pytest.mark.parametrize("name", NAMES)
def test_one_landmark_is_enough_to_run(name):
    drive, landmarks, pose = make_drive(q=1)
    estimate, _ = follow(make_estimator(name, drive), landmarks, pose, 2.0)
    assert np.all(np.isfinite(estimate.pose))
    assert estimate.status is Status.UNVERIFIED


def test_a_sigma_that_is_no_number_leaves_the_usual_one():
    drive, landmarks, pose = make_drive()
    given, left = make_estimator("ekf", drive), make_estimator("ekf", drive)
    for estimator, sigmas in ((given, {"L0": math.inf, "L1": math.nan, "L2": -1.0}), (left, None)):
        for t in (0.0, 0.1):
            estimate = estimator.bearings(t, look(pose, landmarks), sigmas)
        assert estimator.counts.used == 14
    assert given.estimate(0.1).pose == left.estimate(0.1).pose == estimate.pose


def test_an_update_that_diverges_is_counted_and_not_used():
    drive, _, _ = make_drive()
    estimator = make_estimator("ekf", drive)
    estimator.odometry(0.0, 0.1, 0.0)
    before = estimator.estimate(0.0).pose
    estimator.bearings(0.0, {"L0": 1.0}, {"L0": 1e200})
    assert estimator.counts.rejected == {Rejection.DIVERGED: 1}
    assert (estimator.counts.used, estimator.estimate(0.0).pose) == (0, before)


def test_a_landmark_behind_home_has_no_place():
    drive, landmarks, pose = make_drive()
    estimator = make_estimator("ekf", drive)
    # On the other side of the robot than where home saw it, so that the rays meet behind home.
    seen = look(pose, landmarks)
    estimator.bearings(0.0, {name: beta + math.pi / 2 for name, beta in seen.items()})
    known = estimator.landmarks()
    assert any(math.isnan(k.distance) for k in known)
    for k in known:
        assert k.sightings == 1
        assert math.isnan(k.x) == math.isnan(k.distance)
        assert math.isnan(k.distance) or k.distance > 0


def test_a_pose_that_the_landmarks_do_not_bear_out_is_not_relied_on():
    drive, landmarks, pose = make_drive()
    estimator = make_estimator("ekf", drive)
    estimate, there = follow(estimator, landmarks, pose, 6.0)
    assert estimate.status is Status.LOCALISED
    rng = np.random.default_rng(3)
    for k in range(10):
        t = 6.0 + 0.2 * k
        estimator.odometry(t, 0.0, 0.0)
        wrong = {i: b + rng.uniform(0.8, 2.0) for i, b in look(there, landmarks).items()}
        estimate = estimator.bearings(t, wrong)
    assert estimate.status is Status.UNVERIFIED


def test_without_sightings_but_with_odometry_it_coasts():
    drive, landmarks, pose = make_drive()
    estimator = make_estimator("ekf", drive)
    follow(estimator, landmarks, pose, 6.0)
    for k in range(40):
        estimator.odometry(6.0 + 0.1 * k, 0.1, 0.0)
    assert estimator.estimate(9.9).status is Status.COASTING
