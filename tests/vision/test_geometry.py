"""Epipolar residuals, their derivatives, the two-point solver and the refinement."""

import numpy as np
import pytest

from homeward.drives.cameras.camera import tilt_matrix
from homeward.geometry.angles import wrap
from homeward.vision.geometry.epipolar import Motion, Pairs, residuals
from homeward.vision.geometry.ransac import (
    coefficients,
    estimate_motion,
    msac_costs,
    two_point_motions,
)
from homeward.vision.geometry.refinement import MAX_OTHERS, SAME, jackknife_covariance, refine

SIGMA = 0.002


def angles(vectors):
    x, y, z = vectors.T
    return np.column_stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])


def spread(n):
    """Return covariances of n directions, (n, 2, 2): those of home are off by as much."""
    return np.tile(2 * SIGMA**2 * np.eye(2), (n, 1, 1))


def made_up(motion, n=60, seed=0, noise=0.0, wrong=0, distance=1.0):
    """Return pairs of a room's points seen from home and from `distance` [m] away."""
    rng = np.random.default_rng(seed)
    bearing = rng.uniform(-np.pi, np.pi, n)
    away = rng.uniform(2.0, 5.0, n)
    points = np.column_stack(
        [away * np.cos(bearing), away * np.sin(bearing), rng.uniform(-1, 2, n)]
    )
    c, s = np.cos(motion.theta), np.sin(motion.theta)
    cr, sr = np.cos(motion.rise), np.sin(motion.rise)
    from_now = points - distance * np.array([c * cr, s * cr, sr])
    ca, sa = np.cos(motion.alpha), np.sin(motion.alpha)
    about_z = np.array([[ca, -sa, 0], [sa, ca, 0], [0, 0, 1]])
    turn = about_z @ tilt_matrix(motion.roll, motion.pitch)
    home, now = angles(points), angles(from_now @ turn)
    growth = np.log(np.linalg.norm(points, axis=1) / np.linalg.norm(from_now, axis=1))
    home, now = (a + rng.normal(0, noise, a.shape) for a in (home, now))
    now[:wrong, 0] = rng.uniform(-np.pi, np.pi, wrong)
    now[:wrong, 1] = rng.uniform(-0.5, 0.5, wrong)
    return Pairs.of(home, now, spread(n), growth)


MOTIONS = [Motion(0.3, 1.2), Motion(-2.9, 3.1), Motion(1.6, -2.0, 0.02, -0.03, 0.04)]


@pytest.mark.parametrize("motion", MOTIONS)
def test_exact_pairs_have_no_residual_and_are_possible(motion):
    found = residuals(np.array([motion]), made_up(motion))
    assert np.abs(found.value).max() < 1e-9
    assert found.possible.all()


def test_nothing_is_recognised_from_quite_another_side():
    """Between the two cameras lies a point that both see, from opposite sides."""
    motion = Motion(0.3, 0.0)
    ahead, behind = np.array([[0.3 + 0.1, 0.0]]), np.array([[0.3 + np.pi - 0.1, 0.0]])
    pairs = Pairs.of(ahead, behind, spread(1), np.zeros(1))
    found = residuals(np.array([motion]), pairs)
    assert abs(found.value[0, 0]) < 1e-6
    assert not found.possible.any()


@pytest.mark.parametrize("seed", range(4))
def test_near_home_the_direction_of_travel_is_found(seed):
    """Cameras may tilt by ten times what places are off: that must not turn the answer round."""
    rng = np.random.default_rng(seed)
    motion = Motion(*rng.uniform(-np.pi, np.pi, 2))
    pairs = made_up(motion, n=80, seed=seed, noise=SIGMA / 2, distance=0.12)
    fit = estimate_motion(pairs, np.ones(80), 0.02)
    assert abs(wrap(fit.motion.theta - motion.theta)) < 0.15
    assert fit.inlier.mean() > 0.9


def test_travelled_the_other_way_round_rays_mostly_meet_behind_a_camera():
    motion = Motion(0.3, 1.2)
    back = motion._replace(theta=motion.theta + np.pi)
    found = residuals(np.array([back]), made_up(motion))
    assert np.abs(found.value).max() < 1e-9
    assert found.possible.mean() < 0.1


def test_a_match_of_the_wrong_size_is_impossible():
    pairs = made_up(Motion(0.3, 1.2))
    larger = Pairs(pairs.table.copy())
    larger.growth[:] += 1.5
    assert residuals(np.array([Motion(0.3, 1.2)]), larger).possible.mean() < 0.2


@pytest.mark.parametrize("motion", MOTIONS)
def test_the_jacobian_is_the_derivative(motion):
    # Of exact pairs, whose residuals are zero, the deviation's own derivative does not matter.
    pairs, step, x = made_up(motion), 1e-6, np.array(motion)
    moved = np.concatenate([x + step * np.eye(5), x - step * np.eye(5)])
    values = residuals(moved, pairs).value
    numeric = (values[:5] - values[5:]).T / (2 * step)
    assert np.allclose(residuals(x[None], pairs).jacobian[0], numeric, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_two_points_give_the_motion_back(seed):
    rng = np.random.default_rng(seed)
    motion = Motion(*rng.uniform(-np.pi, np.pi, 2))
    pairs = made_up(motion, n=2, seed=seed)
    rows = coefficients(pairs.home_vectors, pairs.now_vectors)
    found = two_point_motions(rows[:1], rows[1:])
    off = np.abs(np.sin(found[:, 0] - motion.theta)) + np.abs(wrap(found[:, 1] - motion.alpha))
    assert off.min() < 1e-6
    assert msac_costs(found, pairs, 0.0, 9.0).max() < 1e-2


def test_points_at_one_height_give_no_solution_and_no_warning():
    level = np.zeros((3, 4))
    assert two_point_motions(level, level).shape == (0, 2)


@pytest.mark.parametrize("seed", range(4))
def test_the_motion_is_found_among_wrong_matches(seed):
    rng = np.random.default_rng(seed)
    motion = Motion(*rng.uniform(-np.pi, np.pi, 2))
    pairs = made_up(motion, n=80, seed=seed, noise=SIGMA, wrong=40)
    fit = estimate_motion(pairs, np.ones(80), 0.01)
    assert abs(wrap(fit.motion.theta - motion.theta)) < 0.02
    assert abs(wrap(fit.motion.alpha - motion.alpha)) < 0.01
    assert fit.inlier[40:].mean() > 0.9
    assert fit.inlier[:40].mean() < 0.2


def test_what_else_the_matches_may_say_is_kept_the_likeliest_first():
    """Two motions have half of the matches each: the one that is not the answer comes next."""
    truth, other = Motion(1.0, 0.4), Motion(-2.0, -1.5)
    pairs = made_up(truth, n=30, noise=SIGMA) + made_up(other, n=26, seed=1, noise=SIGMA)
    fit = estimate_motion(pairs, np.ones(56), 0.01)
    motions = np.vstack([fit.motion, fit.others])
    off = [np.abs(wrap(motions[k, :2] - each[:2])).max() for k, each in enumerate((truth, other))]
    assert max(off) < 0.02
    assert 2 <= len(fit.others) <= MAX_OTHERS
    apart = np.abs(wrap(motions[:, None, :2] - motions[:, :2])).max(axis=2)
    assert apart[~np.eye(len(motions), dtype=bool)].min() >= SAME


def test_tilt_is_taken_up():
    motion = Motion(0.7, -1.0, 0.035, -0.02, 0.01)
    fit = estimate_motion(made_up(motion, noise=SIGMA / 2), np.ones(60), 0.02)
    assert abs(wrap(fit.motion.theta - motion.theta)) < np.radians(0.5)
    assert abs(fit.motion.roll - motion.roll) < np.radians(0.3)


def test_too_few_matches_give_nothing():
    assert estimate_motion(made_up(Motion(0, 0), n=2), np.ones(2), 0.01) is None


def test_at_home_the_direction_is_as_good_as_unknown_and_the_heading_known():
    motion = Motion(0.4, 0.9)
    pairs = made_up(motion, noise=SIGMA, distance=1e-4)
    fit = refine(np.array([motion]), pairs, 0.01)
    sigmas = np.sqrt(np.diag(jackknife_covariance(fit, pairs, 0.01)))
    assert abs(wrap(fit.motion.alpha - motion.alpha)) < 0.005
    assert sigmas[0] > 0.3
    assert sigmas[1] < 0.01


def test_the_covariance_covers_errors_that_a_sector_shares():
    """Matches within one sector are shifted together: the plain covariance misses that."""
    plain, clustered = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        motion = Motion(*rng.uniform(-np.pi, np.pi, 2))
        pairs = made_up(motion, n=150, seed=seed, noise=SIGMA / 2)
        sector = np.floor((pairs.home[:, 0] / (2 * np.pi) + 0.5) * 24).astype(int) % 24
        now = pairs.now + rng.normal(0, SIGMA, (24, 2))[sector]
        shared = Pairs.of(pairs.home, now, spread(150), pairs.growth)
        fit = refine(np.array([motion]), shared, 0.01)
        error = wrap(np.array(fit.motion)[:2] - np.array(motion)[:2])
        for found, matrix in (
            (plain, np.linalg.inv(fit.information)),
            (clustered, jackknife_covariance(fit, shared, 0.01)),
        ):
            found.append(error @ np.linalg.solve(matrix[:2, :2], error))
    assert np.mean(plain) > 3.0
    assert 1.0 < np.mean(clustered) < 3.0


@pytest.mark.parametrize("angle", [0.0, 0.7, 1.4])
def test_an_error_counts_by_how_well_its_way_is_known(angle):
    """Two matches are off by as much; one is unsure of that way, the other of the way across."""
    exact, way = made_up(MOTIONS[0], n=1), np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-way[1], way[0]])
    unsure = np.stack([np.outer(v, v) for v in (0.02 * way, 0.02 * across)])
    off = Pairs.of(
        exact.home[[0, 0]],
        exact.now[[0, 0]] + 0.01 * way,
        unsure + 1e-4**2 * np.eye(2),
        exact.growth[[0, 0]],
    )
    by_way, by_way_across = residuals(np.array([MOTIONS[0]]), off).value[0]
    assert abs(by_way) == pytest.approx(0.5, rel=0.05)
    assert abs(by_way_across - by_way) > 0.1


@pytest.mark.parametrize("seed", range(8))
def test_an_object_with_another_motion_enlarges_the_covariance(seed):
    """Half of the matches lie on one thing, some 40 deg wide, that has another motion."""
    rng = np.random.default_rng(seed)
    truth = Motion(*rng.uniform(-np.pi, np.pi, 2))
    other = truth._replace(theta=truth.theta + 0.3, alpha=truth.alpha + 0.4)
    room, thing = made_up(truth, n=14, seed=seed, noise=SIGMA / 2), made_up(other, n=400, seed=99)
    near = np.flatnonzero(np.abs(wrap(thing.home[:, 0] - 1.0)) < 0.35)[:14]
    both = Pairs.of(
        np.concatenate([room.home, thing.home[near]]),
        np.concatenate([room.now, thing.now[near]]),
        spread(28),
        np.concatenate([room.growth, thing.growth[near]]),
    )
    fit = estimate_motion(both, np.ones(28), 0.01)
    error = wrap(np.array(fit.motion)[:2] - np.array(truth)[:2])
    assert error @ np.linalg.solve(jackknife_covariance(fit, both, 0.01)[:2, :2], error) < 16.0
