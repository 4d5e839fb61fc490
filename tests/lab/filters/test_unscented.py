"""The UKF against the Kalman filter where all is linear, and against samples where it is not."""

import casadi as ca
import numpy as np
import pytest
from lab.model_by_hand import scene

from homeward.lab.engine.program.stages import BELIEF, Interpreter
from homeward.lab.filters.ekf import (
    ExtendedKalmanFilter,
    UnscentedFilter,
    cholesky,
    predict_function,
    update_function,
)
from homeward.lab.model import PolarModel

Q, DT = 5, 0.2


def stepper(kind, stored, control, input_covariance, walk=0.0):
    kernel = Interpreter(predict_function(kind))
    kernel.inputs["stored"][:], kernel.inputs["dt"][:] = stored, DT
    kernel.inputs["control"][:] = control
    kernel.inputs["input_covariance"][...] = input_covariance
    kernel.inputs["state_variance"][:] = walk

    def step(belief):
        for name in BELIEF:
            kernel.inputs[name][...] = belief[name]
        kernel()
        return {name: kernel.outputs[name].copy() for name in BELIEF}

    return step


def belief_of(state, covariance, active=1.0):
    nothing = np.zeros(0)
    full = np.full(len(state) - 3, active)
    return {"state": state, "covariance": covariance, "active": full, "integral": nothing}


def random_covariance(n, sigma, seed=0):
    root = np.random.default_rng(seed).normal(size=(n, n)) * sigma / np.sqrt(n)
    return root @ root.T


def start(seed=3):
    _, polar, beta, stored = scene(Q, seed)
    return np.r_[polar, beta], stored


def test_turning_on_the_spot_is_linear_and_the_ukf_is_the_kalman_filter():
    x, stored = start()
    P = random_covariance(3 + Q, 0.5)
    noise = np.diag([0.0, 0.3**2])
    beliefs = []
    for kind in (UnscentedFilter(PolarModel(Q)), ExtendedKalmanFilter(PolarModel(Q))):
        belief, step = belief_of(x, P), stepper(kind, stored, [0.0, 0.7], noise, 1e-4)
        update = Interpreter(update_function(kind))
        for k in range(20):
            belief = step(belief)
            for name in BELIEF:
                update.inputs[name][...] = belief[name]
            update.inputs["bearings"][:] = x[3:] - 0.14 * (k + 1)
            update.inputs["mask"][:], update.inputs["variance"][:] = 1.0, 0.05**2
            update.inputs["gate"][:] = np.inf
            update()
            belief = {name: update.outputs[name].copy() for name in BELIEF}
        beliefs.append(belief)
    for name in ("state", "covariance"):
        np.testing.assert_allclose(beliefs[0][name], beliefs[1][name], atol=1e-12)


def test_moments_of_a_curved_step_are_nearer_the_samples_than_those_of_the_ekf():
    x, stored = start()
    x[0] = 1.0
    P = np.diag(np.r_[0.05, 0.3, 0.5, np.full(Q, 0.02)] ** 2)
    noise, control = np.diag([0.3**2, 0.5**2]), [1.0, 0.8]
    one = Interpreter(predict_function(ExtendedKalmanFilter(PolarModel(Q, guard=1e-3))))
    one.inputs["stored"][:], one.inputs["dt"][:], one.inputs["active"][:] = stored, DT, 1.0
    rng, moved = np.random.default_rng(1), []
    for _ in range(20_000):
        one.inputs["state"][:] = rng.multivariate_normal(x, P)
        one.inputs["control"][:] = rng.multivariate_normal(control, noise)
        one()
        moved.append(one.outputs["state"][:3].copy())
    mean, spread = np.mean(moved, axis=0), np.cov(np.transpose(moved))
    off = {}
    for kind in (UnscentedFilter, ExtendedKalmanFilter):
        step = stepper(kind(PolarModel(Q, guard=1e-3)), stored, control, noise)
        found = step(belief_of(x, P))
        difference = found["state"][:3] - mean
        off[kind] = difference @ np.linalg.solve(spread, difference)
    # The mean of 20,000 samples is itself off by about 3 / 20,000 on this scale.
    assert off[UnscentedFilter] < 0.001
    assert off[UnscentedFilter] < 0.2 * off[ExtendedKalmanFilter]


@pytest.mark.parametrize("rank", [0, 1, 3, 6])
def test_the_root_of_a_covariance_that_lacks_directions(rank):
    factor = np.random.default_rng(rank).normal(size=(6, rank))
    matrix = factor @ factor.T
    root = np.array(ca.DM(cholesky(ca.SX(ca.DM(matrix)))))
    assert np.isfinite(root).all()
    np.testing.assert_allclose(root @ root.T, matrix, atol=1e-6)
    assert np.allclose(np.triu(root, 1), 0.0)
