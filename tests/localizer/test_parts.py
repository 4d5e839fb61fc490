"""The parts of the localiser against dense algebra, numerical derivatives and known answers."""

import math

import numpy as np
import pytest
from rig import Wheels

from homeward.estimator import Innovation
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, compose
from homeward.localizer.home.estimate import fit
from homeward.localizer.home.hypotheses import search
from homeward.localizer.home.problem import HomeProblem
from homeward.localizer.inputs.bearing_noise import CorrelatedErrors, WeighedFrame
from homeward.localizer.map.landmarks import Landmark, Landmarks
from homeward.localizer.map.sightings import Frames
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.map.triangulation import triangulate
from homeward.localizer.motions import (
    CALIBRATION,
    DELAY,
    NC,
    TIME_CONSTANT,
    TURN_SCALE,
    Motion,
    camera_after,
)
from homeward.localizer.recovery.monitor import SlipDetector
from homeward.localizer.reference import window as elimination
from homeward.localizer.reference.factors import bearing_residuals, cameras
from homeward.localizer.resection import poses_from_triples
from homeward.localizer.tunables import MEAN_S
from homeward.odometry.validity import Clock

NOTHING = np.zeros(len(CALIBRATION))


def random_equations(rng, w, a):
    """A chain's normal equations, blocks and dense."""
    n = 3 * w + a
    hessian, gradient = np.eye(n), rng.normal(size=n)
    for k in range(w):
        columns = np.r_[3 * k : min(3 * k + 6, 3 * w), 3 * w : n]
        j = rng.normal(size=(8, columns.size))
        hessian[np.ix_(columns, columns)] += j.T @ j
    e = elimination.NormalEquations.zeros(w, a)
    for k in range(w):
        own = slice(3 * k, 3 * k + 3)
        e.own[k], e.shared[k], e.slope[k] = hessian[own, own], hessian[own, 3 * w :], gradient[own]
        if k + 1 < w:
            e.next[k] = hessian[own, 3 * k + 3 : 3 * k + 6]
    e.common[:], e.common_slope[:] = hessian[3 * w :, 3 * w :], gradient[3 * w :]
    return e, hessian, gradient


@pytest.mark.parametrize("w", [1, 2, 8, 9, 10, 17, 40])
def test_the_chain_is_solved_as_the_dense_system(w):
    e, hessian, gradient = random_equations(np.random.default_rng(w), w, 7)
    left = elimination.eliminate(e)
    poses, common, covariance = left.solve()
    assert np.allclose(np.r_[poses.ravel(), common], np.linalg.solve(hessian, gradient))
    again, shared = left.step(2.0 * e.slope, 2.0 * e.common_slope)
    assert np.allclose(again, 2.0 * poses)
    assert np.allclose(shared, 2.0 * common)
    inverse = np.linalg.inv(hessian)
    assert np.allclose(covariance, inverse[3 * w - 3 :, 3 * w - 3 :])
    own, lever, shared = elimination.marginals(e)
    assert np.allclose(shared, inverse[3 * w :, 3 * w :])
    for k in range(w):
        rows = slice(3 * k, 3 * k + 3)
        assert np.allclose(own[k], inverse[rows, rows])
        assert np.allclose(-lever[k] @ shared, inverse[rows, 3 * w :])


def drive(odometry, seconds=4.0, sideways=0.0):
    rng = np.random.default_rng(3)
    for k in range(int(seconds * 20)):
        vy = sideways * math.cos(k / 17)
        odometry.add(k / 20, 0.3 + 0.1 * rng.normal(), 0.5 * math.sin(k / 13), vy)
    odometry.restart(1.0)


def integrated(calibration, until=3.0, sideways=0.0):
    odometry = Wheels()
    drive(odometry, sideways=sideways)
    return odometry.motion(until, calibration)


def test_a_pose_that_nothing_fixes_is_an_error():
    e = elimination.NormalEquations.zeros(3, 5)
    e.common[:] = np.eye(5)
    with pytest.raises(np.linalg.LinAlgError):
        elimination.eliminate(e).solve()


@pytest.mark.parametrize("sideways", [0.0, 0.4])
def test_motion_is_linear_in_its_calibration_as_it_says(sideways):
    at = np.array([0.02, 0.003, 0.01, 0.13, 0.15, 0.05, 0.03, 0.0, 0.1, -0.1])
    motion = integrated(at, sideways=sideways)

    def change(step):
        """Twice the change of the motion by a step of the calibration."""
        after, before = (integrated(at + s * step, sideways=sideways) for s in (1.0, -1.0))
        return after.delta - before.delta

    for i in range(len(CALIBRATION)):
        step = np.zeros(len(CALIBRATION))
        step[i] = 1e-6
        numeric = change(step) / 2e-6
        if i == DELAY:  # of mean twists, so that their noise is no information
            step[i], error = MEAN_S / 2.0, 0.03
            numeric = change(step) / MEAN_S
        else:  # the time constant acts on averages, too
            error = 0.04 if i == TIME_CONSTANT else 2e-4
        assert motion.jacobian[:, i] == pytest.approx(numeric, abs=error), CALIBRATION[i]


@pytest.mark.parametrize("sideways", [0.0, 0.4])
def test_motion_in_pieces_is_the_motion_at_once(sideways):
    pieces = Wheels()
    drive(pieces, sideways=sideways)
    for t in (1.4, 1.41, 2.3, 3.0):
        motion = pieces.advance(t, NOTHING)
    whole = integrated(NOTHING, sideways=sideways)
    assert np.allclose(motion.delta, whole.delta)
    assert np.allclose(motion.jacobian, whole.jacobian)
    assert np.allclose(motion.covariance, whole.covariance, rtol=2e-2, atol=1e-9)


def test_a_robot_that_stands_gathers_no_noise_and_one_without_odometry_does():
    odometry = Wheels()
    odometry.add(0.0, 0.0, 0.0)
    odometry.restart(0.0)
    assert not odometry.motion(1.0, NOTHING).covariance.any()
    assert odometry.motion(10.0, NOTHING).covariance[0, 0] > 1.0


def silent(hz, speed=0.2):
    """The motion over ten seconds of silence after a drive, asked for so many times a second."""
    odometry = Wheels()
    odometry.restart(0.0)
    for k in range(100):
        odometry.add(k / 10, speed, 0.1)
    odometry.advance(10.0, NOTHING)
    odometry.restart(10.0)
    for k in range(1, 10 * hz + 1):
        motion = odometry.advance(10.0 + k / hz, NOTHING)
    return motion


def test_how_often_one_asks_does_not_matter_while_odometry_is_silent():
    spread = [np.sqrt(silent(hz).covariance.diagonal()) for hz in (1, 5, 50)]
    assert spread[1] == pytest.approx(spread[0], rel=1e-3)
    assert spread[2] == pytest.approx(spread[0], rel=1e-3)


def test_a_fast_robot_gets_farther_while_odometry_is_silent():
    slow, fast = (math.sqrt(silent(5, speed).covariance[0, 0]) for speed in (0.2, 2.0))
    assert fast > 5.0 * slow
    assert fast > 4.0


def test_bearings_have_the_derivatives_they_say():
    rng = np.random.default_rng(0)
    odometry = Wheels()
    drive(odometry)
    calibration = np.array([0.01, 0.0, 0.0, 0.1, 0.1, 0.04, 0.0, 0.02, 0.03, -0.02])
    motion = odometry.motion(1.7, calibration)
    one, mount = np.ones(1), np.array([0.2, -0.1, 0.3])
    frames = Frames()
    nothing = WeighedFrame(0.0, [], np.zeros(0), np.zeros(0))
    camera = camera_after(motion, mount, calibration)
    frames.add(0, camera.uncalibrated, camera.jacobian, nothing)
    x = np.concatenate([rng.normal(size=3), calibration, [3.0, 2.0]])

    def expected(x):
        eyes = cameras(frames.free, frames.jacobians, x[:3], x[3 : 3 + NC])
        return bearing_residuals(0.4 * one, *eyes, x[None, 3 + NC :])

    _, jacobian = expected(x)
    for i in range(x.size):
        step = np.zeros(x.size)
        step[i] = 1e-6
        numeric = -(expected(x + step)[0] - expected(x - step)[0]) / 2e-6
        assert jacobian[0, i] == pytest.approx(numeric[0], abs=1e-6)
    robot = compose(Pose(*x[:3]), Pose(*motion.delta))
    camera = compose(robot, Pose(0.23, -0.12, 0.32))
    assert expected(x)[0][0] == pytest.approx(wrap(0.4 - bearing(camera, 3.0, 2.0)))
    assert motion.jacobian[2, TURN_SCALE] != 0
    assert motion.jacobian[2, DELAY] != 0


def test_a_landmark_starts_among_wrong_sight_lines():
    rng = np.random.default_rng(1)
    cameras = np.stack([np.linspace(0, 1.5, 15), np.zeros(15), rng.normal(0, 0.3, 15)], axis=1)
    true = np.array([1.0, 2.5])
    lines = np.arctan2(true[1] - cameras[:, 1], true[0] - cameras[:, 0])
    bearings = wrap(lines - cameras[:, 2] + 0.005 * rng.normal(size=15))
    bearings[[2, 7, 11]] += [0.7, -0.5, 1.0]
    found = triangulate(cameras, bearings, np.full(15, 0.01), 0.06)
    assert found is not None
    assert found[0] == pytest.approx(true, abs=0.1)
    assert not found[1][[2, 7, 11]].any()


@pytest.mark.parametrize("wrong", [{3: 2.0}, {0: -0.5, 5: 1.0}])
def test_a_wrong_sight_line_places_no_landmark_on_the_way(wrong):
    cameras = np.stack([np.linspace(0, 0.5, 6), np.zeros(6), np.zeros(6)], axis=1)
    bearings = np.arctan2(0.05, 8.0 - cameras[:, 0])  # ahead, with hardly any parallax
    for line, off in wrong.items():
        bearings[line] += off
    assert triangulate(cameras, bearings, np.full(6, 0.01), 0.06) is None


def test_a_landmark_without_parallax_waits():
    cameras = np.stack([np.linspace(0, 0.05, 10), np.zeros(10), np.zeros(10)], axis=1)
    lines = np.arctan2(3.0, 3.0 - cameras[:, 0])
    assert triangulate(cameras, lines, np.full(10, 0.01), 0.06) is None


def test_three_bearings_fix_a_pose():
    points = np.array([[2.0, 1.0], [-1.0, 2.0], [0.5, -2.0]])
    true = Pose(0.3, -0.4, 1.2)
    (pose,) = poses_from_triples(points, bearing(true, points[:, 0], points[:, 1]))
    assert pose == pytest.approx(np.array(true), abs=1e-9)


def problem(faults, q=8, seed=0, sigma=0.01):
    rng = np.random.default_rng(seed)
    angles = 2 * math.pi * np.arange(q) / q + rng.uniform(-0.3, 0.3, q)
    marks = rng.uniform(1.5, 3.0, q)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    home = Pose(0.2, -0.1, 0.7)
    stored = bearing(home, marks[:, 0], marks[:, 1]) + sigma * rng.normal(size=q)
    for i, fault in faults.items():
        stored[i] += fault
    spread = np.diag(np.r_[np.full(4, 1e-6), np.full(2 * q, 1e-4)])
    mean = np.r_[np.zeros(4), (marks + 0.01 * rng.normal(size=marks.shape)).ravel()]
    return home, HomeProblem(mean, spread, wrap(stored), np.full(q, sigma), np.zeros(3), True, 0.1)


@pytest.mark.parametrize("faults", [{}, {2: 0.3}, {1: -0.25, 6: 0.4}, {0: 0.5, 3: 0.3, 5: -0.4}])
def test_home_is_found_among_wrong_bearings(faults):
    home, known = problem(faults)
    found = search(known)
    assert found is not None
    assert set(np.flatnonzero(~found.best.inliers)) == set(faults)
    assert found.best.home == pytest.approx(np.array(home), abs=0.04)
    assert set(np.flatnonzero(found.moved_probabilities() > 0.5)) == set(faults)


def test_evidence_of_a_flip_is_what_the_odds_say():
    _, known = problem({})
    everything = fit(known, np.array([0.2, -0.1, 0.7]), np.ones(8, bool))
    for i in range(8):
        inliers = np.ones(8, bool)
        inliers[i] = False
        without = fit(known, everything.home, inliers)
        assert everything.log_evidence - without.log_evidence == pytest.approx(
            everything.odds[i], abs=0.05
        )


def test_two_bearings_do_not_fix_home():
    _, known = problem({}, q=2)
    assert search(known) is None


def sighted(*fits):
    """Innovations of which some fit."""
    return [Innovation(f"L{i}", 0.0 if f else 0.1, 0.01, f) for i, f in enumerate(fits)]


def test_a_slip_is_suspected_while_most_is_off():
    slip = SlipDetector()
    assert not slip.suspects(sighted(True, True, False), Motion.identity())
    assert slip.suspects(sighted(True, False, False, False), Motion.identity())
    assert slip.suspects(sighted(True, True, False, False, False), Motion.identity())
    assert not slip.suspects(sighted(True, True, True, True, True), Motion.identity())
    assert slip.search is None


def test_a_landmark_refused_more_often_than_not_is_to_start_anew():
    landmarks = Landmarks(
        Smoother(np.ones(7), np.ones(NC), np.ones(3), CorrelatedErrors(), 0.0), 0.06
    )
    landmarks.mapped["a"] = Landmark("a", 0)
    assert not any(landmarks.update_rejections({"a": fit}) for fit in 20 * [False, True])
    assert not any(landmarks.update_rejections({"a": fit}) for fit in 20 * [False, False, True])
    assert any(landmarks.update_rejections({"a": fit}) for fit in 20 * [False, False, False, True])
    for _ in range(300):
        landmarks.update_rejections({"a": False})
    assert not [landmarks.update_rejections({"a": True}) for _ in range(20)][-1]


def test_a_clock_that_is_set_back_goes_on():
    clock = Clock()
    assert clock.read(100.0) == 100.0
    assert clock.read(99.5) == 99.5  # late
    times = [clock.read(10.0 + 0.2 * k) for k in range(20)]
    assert times[0] < 100.0
    assert 100.0 < times[-1] < 105.0
    assert np.all(np.diff(times[10:]) > 0)
    assert math.isnan(clock.read(math.nan))
