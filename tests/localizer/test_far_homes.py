"""Homes far from their landmarks: how probable, how reached, and not mistaken for near ones."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid
from test_parts import problem

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing
from homeward.localizer.home.estimate import fit
from homeward.localizer.home.hypotheses import Hypotheses, search, update
from homeward.localizer.home.problem import HomeProblem
from homeward.localizer.output.pose import uncheckable_outliers
from homeward.localizer.output.status import IntegrityMonitor
from homeward.localizer.reference.sets import expected
from homeward.localizer.settings import LocalizerSettings

NEAR, FAR = Pose(0.5, 0.6, -0.4), Pose(-18.0, -4.0, 0.2)


def divided(sigma=0.3, q=8, seed=0):
    """A problem of which five bearings are from a near home, and three from a far one."""
    rng = np.random.default_rng(seed)
    marks = rng.uniform([-5.0, -2.5], [5.0, 2.5], (q, 2))
    near = np.arange(q) < 5
    stored = np.where(near, bearing(NEAR, *marks.T), bearing(FAR, *marks.T))
    spread = np.diag(np.r_[np.full(4, 1e-6), np.full(2 * q, sigma**2)])
    mean = np.r_[np.zeros(4), marks.ravel()]
    told = HomeProblem(mean, spread, wrap(stored), np.full(q, 0.01), np.zeros(3), True, 0.1)
    return told, near


def scaled(known, times):
    """The same problem in other units of length."""
    factor = np.ones(known.mean.size)
    factor[[0, 1]] = factor[4:] = times
    covariance = known.covariance * factor * factor[:, None]
    return replace(known, mean=known.mean * factor, covariance=covariance)


@pytest.mark.parametrize("seed", [7, 15, 23])
def test_two_homes_far_apart_stay_where_they_are_when_the_map_changes(seed):
    known, near = divided(seed=seed)
    fits = fit(known, np.array(FAR), ~near, 20), fit(known, np.array(NEAR), near, 20)
    changed = replace(known, mean=known.mean + 0.01 * np.sin(np.arange(known.mean.size)))
    followed = update(changed, Hypotheses(fits, np.array([0.6, 0.4])))
    homes = {f.inliers.tobytes(): f.home for f in followed.fits}
    for home, inliers in ((NEAR, near), (FAR, ~near)):
        off = homes[inliers.tobytes()] - np.array(home)
        assert np.hypot(*off[:2]) < 2.0


def test_of_two_homes_that_explain_as_much_the_far_one_is_less_probable():
    known, near = divided()
    close, away = fit(known, np.array(NEAR), near, 20), fit(known, np.array(FAR), ~near, 20)
    assert known.log_density(away.home) < known.log_density(close.home) - 2.0
    densities = [known.log_density(np.array([x, 0.0, 0.0])) for x in (0.0, 10.0, 100.0, 1000.0)]
    assert (np.diff(densities) < -1.0).all()
    assert densities[-1] > densities[0] - 20.0  # and yet it may lie there
    told = replace(known, prior=np.array(FAR), prior_information=np.eye(3))
    assert told.log_density(np.array(FAR)) == told.log_density(np.array(NEAR))


@pytest.mark.parametrize("times", [1e-2, 1e3])
def test_the_unit_of_length_does_not_matter(times):
    for known in (problem({1: 0.06, 4: -0.05})[1], problem({2: 0.4}, seed=3)[1]):
        one, other = search(known), search(scaled(known, times))
        assert [f.inliers.tobytes() for f in one.fits] == [f.inliers.tobytes() for f in other.fits]
        assert other.weights == pytest.approx(one.weights, rel=1e-3)
        assert other.best.home[:2] == pytest.approx(times * one.best.home[:2], rel=1e-3)


def test_a_step_that_was_cut_short_is_not_rest():
    known, near = divided(sigma=2.0)
    begun = fit(known, np.array(FAR), near, 1)
    assert known.step_length(begun.solution.step) == pytest.approx(1.0)
    assert not begun.converged
    assert fit(known, np.array(FAR) / 2, near, 60).converged


def test_doubt_is_a_covariance_where_next_to_nothing_is_known_too():
    for seed in range(20):
        known, near = divided(sigma=10.0, seed=seed)
        for inliers in (near, ~near):
            found = fit(known, np.array(NEAR), inliers, 1)
            assert (
                np.linalg.eigvalsh(found.inflation)[0] > -1e-9 * np.trace(found.inflation) - 1e-12
            )
            sure = found.solution._replace(inverse=1e-6 * np.eye(3))
            crisp = replace(found, solution=sure, known_inflation=found.inflation)
            assert (np.linalg.eigvalsh(crisp.covariance) > 0.0).all()


def test_agreement_of_a_bearing_that_nothing_predicts_checks_nothing():
    _, known = problem({}, q=6)
    assert fit(known, np.zeros(3), np.ones(6, bool)).checked.all()
    covariance = known.covariance.copy()
    covariance[[4, 5], [4, 5]] = 10.0**2  # the first landmark may be anywhere
    vague = replace(known, covariance=covariance)
    loose = fit(vague, np.zeros(3), np.ones(6, bool))
    assert loose.checked.tolist() == [False] + 5 * [True]
    four = np.arange(6) < 4
    lone = fit(vague, np.zeros(3), four)
    assert not lone.checked.all()  # without the first one, three are left
    assert uncheckable_outliers(lone, lone.checked) is not None
    assert uncheckable_outliers(loose, np.ones(6, bool)) is None
    three = fit(known, np.zeros(3), np.arange(6) < 3)
    assert not three.checked.any()
    assert math.sqrt(uncheckable_outliers(three, three.checked)[0, 0]) > 0.05


def test_three_bearings_give_a_pose_only_where_one_that_is_wrong_leaves_something_of_it():
    _, known = problem({}, q=6)
    inliers = np.array([1, 0, 1, 0, 1, 0], bool)  # all round home
    integrity = IntegrityMonitor(LocalizerSettings(), 0.03)
    integrity.update(Hypotheses((fit(known, np.zeros(3), inliers),), np.ones(1)), solved=True)
    assert integrity.fixed
    away = np.r_[np.zeros(4), np.tile([6.0, 0.0], 6)]
    close = known.mean + 8.0 * away  # the same landmarks, all on one side
    home = np.array([0.2, -0.1, 0.7])
    stored = expected(known, home, close[4:].reshape(-1, 2), 0.0)[0]
    narrow = replace(known, mean=close, bearings=wrap(stored))
    integrity.update(Hypotheses((fit(narrow, home, inliers, 30),), np.ones(1)), solved=True)
    assert not integrity.fixed


def test_the_density_of_homes_is_one_in_all():
    known, _ = divided()
    (x, y), near = known.centre, known.range
    r = near * np.geomspace(1e-3, 1e6, 4000)
    density = np.exp([known.log_density(np.array([x + away, y, 0.0])) for away in r])
    inside = math.pi * r[0] ** 2 * density[0]
    in_all = math.tau * (inside + trapezoid(math.tau * r * density, r))  # over all headings
    assert in_all == pytest.approx(1.0, abs=1e-3)
