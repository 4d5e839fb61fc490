import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from homeward.geometry.angles import wrap
from homeward.geometry.frames import (
    Polar,
    Pose,
    bearing,
    between,
    compose,
    from_polar,
    inverse,
    polar_covariance_to_pose,
    position_sigma,
    to_polar,
)

LENGTHS = st.floats(-100, 100)
POSES = st.builds(Pose, LENGTHS, LENGTHS, st.floats(-math.pi, math.pi))


def assert_same(a, b):
    assert a.x == pytest.approx(b.x, abs=1e-9)
    assert a.y == pytest.approx(b.y, abs=1e-9)
    assert abs(wrap(a.heading - b.heading)) < 1e-9


@given(POSES, POSES, POSES)
def test_composition_is_associative(a, b, c):
    assert_same(compose(compose(a, b), c), compose(a, compose(b, c)))


@given(st.integers(0, 10_000))
def test_the_worst_direction_of_a_position_is_its_largest_eigenvalue(seed):
    roots = np.random.default_rng(seed).normal(size=(4, 3, 3))
    covariances = roots @ roots.swapaxes(-1, -2)
    worst = np.sqrt(np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1])
    assert position_sigma(covariances) == pytest.approx(worst)
    assert position_sigma(covariances[0]) == pytest.approx(worst[0])
    assert position_sigma(np.zeros((0, 2, 2))).shape == (0,)


@given(POSES)
def test_inverse_undoes(a):
    assert_same(compose(a, inverse(a)), Pose(0.0, 0.0, 0.0))
    assert_same(compose(inverse(a), a), Pose(0.0, 0.0, 0.0))


@given(POSES, POSES)
def test_between_is_what_composition_adds(a, b):
    assert_same(compose(a, between(a, b)), b)


@given(POSES)
def test_polar_and_back(pose):
    assert_same(from_polar(to_polar(pose)), pose)


@given(st.floats(0.01, 100), st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi))
def test_negative_distance_lies_on_the_other_side(R, theta, alpha):
    assert_same(from_polar(Polar(-R, theta, alpha)), from_polar(Polar(R, theta + math.pi, alpha)))


@given(POSES, POSES, LENGTHS, LENGTHS)
def test_a_bearing_does_not_depend_on_the_frame(frame, pose, x, y):
    if math.hypot(x - pose.x, y - pose.y) < 1e-3:
        return
    here = bearing(pose, x, y)
    moved = compose(frame, Pose(x, y, 0.0))
    assert abs(wrap(here - bearing(compose(frame, pose), moved.x, moved.y))) < 1e-7


def test_covariance_from_polar_matches_samples():
    rng = np.random.default_rng(3)
    mean, sigma = Polar(2.0, 0.7, -1.0), np.array([0.01, 0.01, 0.02])
    samples = np.array(mean) + rng.normal(size=(200_000, 3)) * sigma
    poses = np.column_stack(from_polar(Polar(*samples.T)))
    expected = polar_covariance_to_pose(mean, np.diag(sigma**2))
    np.testing.assert_allclose(np.cov(poses.T), expected, atol=5e-6)
