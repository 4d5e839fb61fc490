"""Home's picture on a recorded drive: when pictures count, poses, contradictions."""

import math

import numpy as np
import pytest
from scripted_map import Map, compared, scene

from homeward.drives.drive import Odometry, Sightings
from homeward.estimator import Status
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose
from homeward.reasons import Rejection
from homeward.vision.homing.fix import DIRECTION_HOLD_S, POSE_HOLD_S
from homeward.vision.recorded.estimator import WAYS, ImageDrive, RecordedVisualHoming, way_home

POINTS = scene()
NONE = np.empty(0)
WITHOUT_MAP = POINTS[:0]
CAMERA = Pose(0.8, -0.3, 0.5)


def sight(pictures, mapped):
    """Return an estimator around a scripted map."""
    sightings = Sightings(NONE, np.empty(0, object), NONE, NONE)
    drive = ImageDrive(
        "scripted", Odometry(NONE, NONE, NONE), sightings, {}, pictures=tuple(pictures)
    )
    return RecordedVisualHoming(mapped, drive)


def apart(said, pose):
    """Return how far a pose is from an estimate's, in its own sigmas, squared."""
    off = np.array(pose) - said.pose
    off[2] = wrap(off[2])
    return off @ np.linalg.solve(said.covariance, off)


def test_a_picture_counts_from_its_own_stamp_on_and_before_bearings_of_it():
    seen = sight([(1.0, compared(POINTS, CAMERA))], Map(POINTS))
    assert seen.bearings(0.999, {}).pose is None
    said = seen.bearings(1.0, {})
    assert said.status is Status.LOCALISED
    np.testing.assert_allclose(said.pose, CAMERA, atol=1e-3)


def test_a_picture_counts_without_any_bearing_and_at_its_own_stamp():
    """Odometry of its stamp comes first; later odometry continues from it."""
    seen = sight([(1.0, compared(POINTS, Pose(0.8, -0.3, 0.0)))], Map(POINTS))
    for t in (0.0, 1.0):
        seen.odometry(t, 0.3, 0.0)
        assert seen.estimate(t).pose is None
    seen.odometry(1.5, 0.0, 0.0)
    np.testing.assert_allclose(seen.estimate(1.5).pose, (0.95, -0.3, 0.0), atol=1e-3)


def test_asking_takes_no_picture():
    seen = sight([(1.0, compared(POINTS, CAMERA))], Map(POINTS))
    assert seen.estimate(5.0).pose is None
    assert seen.estimate(0.5).pose is None


@pytest.mark.parametrize("stamp", [math.inf, math.nan])
def test_a_stamp_that_is_none_takes_no_picture(stamp):
    seen = sight([(1.0, compared(POINTS, CAMERA))], Map(POINTS))
    seen.odometry(stamp, 0.0, 0.0)
    assert seen.bearings(stamp, {}).pose is None
    assert seen.estimate(0.5).pose is None


def test_pictures_out_of_order_are_left_out_and_counted():
    other = compared(POINTS, Pose(-2.0, 1.0, 2.5))
    pictures = [(1.0, compared(POINTS, CAMERA)), (0.4, other), (0.9, other)]
    seen = sight(pictures, Map(POINTS))
    said = seen.bearings(1.0, {})
    assert seen.counts.rejected == {Rejection.LATE_PICTURE: 2}
    np.testing.assert_allclose(said.pose, CAMERA, atol=1e-3)


def test_of_pictures_with_one_stamp_all_count():
    pictures = [(1.0, None), (1.0, compared(POINTS, CAMERA)), (1.0, None)]
    assert sight(pictures, Map(POINTS)).bearings(1.0, {}).status is Status.LOCALISED


def test_what_no_picture_showed_leaves_the_map_s_word():
    pictures = [(0.1 * k, compared(POINTS, CAMERA, accepted=False)) for k in range(9)]
    pictures += [(1.0, None)]
    seen = sight(pictures, Map(POINTS, pose=CAMERA))
    said = seen.bearings(1.0, {})
    assert (said.status, said.reason, said.pose) == (Status.LOCALISED, "as scripted", CAMERA)
    assert "0 of 10 pictures" in seen.notes[-1]


def test_a_direction_without_a_distance_is_no_pose_but_in_the_reason():
    behind = compared(WITHOUT_MAP, Pose(1.5, 0.0, 0.0))
    seen = sight([(0.0, behind)], Map(WITHOUT_MAP, status=Status.MAPPING))
    said = seen.bearings(0.0, {})
    assert (said.status, said.pose, said.covariance) == (Status.MAPPING, None, None)
    assert said.reason.startswith("as scripted; home's picture gives the direction home")
    assert "home lies behind)" in said.reason
    # The robot turns to the right on the spot.
    seen.odometry(0.0, 0.0, -0.5)
    seen.odometry(1.0, 0.0, -0.5)
    assert "home lies behind to the right)" in seen.estimate(math.pi / 2).reason


@pytest.mark.parametrize("k", range(8))
def test_all_ways_home(k):
    heading, surely = 1.3, np.diag([0.01, 0.01, 0.01])
    for turn in (-0.3, 0.0, 0.3):
        to_home = heading + math.tau * k / 8 + turn
        pose = Pose(-2.0 * math.cos(to_home), -2.0 * math.sin(to_home), heading)
        assert way_home(pose, surely) == WAYS[k]


def test_an_uncertain_direction_home_is_not_reported():
    assert way_home(Pose(1.0, 0.0, 0.0), np.diag([9.0, 0.01, 0.01])) == "behind"
    assert way_home(Pose(1.0, 0.0, 0.0), np.diag([0.01, 0.4, 0.01])) is None
    assert way_home(Pose(1.0, 0.0, 0.0), np.diag([0.01, 0.01, 0.4])) is None
    assert way_home(Pose(0.0, 0.0, 0.0), np.diag([0.01, 0.01, 0.01])) is None


def test_a_map_that_the_direction_contradicts_is_unsure_and_covers_both():
    mapped = Pose(0.0, 1.0, 0.5)
    # None of its landmarks is in the map, so that the picture gives no distance.
    seen = sight([(0.0, compared(POINTS, CAMERA))], Map(WITHOUT_MAP, pose=mapped))
    said = seen.bearings(0.0, {})
    assert said.status is Status.UNVERIFIED
    assert "not the distance" in said.reason
    assert said.reason.endswith("the map disagrees")
    assert said.pose == mapped
    assert apart(said, CAMERA) < 9.0


def test_a_more_accurate_map_that_a_picture_contradicts_is_unverified():
    """Far from home the map may know more; at home nothing does."""
    mapped = Pose(0.8, 0.1, 0.5)
    accurate, less = (Map(POINTS, pose=mapped, sigma=s) for s in (0.001, 0.05))
    doubted, verified = (
        sight([(0.0, compared(POINTS, CAMERA))], m).bearings(0.0, {}) for m in (accurate, less)
    )
    assert (doubted.status, doubted.pose) == (Status.UNVERIFIED, mapped)
    assert apart(doubted, CAMERA) < 9.0
    assert verified.status is Status.LOCALISED
    np.testing.assert_allclose(verified.pose, CAMERA, atol=1e-3)


def test_a_map_whose_distances_the_picture_contradicts_is_unsure_and_covers_both():
    ray = POINTS / np.hypot(*POINTS.T)[:, None]
    wrong = np.random.default_rng(5).uniform(0.5, 6.0, len(POINTS))[:, None] * ray
    seen = sight([(0.0, compared(POINTS, CAMERA))], Map(wrong, pose=CAMERA))
    said = seen.bearings(0.0, {})
    assert (said.status, said.pose) == (Status.UNVERIFIED, CAMERA)
    assert "agree with home's picture" in said.reason
    assert math.sqrt(said.covariance[0, 0]) > 1.0


def doubting():
    """Return an estimator whose map contradicts a picture at 0 s, that map, and a later time."""
    mapped = Map(POINTS, pose=Pose(0.8, 0.1, 0.5), sigma=0.001)
    seen = sight([(0.0, compared(POINTS, CAMERA))], mapped)
    seen.bearings(0.0, {})
    return seen, mapped, POSE_HOLD_S + 1.0


def test_a_doubt_outlasts_the_picture_but_not_for_ever():
    seen, _, later = doubting()
    said = seen.estimate(later)
    assert said.status is Status.UNVERIFIED
    assert apart(said, CAMERA) < 9.0
    assert seen.estimate(DIRECTION_HOLD_S - 0.1).status is Status.UNVERIFIED
    assert seen.estimate(DIRECTION_HOLD_S + 0.1).status is Status.LOCALISED


def test_a_contradiction_ends_with_an_agreeing_picture_of_the_same_kind():
    seen, _, later = doubting()
    seen.home(later, compared(POINTS, Pose(0.8, 0.1, 0.5)))
    assert seen.estimate(later).status is Status.LOCALISED
    assert seen.estimate(2 * later).status is Status.LOCALISED


def test_a_direction_does_not_answer_for_a_distance_that_is_in_doubt():
    seen, mapped, later = doubting()
    mapped.found = []
    seen.home(later, compared(POINTS, Pose(0.8, 0.1, 0.5)))
    assert seen.estimate(later).status is Status.UNVERIFIED


def test_a_direction_ends_the_doubt_of_a_direction():
    seen = sight([(0.0, compared(POINTS, CAMERA))], Map(WITHOUT_MAP, pose=Pose(0.0, 1.0, 0.5)))
    assert seen.bearings(0.0, {}).status is Status.UNVERIFIED
    seen.home(1.0, compared(POINTS, Pose(0.0, 0.9, 0.5)))
    assert seen.estimate(1.0).status is Status.LOCALISED


@pytest.mark.parametrize("seed", range(6))
def test_whatever_is_seen_pose_covariance_and_status_go_together(seed):
    rng = np.random.default_rng(seed)
    mapped = Map(POINTS, status=Status.WAITING)
    pictures = [
        (
            0.25 * k,
            compared(
                POINTS,
                Pose(*rng.uniform(-2.0, 2.0, 3).tolist()),
                accepted=rng.random() < 0.7,
                direction_sigma=rng.choice([0.01, 0.5]),
            )
            if rng.random() < 0.8
            else None,
        )
        for k in range(80)
    ]
    seen = sight(pictures, mapped)
    for t in (0.1 * k for k in range(200)):
        if rng.random() < 0.1:
            status = rng.choice(
                [Status.WAITING, Status.MAPPING, Status.UNVERIFIED, Status.COASTING]
            )
            has = status not in (Status.WAITING, Status.MAPPING)
            mapped.pose = Pose(*rng.uniform(-2.0, 2.0, 3).tolist()) if has else None
            mapped.status, mapped.found = status, mapped.found if rng.random() < 0.8 else []
        seen.odometry(t, 0.2, 0.3)
        for said in (seen.bearings(t, {}), seen.estimate(t + 0.05)):
            assert (said.pose is None) == (said.covariance is None)
            assert (said.pose is None) == (said.status in (Status.WAITING, Status.MAPPING))
            assert said.reason
            if said.covariance is not None:
                assert np.isfinite(said.covariance).all()
                assert np.linalg.eigvalsh(said.covariance).min() > 0.0
