"""The compiled loops say what NumPy says, and without a compiler NumPy says it."""

import ctypes
from dataclasses import replace

import numpy as np
import pytest

from homeward.drives.drive import OdometryNoise
from homeward.drives.odometry_noise import OdometryDefaults, noise_rates
from homeward.engine.native.program import Array
from homeward.localizer.compiled import compiled
from homeward.localizer.home import gauss_newton
from homeward.localizer.home.gauss_newton import fit, solved
from homeward.localizer.home.linearisation import linearised
from homeward.localizer.home.problem import HomeProblem
from homeward.localizer.localizer import Localizer
from homeward.localizer.map import elimination, sightings
from homeward.localizer.map.factors import STEP, add_odometry, add_sightings, step_row
from homeward.localizer.map.gating import consistent_subset
from homeward.localizer.map.sightings import COLUMNS, LANDMARK, NC, SIGMA, bearing_residuals
from homeward.localizer.map.state import HEAD, Marginal
from homeward.localizer.motion.preintegration import Motion, integrate
from homeward.localizer.output.pose import in_home_frame

pytestmark = pytest.mark.skipif(compiled() is None, reason="no C compiler, nothing to compare")


def a_map(rng, w=9, n=6, m=70, first=4):
    """Poses, calibration, landmarks, sightings and steps between the poses; some are far off."""
    poses = np.cumsum(rng.normal(0.3, 0.2, (w, 3)), axis=0)
    calibration, positions = 0.05 * rng.normal(size=NC), rng.normal(0.0, 3.0, (n, 2))
    rows = rng.normal(0.0, 1.0, (m, COLUMNS))
    rows[:, 0], rows[:, LANDMARK] = first + rng.integers(0, w, m), rng.integers(0, n, m)
    rows[:, SIGMA] = rng.uniform(0.01, 0.3, m)
    steps = [
        step_row(
            Motion(rng.normal(size=3), np.diag(rng.uniform(1e-4, 1, 3)), rng.normal(size=(3, NC))),
            calibration,
        )
        for _ in range(w - 1)
    ]
    return poses, calibration, positions, rows, np.concatenate([np.zeros((0, STEP)), *steps]), first


def equations(poses, calibration, positions, rows, steps, first):
    e = elimination.NormalEquations.zeros(len(poses), NC + positions.size)
    e.own[:] = e.own + np.eye(3)
    e.common[:] = np.eye(len(e.common))
    add_odometry(e, poses, calibration, steps)
    add_sightings(e, poses, calibration, positions, rows, first)
    return e


@pytest.mark.parametrize("w", [1, 2, 9, 40])
def test_normal_equations_and_their_solution(both, w):
    native, plain = both(equations, *a_map(np.random.default_rng(w), w))
    for field in ("own", "next", "shared", "common", "slope", "common_slope"):
        theirs = getattr(plain, field)
        assert np.allclose(
            getattr(native, field), theirs, rtol=1e-10, atol=1e-9 * np.abs(theirs).max(initial=0.0)
        ), field
    for part, other in zip(*both(elimination.solve, plain), strict=True):
        assert np.allclose(part, other, rtol=1e-8, atol=1e-10)


def test_a_pose_that_nothing_fixes_is_an_error_both_ways(monkeypatch):
    e = elimination.NormalEquations.zeros(3, 5)
    e.common[:] = np.eye(5)
    with pytest.raises(np.linalg.LinAlgError):
        elimination.solve(e)
    monkeypatch.setattr(elimination, "compiled", lambda: None)
    with pytest.raises(np.linalg.LinAlgError):
        elimination.solve(e)


def test_residuals_and_their_derivatives(both):
    rng = np.random.default_rng(0)
    _, calibration, _, rows, _, _ = a_map(rng)
    poses, positions = rng.normal(size=(len(rows), 3)), rng.normal(0.0, 3.0, (len(rows), 2))
    positions[0] = poses[0, :2]  # on the robot
    rows[:5, sightings.BEARING] = [np.pi, -np.pi, 40.0, -40.0, 0.0]
    for native, plain in zip(
        *both(bearing_residuals, poses, calibration, positions, rows), strict=True
    ):
        assert np.allclose(native, plain, rtol=1e-12, atol=1e-12)


def a_gaussian(rng, n=5):
    """A Gaussian on pose, calibration and landmarks, and sightings of some of these."""
    size = HEAD + 2 * n
    root = 0.1 * rng.normal(size=(size, size))
    rows = a_map(rng, n=n, m=7)[3]
    rows[:, sightings.OFFSET_JACOBIAN] *= 0.1
    return Marginal(rng.normal(0.0, 3.0, size), root @ root.T), rows


def test_the_gaussian_moves_predicts_and_is_corrected(both):
    rng = np.random.default_rng(2)
    gaussian, rows = a_gaussian(rng)
    motion = Motion(rng.normal(size=3), np.diag([0.1, 0.2, 0.3]), rng.normal(size=(3, NC)))
    predicted = both(gaussian.predict_bearings, rows)
    for field in ("residual", "jacobian", "correlated", "innovation_covariance"):
        assert np.allclose(*(getattr(p, field) for p in predicted)), field
    for native, plain in (
        both(gaussian.propagate, motion, 0.1 * rng.normal(size=NC)),
        both(gaussian.update, predicted[0]),
        both(gaussian.update, predicted[0].only(np.arange(7) < 3)),
    ):
        assert np.allclose(native.mean, plain.mean)
        assert np.allclose(native.covariance, plain.covariance)
        assert np.array_equal(native.covariance, native.covariance.T)


@pytest.mark.parametrize("number", [-1.0, 5.0, 1e9])
def test_a_landmark_that_is_not_there_is_an_error(number):
    gaussian, rows = a_gaussian(np.random.default_rng(3))
    rows[3, LANDMARK] = number
    with pytest.raises(IndexError):
        gaussian.predict_bearings(rows)
    poses, calibration, positions, rows, _, first = a_map(np.random.default_rng(4))
    rows[3, LANDMARK] = number + 1.0 if number > 0 else number
    e = elimination.NormalEquations.zeros(len(poses), NC + positions.size)
    with pytest.raises(IndexError):
        add_sightings(e, poses, calibration, positions, rows, first)
    with pytest.raises(IndexError):
        add_sightings(e, poses, calibration, positions, np.abs(rows), first + 1)


def test_sightings_without_spread_are_an_error_and_change_nothing():
    gaussian, rows = a_gaussian(np.random.default_rng(3))
    seen = gaussian.predict_bearings(rows)
    seen.innovation_covariance[:] = -1.0
    seen.residual[:] = 0.0
    before = gaussian.covariance.copy()
    with pytest.raises(np.linalg.LinAlgError):
        gaussian.update(seen)
    assert np.array_equal(gaussian.covariance, before)


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


@pytest.mark.parametrize("prior", [None, np.array([0.1, -0.1, 0.2])])
def test_home_is_solved_for(both, prior):
    problem = a_home(np.random.default_rng(4), prior=prior)
    around = both(linearised, problem, np.array([0.1, 0.1, -0.2]), problem.mean)
    assert np.allclose(around[0].correlated, around[1].correlated)
    assert np.allclose(around[0].residual_covariance, around[1].residual_covariance)
    for inliers in (np.ones(6, bool), np.array([1, 0, 1, 1, 0, 1], bool)):
        native, plain = both(solved, around[0], inliers)
        for field in ("step", "precision", "information", "log_volume", "home", "joint_covariance"):
            assert np.allclose(getattr(native, field), getattr(plain, field)), field
        for field in ("innovation", "variance", "odds", "log_evidence"):
            ours, theirs = (getattr(v, field) for v in both(lambda f: replace(f).evidence, native))
            assert np.allclose(ours, theirs), field
        assert np.allclose(*both(lambda f: replace(f).inflation, native), rtol=1e-8)
        ours, theirs = both(in_home_frame, native)
        assert np.allclose(ours.pose, theirs.pose)
        assert np.allclose(ours.covariance, theirs.covariance)
        inside = native.precision[inliers][:, inliers]
        assert np.allclose(
            inside @ around[0].residual_covariance[inliers][:, inliers], np.eye(inliers.sum())
        )
        assert not native.precision[~inliers].any()


@pytest.mark.parametrize("steps", [1, 3, 20])
@pytest.mark.parametrize("prior", [None, np.array([0.1, -0.1, 0.2])])
def test_home_is_iterated_to(both, prior, steps):
    problem = a_home(np.random.default_rng(6), prior=prior)
    inliers = np.array([1, 1, 1, 0, 1, 1], bool)
    native, plain = both(fit, problem, np.array([0.4, -0.3, 0.3]), inliers, steps)
    for field in ("home", "step", "known", "information", "log_evidence", "joint_covariance"):
        assert np.allclose(getattr(native, field), getattr(plain, field)), field
    if steps == 20:
        assert problem.length(native.step) < gauss_newton.SETTLED
    assert both(fit, problem, np.zeros(3), np.zeros(6, bool))[0] is None or prior is not None


def test_bearings_without_spread_fix_no_home(both):
    problem = a_home(np.random.default_rng(5))
    around = linearised(problem, np.zeros(3), problem.mean)
    around.residual_covariance[:] = -1.0
    assert both(solved, around, np.ones(6, bool)) == (None, None)


@pytest.mark.parametrize(
    "given", [OdometryNoise(), OdometryNoise(speed_sigma=0.01, turn_sigma=0.02)]
)
def test_preintegration(both, given):
    rng = np.random.default_rng(1)
    pieces = rng.uniform(0.0, 0.3, (30, 5))
    pieces[:, 3:] = rng.normal(0.0, 0.5, (30, 2))
    pieces[::3, :2] = pieces[3, 3:] = 0.0
    pieces[7, 4] = pieces[9, 3] = 0.0
    calibration = np.array([0.03, 0.002, 0.04, 0.2, 0.01])
    rates = noise_rates(given, OdometryDefaults())
    for n in (1, 30):
        native, plain = both(integrate, pieces[:n], calibration, rates, 0.7)
        assert np.allclose(native[1], plain[1])
        for field in ("delta", "covariance", "jacobian", "path", "turned"):
            assert np.allclose(getattr(native[0], field), getattr(plain[0], field)), field


def test_arguments_are_doubles_row_by_row_and_outlive_the_call():
    integrate = compiled().integrate
    for wrong in (np.zeros((4, 3), int), np.zeros((4, 6))[:, ::2]):
        with pytest.raises(ctypes.ArgumentError):
            integrate(1, wrong, *[np.zeros(15)] * 2, *[0.0] * 2, 1, *[np.zeros(15)] * 5)
    fixed = np.arange(12.0)
    fixed.flags.writeable = False
    for array in (fixed, np.zeros((0, 3))):
        assert Array(np.float64).from_param(array).value == array.ctypes.data


def test_without_a_compiler_the_user_is_told(monkeypatch):
    monkeypatch.delitem(vars(compiled), "_loaded")
    monkeypatch.setenv("CC", "no-such-compiler")
    assert compiled() is None
    assert any("no-such-compiler" in note for note in Localizer({}).notes)


@pytest.mark.parametrize("m", [1, 2, 3, 9, 40])
def test_which_residuals_agree(both, m):
    rng = np.random.default_rng(m)
    factor = rng.normal(size=(m, 3))
    spread = 0.05**2 * factor @ factor.T + np.diag(rng.uniform(0.005, 0.02, m) ** 2)
    residual = rng.multivariate_normal(np.zeros(m), spread)
    wrong = m // 3 if m > 3 else 0  # three that have three unknowns in common tell nothing
    residual[:wrong] += rng.choice([-0.3, 0.3], wrong)
    native, plain = both(consistent_subset, residual, spread, 4.0, np.zeros(m, bool))
    assert native.tolist() == plain.tolist() == (np.arange(m) >= wrong).tolist()


def test_where_nothing_can_be_told_all_agree(both):
    for kept in both(consistent_subset, np.ones(3), -np.eye(3), 4.0, np.ones(3, bool)):
        assert kept.all()
