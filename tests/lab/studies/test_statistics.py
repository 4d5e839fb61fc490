"""Intervals and paired tests over runs."""

import numpy as np
import pytest
from scipy.stats import wilcoxon

from homeward.lab.studies.study.statistics import adjusted, paired, rmse_interval


def drawn(scale, number=40, seed=0):
    return scale * np.random.default_rng(seed).lognormal(0.0, 0.5, number)


def test_the_interval_of_an_rmse_holds_it_as_often_as_it_says():
    # RMSE of |N(0, 1)| errors is 1; a bootstrap of 40 runs is a little short of 95 %.
    draw = np.random.default_rng(1)
    held = 0
    for _ in range(200):
        found = rmse_interval(np.abs(draw.normal(size=40)))
        held += found.low <= 1.0 <= found.high
    assert 0.88 <= held / 200 <= 0.99


def test_runs_without_a_pose_are_left_out_of_an_rmse_but_not_of_the_test():
    rmse = drawn(1.0)
    some = rmse.copy()
    some[:30] = np.nan
    assert rmse_interval(some).value == pytest.approx(np.sqrt(np.mean(rmse[30:] ** 2)))
    # Twice as good where it has a pose, and mostly without one: not better.
    found = paired(some / 2, rmse)
    assert found.ratio.value == pytest.approx(0.5)
    assert found.ratio.low == pytest.approx(0.5)
    assert found.p < 0.05
    assert paired(rmse, rmse / 2).p < 1e-6


def test_the_test_is_wilcoxons_and_knows_pairs():
    a, b = drawn(1.0), drawn(1.2, seed=5)
    assert paired(a, b).p == pytest.approx(wilcoxon(np.log(a / b)).pvalue)
    # Every run a hundredth worse: far less than runs differ, and yet certain.
    worse = paired(1.01 * a, a)
    assert worse.p < 1e-6
    assert 1.0 < worse.ratio.low <= worse.ratio.high < 1.02


def test_equal_estimators_and_too_few_runs_prove_nothing():
    a = drawn(1.0)
    assert paired(a, a).p == 1.0
    nothing = np.full(5, np.nan)
    assert np.isnan(paired(nothing, nothing).p)
    assert np.isnan(paired(nothing, nothing).ratio.value)
    assert np.isnan(paired(a[:2], 2 * a[:2]).p)
    assert np.isnan(rmse_interval(a[:2]).low)
    assert np.isnan(rmse_interval(nothing).value)


def test_p_values_are_adjusted_for_their_number():
    found = adjusted([np.nan, 0.01, 0.02, 0.03, 0.04, np.nan])
    assert np.isnan(found[[0, 5]]).all()
    np.testing.assert_allclose(found[1:5], 0.04)
    assert np.isnan(adjusted([np.nan])).all()


def test_chance_alone_is_seldom_taken_for_a_difference():
    draw = np.random.default_rng(2)
    seen = [paired(*draw.lognormal(size=(2, 20))).p < 0.05 for _ in range(300)]
    assert np.mean(seen) < 0.09
