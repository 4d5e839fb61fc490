"""The gate: which sightings of a stamp agree with the others."""

import math

import numpy as np
import pytest
from scipy.special import chdtri

from homeward.localizer.motions import NC, Motion
from homeward.localizer.reference import frame
from homeward.localizer.tunables import FALSE_ALARM


def consistent_subset(residual, spread, most, likely=None):
    """As in the gate; odometry has none where it is, if not told otherwise."""
    none = np.zeros(residual.size, bool)
    return frame.consistent_subset(residual, spread, most, none if likely is None else likely)


def spread(m, common, noise=0.01):
    """Covariance of m residuals that share one unknown turn, and have noise of their own [rad]."""
    return common**2 * np.ones((m, m)) + noise**2 * np.eye(m)


def test_what_all_have_in_common_is_no_reason_to_leave_one_out():
    assert consistent_subset(np.full(8, 0.3), spread(8, 0.1), 4.0).all()


def test_one_that_differs_is_left_out_though_it_is_within_what_all_may_have_in_common():
    residual = np.full(8, 0.02)
    residual[3] = 0.1
    assert consistent_subset(residual, spread(8, 0.1), 4.0).tolist() == [i != 3 for i in range(8)]


@pytest.mark.parametrize("wrong", [[0, 1], [2, 5, 6]])
def test_several_that_differ_are_left_out_one_by_one(wrong):
    rng = np.random.default_rng(len(wrong))
    residual = 0.05 + 0.01 * rng.normal(size=10)
    residual[wrong] += rng.uniform(0.1, 0.4, len(wrong))
    left = np.flatnonzero(~consistent_subset(residual, spread(10, 0.1), 4.0))
    assert left.tolist() == wrong


def test_of_two_nobody_can_tell_which_is_wrong():
    assert consistent_subset(np.array([0.0, 0.5]), spread(2, 0.1), 4.0).all()


def test_bearings_without_noise_do_no_harm():
    assert consistent_subset(np.zeros(4), np.zeros((4, 4)), 4.0).all()


def test_right_ones_are_seldom_left_out():
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(np.zeros(6), spread(6, 0.1), 500)
    assert np.mean([consistent_subset(each, spread(6, 0.1), 4.0).all() for each in draws]) > 0.995


def test_where_as_many_differ_as_agree_nobody_is_left_out():
    rng = np.random.default_rng(0)
    residual = 0.005 * rng.normal(size=6)
    residual[:3] += 0.2
    assert consistent_subset(residual, spread(6, 0.5), 4.0).all()


@pytest.mark.parametrize(("likely", "left"), [([0, 1, 2], [3, 4, 5]), ([3, 4], [])])
def test_where_as_many_differ_as_agree_odometry_decides_if_half_are_where_it_has_them(likely, left):
    residual = np.array([0.0, 0.01, -0.005, 0.2, 0.21, 0.2])
    told = np.isin(np.arange(6), likely)
    assert np.flatnonzero(~consistent_subset(residual, spread(6, 0.5), 4.0, told)).tolist() == left


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_numbers_that_are_none_end_it(value):
    residual, wild = np.full(5, 0.01), spread(5, 0.1)
    residual[2] = value
    with np.errstate(all="ignore"):
        consistent_subset(residual, spread(5, 0.1), 4.0)
        wild[2, 2] = value
        consistent_subset(np.full(5, 0.01), wild, 4.0)


def test_what_is_lost_in_rounding_is_no_error():
    assert consistent_subset(np.full(4, 0.1), np.full((4, 4), 1e8), 4.0).all()


@pytest.mark.parametrize("m", [3, 9, 40])
def test_a_third_that_differs_is_left_out(m):
    rng = np.random.default_rng(m)
    factor = rng.normal(size=(m, 3))
    covariance = 0.05**2 * factor @ factor.T + np.diag(rng.uniform(0.005, 0.02, m) ** 2)
    residual = rng.multivariate_normal(np.zeros(m), covariance)
    wrong = m // 3 if m > 3 else 0  # three that have three unknowns in common tell nothing
    residual[:wrong] += rng.choice([-0.3, 0.3], wrong)
    assert consistent_subset(residual, covariance, 4.0).tolist() == (np.arange(m) >= wrong).tolist()


def test_where_nothing_can_be_told_all_agree():
    assert consistent_subset(np.ones(3), -np.eye(3), 4.0, np.ones(3, bool)).all()


def ahead(residual, sigma=0.01):
    """Bearings of landmarks all round, 3 m away, that are off by `residual` (m,) [rad]."""
    m = residual.size
    angle = 2.0 * np.pi * np.arange(m) / m
    by_place = np.stack([-np.sin(angle), np.cos(angle)], axis=1) / 3.0
    return frame.Prediction(residual, by_place, sigma**2 * np.eye(m))


def by_shift(m, shift):
    """How far bearings of `ahead` are off where the robot is so much farther along [rad]."""
    return -shift * ahead(np.zeros(m)).by_place[:, 0]


def stands(sigma):
    """No motion, as uncertain as that [m]."""
    return Motion(np.zeros(3), np.diag([sigma, sigma, 0.0]) ** 2, np.zeros((3, NC)))


def contradicts(seen, motion, heading):
    """Whether all bearings contradict a motion."""
    by_motion = frame.motion_covariance(seen, motion, heading)
    everything = np.ones(len(seen.residual), bool)
    square = frame.joint_square(seen, by_motion, everything)
    return square > 0.0 and square > chdtri(len(everything), FALSE_ALARM)


def denies(residual, motion, heading):
    return contradicts(ahead(residual), motion, heading)


def test_a_motion_is_denied_by_all_together_where_none_is_far_off():
    off = by_shift(12, 0.08)
    assert np.abs(off).max() < 3.0 * 0.01
    assert denies(off, stands(0.0), 0.3)
    assert not denies(off, stands(0.08), 0.3)
    assert not denies(off[:2], stands(0.0), 0.3)


def test_a_right_motion_is_seldom_denied():
    rng = np.random.default_rng(0)
    noise = 0.01 * rng.normal(size=(2000, 10))
    for sigma in (0.0, 0.1):
        drawn = noise + by_shift(10, 1.0) * sigma * rng.normal(size=(2000, 1))
        denied = np.mean([denies(r, stands(sigma), 0.0) for r in drawn])
        assert denied < 3.0 * FALSE_ALARM


def test_two_landmarks_show_a_turn_that_odometry_missed_only_if_both_are_off_by_the_same_angle():
    turn = np.array([0.06, 0.07])

    def shows(residual, apart):
        seen = ahead(np.array(residual))
        seen.by_place[:] = np.array([[0.0, 1.0], [-math.sin(apart), math.cos(apart)]]) / 3.0
        motion = Motion(np.zeros(3), np.diag([0.01, 0.01, 0.01]) ** 2, np.zeros((3, NC)))
        return contradicts(seen, motion, 0.0)

    assert shows(turn, 0.8)
    assert not shows(0.1 * turn, 0.8)  # odometry may err by that
    assert not shows([0.0, 0.07], 0.8)  # one landmark has moved
    assert not shows(turn, 0.1)  # both may be on a box that has moved
