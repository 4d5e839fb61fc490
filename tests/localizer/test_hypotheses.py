"""Wrong home bearings: how far off they may be, which sets compete, and one answer out of all."""

import dataclasses
import math

import numpy as np
import pytest
from rig import Rig, ring
from scipy.integrate import trapezoid
from test_far_homes import FAR, divided
from test_parts import problem

from homeward.estimator import Status
from homeward.geometry.angles import TWO_PI, wrap
from homeward.geometry.frames import Pose, between
from homeward.localizer.home.estimate import fit
from homeward.localizer.home.hypotheses import Hypotheses, search, seeds, seeds_for
from homeward.localizer.home.problem import USUAL, HomeProblem
from homeward.localizer.map.triangulation import range_mixture
from homeward.localizer.output.pose import (
    PoseEstimate,
    centre,
    combined_estimate,
    other_hypotheses,
)
from homeward.localizer.output.status import IntegrityMonitor
from homeward.localizer.reference.labels import log_inlier, log_odds, log_outlier
from homeward.localizer.resection import mixture_scores
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import INLIER

CIRCLE = np.linspace(-math.pi, math.pi, 20001)


@pytest.mark.parametrize("sigma", [0.01, 0.1, 0.3])
def test_right_and_wrong_are_densities_on_the_circle(sigma):
    variance = np.full(CIRCLE.size, sigma**2)
    for density in (log_inlier, log_outlier):
        assert trapezoid(np.exp(density(CIRCLE, variance)), CIRCLE) == pytest.approx(1, abs=1e-3)


def test_a_wrong_bearing_is_predicted_as_uncertainly_as_its_fault_and_the_map_together():
    fault = np.exp(log_outlier(CIRCLE, np.zeros(CIRCLE.size)))
    for off in (0.0, 0.2, 0.7, 1.5):
        noise = np.exp(log_inlier(off - CIRCLE, np.full(CIRCLE.size, 0.15**2)))
        both = trapezoid(fault * noise, CIRCLE)
        assert np.exp(log_outlier(np.array(off), np.array(0.15**2))) == pytest.approx(
            both, rel=1e-3
        )


def test_a_bearing_further_off_is_less_probably_right_and_one_that_nothing_predicts_says_nothing():
    odds = log_odds(np.linspace(0.0, 0.4, 50), np.full(50, 0.02**2), 0.1)
    assert (np.diff(odds) < 0).all()
    assert odds[0] > 0 > odds[-1]
    nothing = log_odds(np.array([0.0, 1.0, 3.0]), np.full(3, 25.0), 0.1)
    assert nothing == pytest.approx(math.log(9.0))
    near, far = log_outlier(np.array([0.3, 2.5]), np.full(2, 0.02**2))
    assert near > far > -math.log(TWO_PI) - math.log(2.5)


def test_a_home_that_wanders_leaves_the_pose_unfixed_if_it_is_as_probable():
    known = problem({})[1]
    found = fit(known, np.zeros(3), np.ones(8, bool))
    small = fit(known, np.zeros(3), np.arange(8) < 4)
    for unconverged, fixed in (((), True), ((small,), True), ((found,), False)):
        integrity = IntegrityMonitor(LocalizerSettings(), 0.03)
        now = Hypotheses((found,), np.ones(1), unconverged)
        integrity.update(now, solved=True)
        assert integrity.fixed == fixed
        assert now.max_log_evidence == found.log_evidence
    assert now.unconverged_probability == pytest.approx(0.5)
    integrity.update(Hypotheses((small,), np.ones(1), (found,)), solved=True)
    assert not integrity.fixed


def test_a_home_known_by_former_places_alone_is_not_verified():
    home, known = problem({})
    now = Hypotheses((fit(known, np.array(home), np.ones(8, bool)),), np.ones(1))
    for stayed, status in ((8, Status.LOCALISED), (2, Status.UNVERIFIED)):
        integrity = IntegrityMonitor(LocalizerSettings(), 0.03)
        integrity.update(now, solved=True, stayed=np.arange(8) < stayed)
        answer = integrity.estimate(0.0, None, np.zeros(3), coasting=False)
        assert answer.status is status
    assert answer.reason.startswith("only 2 of 8")


def test_evidence_of_a_flip_is_what_the_odds_say_while_another_one_is_wrong():
    home, known = problem({2: 0.3})
    inliers = np.arange(8) != 2
    now = fit(known, np.array(home), inliers)
    for i in (0, 5, 7):
        flipped = inliers.copy()
        flipped[i] = False
        without = fit(known, now.home, flipped)
        assert now.log_evidence - without.log_evidence == pytest.approx(now.odds[i], abs=0.3)


def two_hypotheses(weights=(0.6, 0.4)):
    home, known = problem({1: 0.06, 4: -0.05})
    rights = [np.arange(8) != 1, np.arange(8) != 4]
    fits = tuple(fit(known, np.array(home), inliers) for inliers in rights)
    return Hypotheses(fits, np.array(weights))


def test_the_answer_lies_between_the_hypotheses_with_the_second_moment_of_all_around_it():
    both = two_hypotheses()
    rng = np.random.default_rng(0)
    parts = [PoseEstimate.of(*f.in_home_frame) for f in both.fits]
    samples = np.concatenate(
        [
            rng.multivariate_normal(np.array(a.pose), a.covariance, round(4e5 * w))
            for a, w in zip(parts, both.weights, strict=True)
        ]
    )
    answer = combined_estimate(both.best, other_hypotheses(both))
    first, second = (np.array(a.pose) for a in parts)
    share = (np.array(answer.pose) - first) / (second - first)
    assert share == pytest.approx(np.full(3, share[0]), rel=1e-6)
    assert 0.1 < share[0] <= 0.4  # the mean, or nearer to the leading one
    off = samples - np.array(answer.pose)
    around = off.T @ off / len(off)
    widest = np.linalg.eigvalsh(around[:2, :2])[-1]
    sagitta = widest / (2 * both.best.landmark_distance(both.best.home))
    around[[0, 1], [0, 1]] += sagitta**2
    assert answer.covariance == pytest.approx(around, rel=0.02, abs=1e-6)
    assert np.trace(answer.covariance) > 1.05 * np.trace(parts[0].covariance)


@pytest.mark.parametrize(("share", "probability"), [(0.01, 0.0), (0.1, 0.4)])
def test_a_home_nearby_is_the_same_however_certain_both_are(share, probability):
    best = two_hypotheses().best
    shift = share * best.landmark_distance(best.home) * np.array([0.6, 0.8, 0.0])
    other = dataclasses.replace(
        best, solution=best.solution._replace(step=best.solution.step + shift)
    )
    assert Hypotheses((best, other), np.array([0.6, 0.4])).rivals(0.01) == probability


def test_a_best_hypothesis_that_became_certain_leaves_a_covariance():
    both = two_hypotheses((0.3, 0.7))
    loose = dataclasses.replace(both.best.problem, covariance=100.0 * both.best.problem.covariance)
    vague = fit(loose, both.best.home, both.best.inliers)
    others = other_hypotheses(Hypotheses((vague, both.fits[1]), both.weights))
    answer = combined_estimate(both.best, others)  # carried on since
    assert (np.linalg.eigvalsh(answer.covariance) > 0.0).all()
    before = combined_estimate(vague, others)
    assert (np.linalg.eigvalsh(before.covariance - answer.covariance) > 0.0).all()


def test_alike_hypotheses_are_averaged_and_far_ones_hardly_followed():
    rng = np.random.default_rng(1)
    points, weights = rng.normal(size=(5, 3)), np.array([0.3, 0.25, 0.2, 0.15, 0.1])
    root = np.diag([1.0, 2.0, 0.5])
    alike = 1e-3 * points
    assert centre(alike, weights, root @ root) == pytest.approx(weights @ alike, abs=1e-8)
    points[4] = 50.0
    middle = centre(points, weights, root @ root)

    def distance(at):
        off = np.linalg.norm((points - at) @ np.linalg.inv(root), axis=1)
        return weights @ np.hypot(off, INLIER)

    for step in 0.05 * np.concatenate([root, -root]):
        assert distance(middle) < distance(middle + step)
    assert np.abs(middle).max() < 2.0  # the mean is at 5
    assert (centre(points[4:], np.ones(1), root @ root) == points[4]).all()


def test_headings_on_both_sides_of_half_a_turn_meet_there():
    both = two_hypotheses((0.5, 0.5))
    fits = []
    for f, off in zip(both.fits, (0.1, -0.1), strict=True):
        turn = np.array([0.0, 0.0, wrap(math.pi + off - f.pose[2] + f.home[2])])
        turned = f.linear._replace(at=f.linear.at - turn)
        fits.append(dataclasses.replace(f, linear=turned))
    other = Hypotheses(tuple(fits), both.weights)
    answer = combined_estimate(other.best, other_hypotheses(other))
    assert abs(answer.pose.heading) == pytest.approx(math.pi, abs=1e-6)
    assert answer.covariance[2, 2] == pytest.approx(0.1**2, rel=0.1)


def test_small_faults_do_not_make_a_pose_too_sure_of_itself():
    beyond, runs = 0, 80
    rng = np.random.default_rng(5)
    for seed in range(runs):
        size = rng.uniform(0.03, 0.1, 2) * rng.choice([-1, 1], 2)
        faults = dict(zip(rng.choice(8, 2, replace=False).tolist(), size.tolist(), strict=True))
        home, known = problem(faults, seed=seed)
        found = search(known)
        answer = combined_estimate(found.best, other_hypotheses(found))
        off = np.array(answer.pose) - np.array(between(home, Pose(0.0, 0.0, 0.0)))
        off[2] = wrap(off[2])
        beyond += off @ np.linalg.solve(answer.covariance, off) > 16.0
    assert beyond <= 0.075 * runs


def test_where_most_landmarks_moved_home_can_be_looked_for_from_more_places():
    known = problem(dict(enumerate((0.3, -0.2, 0.5, -0.6, 0.15))))[1]
    few, many = seeds(known), seeds(known, 32)
    sets = [inliers.tobytes() for _, inliers, assumed in many if assumed == USUAL]
    assert len(few) < len(many)
    assert len(sets) == len(set(sets)) > 8
    assert [(s, i.tobytes()) for _, i, s in few[:8]] == [(s, i.tobytes()) for _, i, s in many[:8]]


def on_a_circle(seed):
    """A home on the circle through its landmarks: from all of it they look alike."""
    rng = np.random.default_rng(seed)
    way = rng.uniform(-math.pi, math.pi, 8)
    marks = 2.0 * np.stack([1.0 + np.cos(way), np.sin(way)], axis=1)
    stored = np.arctan2(marks[:, 1], marks[:, 0]) + 0.01 * rng.normal(size=8)
    mean = np.r_[np.zeros(4), (marks + 0.02 * rng.normal(size=marks.shape)).ravel()]
    spread = np.diag(np.r_[np.full(4, 1e-6), np.full(16, 0.02**2)])
    return HomeProblem(mean, spread, stored, np.full(8, 0.01), np.zeros(3), True, 0.1)


@pytest.mark.parametrize("seed", [0, 2, 7])
def test_a_home_that_wanders_does_not_compete_however_well_it_fits(seed):
    found = search(on_a_circle(seed))
    assert all(f.converged for f in found.fits)
    assert not any(f.converged for f in found.unconverged)
    assert found.max_log_evidence > found.best.log_evidence + 1.0
    assert found.unconverged_probability > 0.5  # and so the pose is not fixed


def test_what_was_known_of_home_is_known_still_when_a_landmark_comes():
    known, near = divided(seed=9)

    def finds_the_far_one(also):
        return (~near).tolist() in [f.inliers.tolist() for f in search(known, also).fits]

    first = [*range(5, 8), *range(1, 5)]  # not yet landmark 0
    columns = np.r_[0:4, [4 + 2 * i + k for i in first for k in range(2)]]
    fewer = dataclasses.replace(
        known,
        mean=known.mean[columns],
        covariance=known.covariance[np.ix_(columns, columns)],
        bearings=known.bearings[first],
        sigmas=known.sigmas[first],
    )
    far = fit(fewer, np.array(FAR), np.arange(7) < 3, 20)
    names = [str(i) for i in range(8)]
    again = seeds_for(Hypotheses((far,), np.ones(1)), [names[i] for i in first], names)
    assert again[0][1].tolist() == (~near).tolist()
    assert finds_the_far_one(again)
    assert not finds_the_far_one([])  # three landmarks alone do not suggest it


def driven(rng, target, straight):
    """Cameras on a way of two metres, straight at a target or past it, and bearings of it."""
    heading = math.atan2(target[1], target[0]) + (0.0 if straight else 1.2)
    along = np.linspace(0.0, 2.0, 30)
    cameras = np.stack([along * math.cos(heading), along * math.sin(heading), np.zeros(30)], axis=1)
    lines = np.arctan2(target[1] - cameras[:, 1], target[0] - cameras[:, 0])
    return cameras, lines + 0.01 * rng.normal(size=30)


def test_a_landmark_driven_straight_at_stands_on_a_ray_at_any_distance():
    rng = np.random.default_rng(0)
    target = np.array([4.0, 3.0])
    sigmas, still = np.full(30, 0.01), np.diag([1e-4, 1e-4, 1e-5])
    ray = range_mixture(*driven(rng, target, True), sigmas, still, 3.0)
    lines = np.arctan2(*(ray.places - 2.0 * target / 5.0).T[::-1])
    assert lines == pytest.approx(math.atan2(3.0, 4.0), abs=0.01)
    assert ray.weights.max() < 0.1
    past = range_mixture(*driven(rng, target, False), sigmas, still, 3.0)
    likely = past.places[np.argmax(past.weights)]
    assert np.hypot(*(likely - target)) < 0.4
    assert past.weights.max() > 0.3
    cameras, bearings = driven(rng, target, True)
    assert range_mixture(cameras, rng.uniform(-3, 3, 30), sigmas, still, 3.0) is None
    assert range_mixture(cameras[:5], bearings[:5], sigmas[:5], still, 3.0) is None


@pytest.mark.parametrize("fault", [0.0, 0.3])
def test_a_landmark_too_far_to_be_mapped_is_judged_by_its_direction(fault):
    rig = Rig({**ring(7), "tower": (90.0, 40.0)}, seed=3, faults={"tower": fault})
    rig.drive(30)
    assert "tower" not in rig.localizer.chart.map.landmarks.mapped
    (tower,) = [m for m in rig.localizer.landmarks() if m.landmark == "tower"]
    assert tower.moved is (fault > 0)
    assert rig.moved() == ({"tower"} if fault else set())


@pytest.mark.parametrize(("scatter", "agrees"), [(0.02, True), (0.045, False)])
def test_sight_lines_beyond_three_sigma_agree_on_no_ray(scatter, agrees):
    cameras = np.column_stack([np.linspace(0.0, 2.0, 30), np.zeros((30, 2))])
    lines = scatter * (-1.0) ** np.arange(30)
    still = np.diag([1e-4, 1e-4, 1e-5])
    found = range_mixture(cameras, lines, np.full(30, 0.01), still, 3.0)
    assert (found is not None) is agrees


@pytest.mark.parametrize(("density", "right"), [(0.3, False), (0.6, True)])
def test_a_bearing_is_an_inlier_of_a_pose_where_that_is_more_probable(density, right):
    """With a prior of 0.3 to be moved, 0.7 times the density against a uniform one is to be 0.3."""
    variance = 0.01
    off = math.sqrt(-2.0 * variance * math.log(density * math.sqrt(variance / math.tau)))
    noise = np.full(4, math.sqrt(0.5 * variance))
    seen = np.full((1, 4), off), np.full((1, 4), 0.5 * variance)
    assert mixture_scores(*seen, noise, 0.3)[1].tolist() == [[right] * 4]
