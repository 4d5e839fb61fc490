"""The invariant EKF: its error, its derivatives, and the ordinary EKF where both sit on truth."""

import casadi as ca
import numpy as np
import pytest
from lab.model_by_hand import scene

from homeward.geometry.frames import Pose, bearing, to_polar
from homeward.lab.filters.backend import Setup
from homeward.lab.filters.invariant import (
    InvariantFilter,
    error_between,
    motion_function,
    moved,
    sight_function,
)
from homeward.lab.model import home_anchored_bearing

Q, SIGMA = 5, 0.02
DENSITY = np.array([0.03**2, 0.05**2])


def numeric(f, x, step=1e-6):
    columns = [(f(x + step * e) - f(x - step * e)) / (2 * step) for e in np.eye(len(x))]
    return np.stack(columns, axis=-1)


def make(pose=(0.6, -0.5, 0.3), seed=2, inverse_sigma=0.5, density=DENSITY, gate=np.inf):
    landmarks, _, _, stored = scene(Q, seed)
    start = to_polar(Pose(*pose)), np.array([0.05, 0.05, 0.1])
    setup = Setup(*start, stored, SIGMA, density, gate, 1)
    return InvariantFilter(setup, np.full(Q, 0.01), (0.5, inverse_sigma)), landmarks


def error(true, pose):
    return np.array(ca.DM(error_between(ca.SX(ca.DM(true)), ca.SX(ca.DM(pose)))))[:, 0]


def test_the_error_is_what_the_pose_is_moved_by():
    pose, off = np.array([0.6, -0.4, 2.0]), np.array([0.3, -0.2, 0.7])
    true = np.array(ca.DM(moved(ca.SX(ca.DM(pose)), ca.SX(ca.DM(off)))))[:, 0]
    np.testing.assert_allclose(error(true, pose), off, atol=1e-12)


def test_odometry_changes_no_error_however_large_and_wherever_the_robot_is():
    rng = np.random.default_rng(0)
    true, pose = rng.normal(size=3), rng.normal(size=3) * 3
    before = error(true, pose)
    for control in rng.normal(size=(200, 2)):
        true, pose = (np.asarray(motion_function()(p, control, 0.1)[0])[:, 0] for p in (true, pose))
    np.testing.assert_allclose(error(true, pose), before, atol=1e-9)


def test_a_prediction_without_noise_leaves_the_covariance():
    quiet, _ = make(density=np.zeros(2))
    belief = quiet.start()
    after = quiet.predict(belief, 0.7, (0.4, -1.0))
    assert not np.array_equal(after.pose, belief.pose)
    assert np.array_equal(after.covariance, belief.covariance)


def test_derivatives_of_a_sighting():
    own, _ = make()
    belief = own.start()

    def look(x):
        pose = np.array(ca.DM(moved(ca.SX(ca.DM(belief.pose)), ca.SX(ca.DM(x[:3])))))[:, 0]
        return home_anchored_bearing(Pose(*pose), belief.home[1] + x[3], belief.inverse[1] + x[4])

    slopes = sight_function(Q)(belief.pose, belief.home[None], belief.inverse[None])[1]
    np.testing.assert_allclose(np.asarray(slopes)[:, 1], numeric(look, np.zeros(5)), atol=1e-8)


def test_on_the_truth_it_is_the_ordinary_ekf():
    own, landmarks = make(inverse_sigma=1e-9)
    distances, home = np.hypot(*landmarks.T), np.arctan2(landmarks[:, 1], landmarks[:, 0])
    belief = own.start()
    belief = type(belief)(
        belief.pose, home, 1 / distances, own.start().covariance.copy(), np.zeros(Q)
    )
    state = np.r_[belief.pose, home, 1 / distances]
    belief.covariance[3 + Q :, 3 + Q :] = 0.3**2 * np.eye(Q)
    P = np.diag(np.r_[np.zeros(3), np.full(Q, 0.01), np.full(Q, 0.3)] ** 2)
    P[:3, :3] = own.pose(belief)[1]

    def drive(x, u):
        return np.asarray(motion_function()(x, u, 0.1)[0])[:, 0]

    def look(x):
        return home_anchored_bearing(Pose(*x[:3]), x[3 : 3 + Q], x[3 + Q :])

    control = np.array([0.3, 0.6])
    for _ in range(40):
        G, Gu = np.eye(state.size), np.zeros((state.size, 2))
        G[:3, :3] = numeric(lambda x: drive(x, control), state[:3])
        Gu[:3] = numeric(lambda u, at=state[:3]: drive(at, u), control)
        state[:3] = drive(state[:3], control)
        P = G @ P @ G.T + Gu * (DENSITY / 0.1) @ Gu.T
        H = numeric(look, state)
        S = H @ P @ H.T + SIGMA**2 * np.eye(Q)
        P = P - P @ H.T @ np.linalg.solve(S, H @ P)
        belief = own.predict(belief, 0.1, tuple(control))
        seen = {i: float(bearing(Pose(*state[:3]), *landmarks[i])) for i in range(Q)}
        belief, out = own.update(belief, seen, {})
        np.testing.assert_allclose(out["innovation"], 0.0, atol=1e-6)
        np.testing.assert_allclose(out["innovation_variance"], np.diag(S), rtol=1e-4)
    pose, covariance = own.pose(belief)
    np.testing.assert_allclose(pose[:2], state[:2], atol=1e-5)
    np.testing.assert_allclose(covariance, P[:3, :3], rtol=1e-3, atol=1e-9)


def test_it_drives_through_home_and_finds_the_landmarks():
    own, landmarks = make(pose=(-0.8, 0.0, 0.0))
    belief, pose = own.start(), Pose(-0.8, 0.0, 0.0)
    rng = np.random.default_rng(3)
    for k in range(161):
        seen = {i: float(bearing(pose, *landmarks[i])) for i in range(Q)}
        belief, _ = own.update(belief, {i: b + rng.normal() * SIGMA for i, b in seen.items()}, {})
        assert np.isfinite(belief.covariance).all()
        belief = own.predict(belief, 0.1, (0.1, 0.0))
        pose = Pose(-0.8 + 0.01 * (k + 1), 0.0, 0.0)
    found, covariance = own.pose(belief)
    off = np.subtract(found, pose)
    assert off @ np.linalg.solve(covariance, off) < 16.3  # chi-square(3), one in a thousand
    distance = np.hypot(*landmarks.T)
    known = own.landmarks(belief)
    assert np.all(np.abs(known.distance - distance) < 4 * known.sigma_distance)


def test_a_sighting_outside_the_gate_changes_nothing():
    strict, landmarks = make(inverse_sigma=0.01, gate=9.0)
    belief = strict.start()
    after, out = strict.update(
        belief, {0: float(bearing(Pose(*belief.pose), *landmarks[0])) + 2.0}, {}
    )
    assert out["accepted"].sum() == 0
    assert np.array_equal(after.pose, belief.pose)
    assert np.array_equal(after.active, np.zeros(Q))


@pytest.mark.parametrize("interval", [0.0, -1.0])
def test_no_time_no_change(interval):
    own, _ = make()
    belief = own.start()
    assert own.predict(belief, interval, (1.0, 1.0)) is belief
