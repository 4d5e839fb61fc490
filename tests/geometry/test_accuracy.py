"""Accuracy of poses: deviation, protection level, and the limit with hysteresis."""

import math

import numpy as np
import pytest
from scipy.stats import chi2, norm

from homeward.estimator import Estimate, Status
from homeward.geometry.frames import Pose
from homeward.geometry.statistics import OUTSIDE, AccuracyLimit, PoseAccuracy


def covariance(major, minor, turn=0.3, heading=0.01):
    c, s = math.cos(turn), math.sin(turn)
    axes = np.array([[c, -s], [s, c]])
    whole = np.zeros((3, 3))
    whole[:2, :2] = axes @ np.diag([major**2, minor**2]) @ axes.T
    whole[2, 2] = heading**2
    return whole


def test_a_circle_and_a_line_have_the_quantiles_of_two_and_of_one_dimension():
    circle, line = PoseAccuracy.of(covariance(0.2, 0.2)), PoseAccuracy.of(covariance(0.2, 0.0))
    assert circle.position == line.position == pytest.approx(0.2)
    assert circle.heading == pytest.approx(0.01)
    assert circle.protection_level == pytest.approx(0.2 * math.sqrt(chi2.isf(OUTSIDE, 2)), rel=1e-6)
    assert line.protection_level == pytest.approx(0.2 * norm.isf(OUTSIDE / 2), rel=1e-4)


@pytest.mark.parametrize("minor", [0.05, 0.3, 0.7])
def test_the_protection_level_contains_all_but_one_in_a_thousand(minor):
    rng = np.random.default_rng(4)
    points = rng.normal(size=(400_000, 2)) * [1.0, minor]
    level = PoseAccuracy.of(covariance(1.0, minor)).protection_level
    outside = np.mean(np.hypot(*points.T) > level)
    assert outside == pytest.approx(OUTSIDE, abs=4.0 * math.sqrt(OUTSIDE / len(points)))


def test_many_covariances_have_the_accuracies_of_each():
    several = np.stack([covariance(0.1, 0.02), covariance(3.0, 2.0), np.full((3, 3), np.nan)])
    both = PoseAccuracy.of(several)
    assert np.isnan([values[2] for values in both]).all()
    for k in range(2):
        assert [values[k] for values in both] == pytest.approx(list(PoseAccuracy.of(several[k])))
    assert PoseAccuracy.of(np.zeros((3, 3))) == (0.0, 0.0, 0.0)


def test_variances_below_zero_by_rounding_are_zero():
    assert PoseAccuracy.of(np.diag([1e-6, 1e-6, -1e-22]))[:2] == pytest.approx((1e-3, 0.0))
    assert PoseAccuracy.of(np.diag([-1e-22, -1e-22, 1e-4])) == pytest.approx((0.0, 1e-2, 0.0))


def test_an_estimate_states_its_accuracy_or_none():
    known = Estimate(0.0, Status.LOCALISED, "", Pose(1.0, 0.0, 0.0), covariance(0.1, 0.02))
    assert known.accuracy == PoseAccuracy.of(known.covariance)
    assert all(isinstance(value, float) for value in known.accuracy)
    assert Estimate(0.0, Status.WAITING, "").accuracy is None


def test_a_deviation_near_the_limit_does_not_switch_to_and_fro():
    limit = AccuracyLimit(0.1)
    seen = [limit.is_met(sigma) for sigma in (0.09, 0.1, 0.101, 0.099, 0.09, 0.08, 0.099, math.nan)]
    assert seen == [True, True, False, False, False, True, True, False]
    assert AccuracyLimit(math.inf).is_met(1e9)
