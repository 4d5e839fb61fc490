"""A fit of home says what dense least squares says, and its evidence is that of a Gaussian."""

import math
from dataclasses import replace

import numpy as np
import pytest

from homeward.geometry.angles import wrap
from homeward.localizer.home.estimate import HomeFit, fit
from homeward.localizer.home.hypotheses import search
from homeward.localizer.home.problem import Assumption, HomeProblem
from homeward.localizer.reference.labels import log_odds, log_outlier, log_set_prior, moved_share
from homeward.localizer.reference.sets import POSE_AND_YAW, YAW, linearised, solved
from homeward.localizer.tunables import FIT_CONVERGED, GIVEN_WRONG

PRIOR = np.array([0.1, -0.1, 0.2])


def a_home(rng, q=6, prior=None):
    """Landmarks round a home, as known, with a home bearing each."""
    at = rng.uniform(0.0, 2.0 * np.pi, q)
    landmarks = rng.uniform(1.0, 3.0, q)[:, None] * np.stack([np.cos(at), np.sin(at)], axis=1)
    root = 0.05 * rng.normal(size=(4 + 2 * q, 4 + 2 * q))
    return HomeProblem(
        mean=np.concatenate([[0.5, 0.2, 0.3, 0.0], landmarks.ravel()]),
        covariance=root @ root.T,
        bearings=at + 0.02 * rng.normal(size=q),
        sigmas=rng.uniform(0.005, 0.03, q),
        mount=np.array([0.1, 0.0, 0.2]),
        same_camera=True,
        moved_prior=0.1,
        prior=prior,
        prior_information=None if prior is None else np.diag([4.0, 3.0, 2.0]),
    )


def by_state(linear):
    """Return the Jacobian of the expected home bearings by pose, yaw and landmarks."""
    q = len(linear.by_yaw)
    found = np.zeros((q, POSE_AND_YAW + 2 * q))
    found[:, YAW] = linear.by_yaw
    for i, by_place in enumerate(linear.by_place):
        found[i, POSE_AND_YAW + 2 * i :][:2] = by_place
    return found


def solved_fit(problem, linear, inliers):
    """Return the fit of a set at a linearisation."""
    return HomeFit(problem, linear, inliers, solved(problem.arrays, linear, inliers))


def log_normal(off, covariance):
    return -0.5 * (
        off @ np.linalg.solve(covariance, off) + np.linalg.slogdet(2.0 * np.pi * covariance)[1]
    )


@pytest.mark.parametrize("prior", [None, PRIOR])
@pytest.mark.parametrize("inliers", [[1, 1, 1, 1, 1, 1], [1, 0, 1, 1, 0, 1], [0, 0, 0, 0, 0, 0]])
def test_a_fit_is_the_posterior_of_home_and_map_together(prior, inliers):
    problem, inliers = a_home(np.random.default_rng(4), prior=prior), np.array(inliers, bool)
    linear = linearised(problem.arrays, np.array([0.1, 0.1, -0.2]), problem.mean)
    found = solved_fit(problem, linear, inliers)
    whole = np.concatenate([linear.by_home, by_state(linear)], axis=1)
    before = np.zeros((len(whole[0]), len(whole[0])))
    before[:3, :3], before[3:, 3:] = problem.initial_information, np.linalg.inv(problem.covariance)
    weighed = whole[inliers].T / problem.sigmas[inliers] ** 2
    covariance = np.linalg.inv(before + weighed @ whole[inliers])
    slope = weighed @ linear.residual[inliers] + before[:, :3] @ problem.arrays.prior_offset(
        linear.at
    )
    step = covariance @ slope
    assert problem.step_length(step[:3]) < 1.0
    assert found.solution.step == pytest.approx(step[:3], rel=1e-6, abs=1e-9)
    assert found.state - problem.mean == pytest.approx(step[3:], rel=1e-6, abs=1e-9)
    assert found.pose == pytest.approx(found.state[:3])
    assert np.linalg.inv(found.solution.information) == pytest.approx(covariance[:3, :3], rel=1e-6)
    follows = -found.solution.pose_by_home
    assert follows @ np.linalg.inv(found.solution.information) == pytest.approx(
        covariance[3:6, :3], rel=1e-6, abs=1e-9
    )
    alone = covariance[3:6, 3:6] - follows @ covariance[:3, 3:6]
    assert found.solution.pose_covariance == pytest.approx(alone, rel=1e-5, abs=1e-9)
    predicted = whole @ covariance @ whole.T + np.diag(problem.sigmas**2)
    outside = ~inliers
    innovation = wrap(linear.residual - whole @ step)
    assert found.innovations[0][outside] == pytest.approx(innovation[outside], rel=1e-6)
    assert found.innovations[1][outside] == pytest.approx(predicted.diagonal()[outside], rel=1e-6)


@pytest.mark.parametrize("prior", [None, PRIOR])
def test_each_bearing_is_predicted_by_all_others(prior):
    problem = a_home(np.random.default_rng(4), prior=prior)
    linear = linearised(problem.arrays, np.array([0.1, 0.1, -0.2]), problem.mean)
    inliers = np.array([1, 0, 1, 1, 1, 1], bool)
    innovation, variance = solved_fit(problem, linear, inliers).innovations
    for i in range(6):
        others = inliers & (np.arange(6) != i)
        rest = solved_fit(problem, linear, others)
        jacobian = np.concatenate([linear.by_home, by_state(linear)], axis=1)
        expected = linear.by_home[i] @ rest.solution.step
        expected += jacobian[i, 3:] @ (rest.state - problem.mean)
        assert innovation[i] == pytest.approx(wrap(linear.residual[i] - expected), rel=1e-6)
        assert variance[i] == pytest.approx(rest.innovations[1][i], rel=1e-6)
    share = np.where(inliers, moved_share(4, 1, 0.1), moved_share(5, 0, 0.1))
    assert solved_fit(problem, linear, inliers).odds == pytest.approx(
        log_odds(innovation, variance, share)
    )


def test_where_many_were_found_wrong_another_one_is_no_wonder():
    wrong = np.arange(13)
    sets = np.array([math.comb(12, w) for w in wrong])
    assert sets @ np.exp(log_set_prior(12 - wrong, wrong, 0.1)) == pytest.approx(1.0)
    assert moved_share(11, 0, 0.1) == pytest.approx(0.1, abs=0.01)
    assert moved_share(4, 7, 0.1) == pytest.approx(8.0 / 13.0, abs=0.01)
    assert moved_share(0, 0, 0.1) == pytest.approx(0.9 * 0.1 + 0.1 * 0.5)


def test_the_evidence_is_the_density_of_the_bearings_whatever_home_and_map_are():
    problem = a_home(np.random.default_rng(4), prior=PRIOR)
    linear = linearised(problem.arrays, np.array([0.1, 0.1, -0.2]), problem.mean)
    inliers = np.array([1, 0, 1, 1, 0, 1], bool)
    found = solved_fit(problem, linear, inliers)
    by_home, off = linear.by_home[inliers], problem.arrays.prior_offset(linear.at)
    spread = linear.residual_covariance[inliers][:, inliers]
    spread = spread + by_home @ np.linalg.inv(problem.initial_information) @ by_home.T
    density = log_normal(linear.residual[inliers] - by_home @ off, spread)
    wrong = log_outlier(*(part[~inliers] for part in found.innovations)).sum()
    believed = 2.0 * math.log(1.0 - GIVEN_WRONG)  # of their noise, and of the start
    labels = believed + math.log(0.9 * 0.9**4 * 0.1**2 + 0.1 / (7.0 * math.comb(6, 2)))
    assert found.log_evidence == pytest.approx(density + wrong + labels, rel=1e-9)


def test_a_start_that_most_home_bearings_contradict_is_wrong():
    rng = np.random.default_rng(3)
    sound = replace(a_home(rng, q=8), covariance=1e-6 * np.eye(20), sigmas=np.full(8, 0.01))
    home = np.array([0.1, 0.2, 0.0])
    away = sound.landmarks - home[:2]
    stored = np.arctan2(away[:, 1], away[:, 0]) + 0.01 * rng.normal(size=8)
    seen = replace(sound, bearings=stored, prior_information=np.diag([400.0, 400.0, 100.0]))
    near = search(replace(seen, prior=np.add(home, [0.05, -0.04, 0.05]))).best
    assert near.problem.assumed.start
    far = search(replace(seen, prior=np.add(home, [1.0, -1.5, 1.0]))).best
    assert not far.problem.assumed.start
    assert far.home == pytest.approx(near.home, abs=0.05)
    assert far.inliers.all()


def test_home_bearings_that_are_noisier_than_was_said_are_not_of_moved_landmarks():
    rng = np.random.default_rng(1)
    sound = replace(a_home(rng, q=12), covariance=1e-6 * np.eye(28), sigmas=np.full(12, 0.01))
    eye = np.array([0.1 * math.cos(0.2), 0.1 * math.sin(0.2)])
    away = sound.landmarks - eye
    stored = np.arctan2(away[:, 1], away[:, 0])
    for scale, noise in ((1.0, 0.01), (10.0, 0.1)):
        said = replace(sound, bearings=stored + noise * rng.normal(size=12))
        found = search(said)
        assert found.best.problem.assumed.noise_scale == scale
        assert found.moved_probabilities().max() < 0.5
    again = found.best.problem.under(Assumption(3.0))
    assert again.sigmas == pytest.approx(np.full(12, 0.03))


@pytest.mark.parametrize("prior", [None, PRIOR])
def test_home_is_iterated_to(prior):
    problem = a_home(np.random.default_rng(6), prior=prior)
    inliers = np.array([1, 1, 1, 0, 1, 1], bool)
    one, many = (fit(problem, np.array([0.4, -0.3, 0.3]), inliers, steps) for steps in (1, 20))
    assert problem.step_length(many.solution.step) < FIT_CONVERGED
    assert problem.step_length(one.solution.step) > FIT_CONVERGED
    again = linearised(problem.arrays, many.home, many.state)
    assert solved(problem.arrays, again, inliers).step == pytest.approx(np.zeros(3), abs=1e-4)
    assert (fit(problem, np.zeros(3), np.zeros(6, bool)) is None) == (prior is None)


def test_bearings_without_spread_fix_no_home():
    problem = a_home(np.random.default_rng(5))
    around = linearised(problem.arrays, np.zeros(3), problem.mean)
    around.residual_covariance[:] = -1.0
    assert solved(problem.arrays, around, np.ones(6, bool)) is None


def test_errors_that_move_all_landmarks_alike_are_not_spurious_information():
    problem = a_home(np.random.default_rng(7))
    away = problem.landmarks
    rigid = np.zeros((problem.mean.size, 3))
    rigid[POSE_AND_YAW::2, 0] = rigid[POSE_AND_YAW + 1 :: 2, 1] = 1.0
    rigid[POSE_AND_YAW::2, 2], rigid[POSE_AND_YAW + 1 :: 2, 2] = -away[:, 1], away[:, 0]
    alike = rigid @ np.diag([0.04, 0.05, 0.02]) @ rigid.T
    home = np.zeros(3)
    moved, own = (
        solved_fit(p, linearised(p.arrays, home, p.mean), np.ones(6, bool))
        for p in (replace(problem, covariance=alike), problem)
    )
    assert np.abs(moved.inflation).max() < 1e-3 * np.abs(own.inflation).max()
