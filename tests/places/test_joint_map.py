"""Two maps become one: no more is known of it than is right, wherever they lie."""

import math
from dataclasses import replace

import numpy as np
import pytest
from visited import SCALE_SIGMA, SIGMA, mapped, new_place, room

from homeward.drives.drive import HomeBearing
from homeward.geometry.frames import Pose, bearing, compose
from homeward.places.joint_map import JointMap, fused

RUNS = 60


def off_home_frame(place, places):
    """How far a map is off in the frame of its home, and the covariance of that."""
    there = place.in_home_frame("home")
    truth = np.array([places[n] for n in there.names]).ravel()
    return there.mean - truth, there.covariance


def test_fused_maps_are_as_uncertain_as_they_are_wrong():
    """Over many rooms the normalised squared error of the fused map is its dimension."""
    squares = []
    for seed in range(RUNS):
        rng, places = np.random.default_rng(seed), room(8, seed)
        home = np.array([0.01, 0.01, math.sqrt(1e-5)]) * rng.normal(size=3)
        first = mapped(places, rng).with_home(
            "home", {}, Pose(0.0, 0.0, 0.0), home, np.diag([1e-4, 1e-4, 1e-5])
        )
        place = first.at_home("home")
        for pose in ((1.0, -2.0, 2.5), (-3.0, 1.0, -0.7)):
            both, _ = fused(place, mapped(places, rng, pose), set(places))
            place = both.at_home("home")
        off, covariance = off_home_frame(place, places)
        squares.append(off @ np.linalg.solve(covariance, off) / off.size)
    assert np.mean(squares) == pytest.approx(1.0, abs=4 * math.sqrt(2.0 / 16 / RUNS))


def test_fusion_improves_common_landmarks_and_keeps_the_others():
    rng, places = np.random.default_rng(1), room(12)
    names = list(places)
    place = new_place({n: places[n] for n in names[:8]}, rng).map
    visit = mapped({n: places[n] for n in names[4:]}, rng, (1.0, 1.0, 3.0))
    both = fused(place, visit, names[4:8])[0].at_home("home")
    assert set(both.names) == set(names)
    assert both.homes == ("home",)
    before = dict(zip(place.names, place.sigmas, strict=True))
    after = dict(zip(both.names, both.sigmas, strict=True))
    assert all(after[n] < before[n] for n in names[4:8])
    off, covariance = off_home_frame(both, places)
    assert off @ np.linalg.solve(covariance, off) < 24 + 4 * math.sqrt(2 * 24)


def test_a_map_moved_as_a_whole_is_the_same_map():
    rng, places = np.random.default_rng(2), room(6)
    place = new_place(places, rng).map
    moved = place.in_frame_of(np.array([3.0, -1.0, 2.0]), np.zeros((3, 3)))
    again = moved.in_home_frame("home")
    straight = place.in_home_frame("home")
    assert again.mean == pytest.approx(straight.mean)
    assert again.covariance == pytest.approx(straight.covariance, abs=1e-12)


def test_a_home_is_found_by_what_was_seen_there():
    rng, places = np.random.default_rng(3), room(10)
    held, home = mapped(places, rng), Pose(0.5, -0.7, 1.2)
    exact = JointMap(held.names, (), np.array(list(places.values())).ravel(), 1e-8 * np.eye(20))
    mounts = [Pose(0.2, 0.0, 0.1), Pose(-0.4, 0.1, 3.0)] * 5  # of two cameras
    seen = {
        n: HomeBearing(float(bearing(compose(home, mount), *p)), 1e-3)
        for (n, p), mount in zip(places.items(), mounts, strict=True)
    }
    near = np.add(home, (0.3, -0.2, 0.2))
    found = exact.with_home("home", seen, np.array(mounts), near, np.diag([25.0, 25.0, 9.0]))
    assert found.poses[0] == pytest.approx(np.array(home), abs=1e-4)
    assert 1e-4 < math.sqrt(found.covariance[-3, -3]) < 1e-2


def test_a_place_keeps_its_size_over_many_visits_that_have_no_scale():
    rng, places = np.random.default_rng(0), room(40)

    def size(joint):
        return np.linalg.norm(joint.positions - joint.positions.mean(axis=0))

    def as_measured(pose):
        joint = mapped(places, rng, pose)
        variances = SIGMA**2 * np.eye(joint.mean.size)
        spread = variances + SCALE_SIGMA**2 * np.outer(joint.mean, joint.mean)
        return replace(joint, covariance=spread)

    place = as_measured((0.0, 0.0, 0.0))
    before = size(place)
    for _ in range(10):
        visit = as_measured((1.0, -2.0, rng.uniform(-3.0, 3.0)))
        place, _ = fused(place, visit, list(places), scale_sigma=0.3)
    assert size(place) == pytest.approx(before, rel=0.01)
