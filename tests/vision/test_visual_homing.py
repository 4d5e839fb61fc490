"""The pose from home's picture: exact at home for any map, and unverified when uncertain."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scripted_map import SIGMA, Map, bearings, compared, scene

from homeward.drives.settings import Mount, OdometryNoise, Sensor
from homeward.estimator import Counts, Status
from homeward.geometry.frames import Pose, between, compose, to_polar
from homeward.reasons import Rejection
from homeward.vision.homing.fix import DIRECTION_HOLD_S, POSE_HOLD_S
from homeward.vision.homing.resection import Direction, HomeLandmarks, predict_bearings, resect
from homeward.vision.homing.visual_homing import VisualHoming

WIDE, LEVEL = np.diag([10.0, 10.0]), 1e-6 * np.eye(2)


def anchors(points, camera, scale=1.0, share=0.05):
    """Return the landmarks seen from a camera's pose, the map being too large by a factor."""
    home = bearings(points, Pose(0.0, 0.0, 0.0))
    distance = scale * np.hypot(*points.T)
    spread = np.full(len(points), SIGMA)
    known, lean = np.ones(len(points), bool), np.zeros((len(points), 2))
    now = bearings(points, camera)
    return HomeLandmarks(home, now, spread, distance, share * distance, known, lean)


def guess(camera, covariance=WIDE):
    polar = to_polar(camera)
    return Direction(float(polar.theta), float(polar.alpha), covariance)


@pytest.mark.parametrize("seed", range(4))
def test_exact_bearings_give_the_pose_back(seed):
    rng = np.random.default_rng(seed)
    camera = Pose(*rng.uniform(-0.6, 0.6, 2).tolist(), rng.uniform(-3, 3))
    found = resect(anchors(scene(seed=seed), camera), guess(camera), LEVEL)
    np.testing.assert_allclose(found.pose, camera, atol=1e-5)
    assert found.agrees.all()


def test_the_jacobian_is_the_derivative():
    seen, step = anchors(scene(), Pose(0.5, -0.3, 0.7)), 1e-6
    seen = replace(seen, lean=np.random.default_rng(0).normal(0.0, 0.3, (24, 2)))
    x = np.array([0.4, -0.2, 0.6, 0.02, -0.03])
    jacobian = predict_bearings(seen, x)[1]
    for k in range(5):
        ahead, behind = (predict_bearings(seen, x + s * step * np.eye(5)[k])[0] for s in (1, -1))
        # The residual is measured minus predicted.
        np.testing.assert_allclose(-(ahead - behind) / (2 * step), jacobian[:, k], atol=1e-6)


def test_at_home_the_map_may_be_wrong_and_away_from_home_it_may_not():
    points = scene()
    at_home, away = Pose(0.0, 0.0, 0.4), Pose(0.8, 0.3, 0.4)
    found = resect(anchors(points, at_home, scale=1.4), guess(at_home), LEVEL)
    np.testing.assert_allclose(found.pose, at_home, atol=1e-6)
    far = resect(anchors(points, away, scale=1.4, share=0.3), guess(away), LEVEL)
    error = np.array(far.pose[:2]) - away[:2]
    assert np.hypot(*error) > 0.1
    # The error is the map's scale, and is within its covariance.
    assert error @ np.linalg.solve(far.covariance[:2, :2], error) < 9.0


def test_wrong_matches_are_outvoted_and_reported():
    camera = Pose(0.5, -0.4, 1.0)
    seen = anchors(scene(), camera)
    now = seen.now.copy()
    now[:7] += np.linspace(0.1, 0.9, 7)
    found = resect(replace(seen, now=now), guess(camera, np.diag([0.01, 0.01]) ** 2), LEVEL)
    np.testing.assert_allclose(found.pose[:2], camera[:2], atol=0.01)
    np.testing.assert_array_equal(found.agrees, np.arange(24) >= 7)


def test_an_unmapped_person_close_by_does_not_hold_the_pose_at_home():
    """The direction from two pictures alone is wrong, too, by more than its covariance."""
    rng, camera = np.random.default_rng(9), Pose(0.012, 0.017, -2.2)
    azimuth = np.concatenate([np.linspace(-1.1, 0.5, 14), rng.uniform(-1.6, 0.3, 60)])
    distance = np.concatenate([np.full(14, 1.4), np.full(60, 5.0)])
    points = distance[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    seen, known = anchors(points, camera, share=0.02), np.arange(74) < 14
    walks = np.where(np.arange(74) >= 50, rng.uniform(-0.03, 0.0, 74), 0.0)
    guessed = replace(
        seen,
        now=seen.now + walks,
        sigma=np.full(74, 0.0008),
        distance=np.full(74, 1.4),
        distance_sigma=np.where(known, seen.distance_sigma, 5.6),
        mapped=known,
    )
    direction = guess(camera, np.diag([0.077, 0.0019]) ** 2)
    misled = replace(direction, theta=direction.theta + 0.4, alpha=direction.alpha + 0.011)
    found = resect(guessed, misled, LEVEL)
    assert math.dist(found.pose[:2], camera[:2]) < 0.005


@pytest.mark.parametrize("is_known", [True, False])
def test_a_tilt_common_to_all_bearings_is_not_taken_for_independent_errors(is_known):
    """NEES of (x, y, heading) is 3 where the tilt is one unknown of the picture, and far beyond
    where it is left out."""
    rng, tilt, nees = np.random.default_rng(3), 0.01, []
    for seed in range(100):
        points, camera = scene(n=40, seed=seed), Pose(*rng.uniform(-0.2, 0.2, 3))
        seen = anchors(points, camera, share=0.001)
        lean = np.tan(rng.uniform(-0.6, 0.6, 40))[:, None]
        lean = -lean * np.column_stack([np.cos(seen.now), np.sin(seen.now)])
        off = lean @ rng.normal(0.0, tilt, 2) + SIGMA / 5 * rng.standard_normal(40)
        shaken = replace(seen, now=seen.now - off, sigma=seen.sigma / 5, lean=lean)
        found = resect(shaken, guess(camera), tilt**2 * np.eye(2) if is_known else LEVEL)
        error = np.array(found.pose) - camera
        nees.append(error @ np.linalg.solve(found.covariance, error))
    assert np.mean(nees) < 3.5 if is_known else np.mean(nees) > 20.0


def test_two_landmarks_fix_nothing():
    camera = Pose(0.5, -0.4, 1.0)
    assert resect(anchors(scene(n=2), camera), guess(camera), LEVEL) is None


def test_guessed_distances_do_not_make_the_pose_unsure():
    """Only a map's own scale is that of the pose; guesses may be off by four times."""
    points, camera = scene(n=40), Pose(0.8, -0.3, 0.5)
    seen = anchors(points, camera, share=0.02)
    known = np.arange(40) < 12
    guessed = replace(seen, distance_sigma=np.where(known, seen.distance_sigma, 10.0), mapped=known)
    spread = resect(guessed, guess(camera), LEVEL).covariance
    assert math.sqrt(np.trace(spread[:2, :2])) < 0.05


@pytest.mark.parametrize("together", [1, 8])
def test_errors_of_one_thing_are_in_the_covariance(together):
    """NEES of (x, y, heading): 3 at most where they are independent, and not far beyond if not."""
    rng, nees = np.random.default_rng(together), []
    for seed in range(200):
        points, camera = scene(n=64, seed=seed), Pose(*rng.uniform(-0.5, 0.5, 3))
        points = points[np.argsort(np.arctan2(points[:, 1], points[:, 0]))]
        seen = anchors(points, camera, share=0.001)
        off = np.repeat(SIGMA * rng.standard_normal(64 // together), together)
        found = resect(replace(seen, now=seen.now + off), guess(camera), LEVEL)
        error = np.array(found.pose) - camera
        nees.append(error @ np.linalg.solve(found.covariance, error))
    assert 1.0 < np.mean(nees) < (3.3 if together == 1 else 6.0)


def test_near_home_its_picture_is_believed_and_not_a_pose_in_the_map():
    points, camera = scene(), Pose(0.02, -0.03, 0.5)
    sight = VisualHoming(Map(points, pose=Pose(0.08, 0.05, 0.47)))
    sight.home(1.0, compared(points, camera, direction_sigma=0.5))
    said = sight.estimate(1.0)
    assert said.status is Status.LOCALISED
    np.testing.assert_allclose(said.pose, camera, atol=1e-4)


def test_a_map_that_home_s_picture_contradicts_is_not_called_sure():
    points, camera = scene(), Pose(0.8, -0.3, 0.5)
    # The same bearings from home, but at distances that have nothing to do with it.
    ray = points / np.hypot(*points.T)[:, None]
    wrong = np.random.default_rng(5).uniform(0.5, 6.0, len(points))[:, None] * ray
    sight = VisualHoming(Map(wrong, pose=Pose(0.0, 0.01, 0.5)))
    sight.home(1.0, compared(points, camera))
    said = sight.estimate(1.0)
    assert said.status is Status.UNVERIFIED
    assert "agree" in said.reason


def test_home_must_be_recognised_where_it_is_on_the_map():
    points = scene()
    near, far = (VisualHoming(Map(points, pose=Pose(x, 0.0, 0.0))) for x in (0.1, 2.0))
    for t in range(4):
        for sight in (near, far):
            sight.home(float(t), compared(points, Pose(0.1, 0.0, 0.0), accepted=False))
    assert near.estimate(4.0).status is Status.UNVERIFIED
    assert "do not match" in near.estimate(4.0).reason
    assert far.estimate(4.0).status is Status.LOCALISED


def test_the_direction_is_given_before_there_is_a_map_and_kept_by_odometry():
    points, camera = scene(), Pose(1.5, 1.0, 2.0)
    sight = VisualHoming(Map(points[:0], status=Status.MAPPING))
    assert sight.estimate(0.0).pose is None
    sight.odometry(0.0, 0.0, 0.5)
    sight.home(0.5, compared(points, camera))
    estimate = sight.estimate(0.5)
    assert estimate.status is Status.UNVERIFIED
    assert (to_polar(estimate.pose).theta, estimate.pose.heading) == pytest.approx(
        to_polar(camera)[1:]
    )
    assert estimate.covariance[0, 0] + estimate.covariance[1, 1] > 0.9  # the distance is a guess
    assert sight.estimate(0.9).pose.heading == pytest.approx(2.0 + 0.4 * 0.5)
    sight.odometry(1.0, 0.2, 0.0)
    after = sight.estimate(1.3).pose
    assert math.hypot(after.x - estimate.pose.x, after.y - estimate.pose.y) == pytest.approx(0.06)
    assert sight.estimate(0.4 + DIRECTION_HOLD_S).pose is not None
    assert sight.estimate(0.6 + DIRECTION_HOLD_S).pose is None


def test_a_pose_from_home_s_picture_gives_way_to_the_map_when_home_is_out_of_sight():
    points, camera, mapped = scene(), Pose(0.4, 0.1, 0.5), Pose(0.5, 0.1, 0.5)
    sight = VisualHoming(Map(points, pose=mapped))
    sight.home(1.0, compared(points, camera))
    assert sight.estimate(0.9 + POSE_HOLD_S).pose[0] == pytest.approx(0.4, abs=0.01)
    assert sight.estimate(1.1 + POSE_HOLD_S).pose == mapped


def test_counts_are_those_that_the_map_has_now():
    inner = Map(scene())
    sight = VisualHoming(inner)
    inner.counts = Counts(used=3)  # as where another map proved right
    assert sight.counts == Counts(used=3)


def test_between_pictures_a_pose_gets_as_unsure_as_odometry_is_noisy():
    points, begin, rate, seconds = scene(), Pose(0.4, 0.1, 0.5), 20.0, 1.0
    noise = OdometryNoise(speed_sigma=0.02, turn_sigma=0.03)
    rng, squared = np.random.default_rng(6), []
    for _ in range(200):
        sight = VisualHoming(Map(points), odometry=noise)
        sight.home(0.0, compared(points, begin))
        fixed = sight.estimate(0.0)
        for t in np.arange(0.0, seconds, 1 / rate):
            white = math.sqrt(rate) * rng.standard_normal(2)
            sight.odometry(t, 0.1 + 0.02 * white[0], 0.03 * white[1])
        there = compose(fixed.pose, Pose(0.1 * seconds, 0.0, 0.0))
        said = sight.estimate(seconds)
        error = np.array(said.pose) - there
        squared.append(error**2 / np.diagonal(said.covariance - fixed.covariance))
    x, y, heading = np.mean(squared, axis=0)
    assert 0.8 < heading < 1.25
    assert max(x, y) < 1.25  # noise along the way is taken for noise across it, too


def test_the_pose_is_the_robot_s_centre_not_the_camera_s():
    mount, home_mount = Sensor(x=0.3, y=-0.1, yaw=0.4), Mount(x=-0.2, y=0.1, yaw=-0.7)
    robot, seen_at_home = Pose(0.5, 0.2, 0.9), home_mount.pose
    camera = between(seen_at_home, compose(robot, mount.pose))
    points = scene()
    placed = [compose(seen_at_home, Pose(x, y, 0.0))[:2] for x, y in points.tolist()]
    sight = VisualHoming(Map(np.array(placed)), sensor=mount, home_sensor=home_mount)
    sight.home(0.0, compared(points, camera))
    np.testing.assert_allclose(sight.estimate(0.0).pose, robot, atol=1e-3)


def test_unmapped_landmarks_help_at_home_and_harm_nowhere():
    """Near ones are guessed to be as far as the others: that must count for little."""
    points = scene(n=30)
    points[10:] *= 0.3
    for camera in (Pose(0.002, 0.001, 0.5), Pose(0.1, 0.05, 0.5)):
        sight = VisualHoming(Map(points[:10]))
        sight.home(0.0, compared(points, camera, direction_sigma=0.3))
        np.testing.assert_allclose(sight.estimate(0.0).pose[:2], camera[:2], atol=4e-3)


def test_a_wrong_direction_near_home_is_outvoted():
    """Two pictures taken a centimetre apart give a direction that is overconfident."""
    camera = Pose(0.01, 0.0, 0.5)
    wrong = Direction(1.0, 0.5, np.diag([math.radians(2.0), math.radians(0.05)]) ** 2)
    found = resect(anchors(scene(n=80), camera), wrong, LEVEL)
    np.testing.assert_allclose(found.pose[:2], camera[:2], atol=4e-3)


def turning(t):
    """Return the pose at `t` [s] of a robot that drives the arc whose twists are from `deliver`."""
    turn, radius = 0.8 * t, 0.3 / 0.8
    return compose(
        Pose(1.2, -0.4, 0.5), Pose(radius * math.sin(turn), radius * (1.0 - math.cos(turn)), turn)
    )


def deliver(sight, until, pictures, points, rate=20.0):
    """Feed twists up to a time; a picture's stamp comes when that of its key has passed [s]."""
    waiting = sorted(pictures.items())
    for t in np.arange(0.0, until, 1 / rate):
        while waiting and waiting[0][0] <= t:
            stamp = waiting.pop(0)[1]
            sight.home(stamp, compared(points, turning(stamp)))
        sight.odometry(t, 0.3, 0.8)
    return sight.estimate(until)


@pytest.mark.parametrize("late", [0.0, 0.1, 0.33, 0.9])
def test_pictures_that_come_late_count_at_their_own_stamp(late):
    """As they do from a camera on a bus: odometry of their stamp was there before."""
    points = scene()
    pictures = {t + late: t for t in np.arange(0.2, 2.0, 0.4)}
    said = deliver(VisualHoming(Map(points)), 2.9, pictures, points)
    np.testing.assert_allclose(said.pose, turning(2.9), atol=2e-3)


def test_the_first_picture_may_be_late():
    points = scene()
    said = deliver(VisualHoming(Map(points)), 5.0, {4.8: 4.0}, points)
    np.testing.assert_allclose(said.pose, turning(5.0), atol=2e-3)


@pytest.mark.parametrize("stale", [0.1, 1.2])
def test_a_picture_older_than_another_before_is_left_out_and_counted(stale):
    points, other = scene(), Pose(-2.0, 1.0, 2.5)
    sight = VisualHoming(Map(points))
    before = deliver(sight, 2.0, {1.5: 1.5}, points)
    sight.home(1.5 - stale, compared(points, other))
    after = sight.estimate(2.0)
    assert sight.counts.rejected == {Rejection.LATE_PICTURE: 1}
    np.testing.assert_array_equal(after.pose, before.pose)
    np.testing.assert_array_equal(after.covariance, before.covariance)


@pytest.mark.parametrize("stamp", [0.5, math.nan, -math.inf])
def test_a_picture_that_is_too_late_is_left_out_and_counted(stamp):
    points = scene()
    sight = VisualHoming(Map(points))
    deliver(sight, 2.0, {}, points)
    sight.home(stamp, compared(points, turning(0.5)))
    assert sight.counts.rejected == {Rejection.LATE_PICTURE: 1}
    assert sight.estimate(2.0).pose is None


def test_refused_pictures_out_of_order_do_not_doubt_home():
    points = scene()
    sight = VisualHoming(Map(points, pose=Pose(0.1, 0.0, 0.0)))
    sight.home(5.0, compared(points, Pose(0.1, 0.0, 0.0)))
    for t in (4.9, 4.8, 4.7, 4.6):
        sight.home(t, compared(points, Pose(0.1, 0.0, 0.0), accepted=False))
    assert sight.estimate(5.0 + POSE_HOLD_S + 0.1).status is Status.LOCALISED


@pytest.mark.parametrize("seed", range(3))
def test_pictures_in_any_order_never_lead_astray(seed):
    points, rng = scene(), np.random.default_rng(seed)
    stamps = np.arange(0.1, 8.0, 0.2)
    pictures = dict(
        zip((stamps + rng.uniform(0.0, 2.0, stamps.size)).tolist(), stamps.tolist(), strict=True)
    )
    sight = VisualHoming(Map(points))
    said = deliver(sight, 8.0, pictures, points)
    np.testing.assert_allclose(said.pose, turning(8.0), atol=5e-3)
    assert sight.counts.rejected[Rejection.LATE_PICTURE] > 3
