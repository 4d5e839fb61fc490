"""The UKF against the Kalman filter where all is linear, and against samples where it is not."""

import casadi as ca
import numpy as np
import pytest
from lab.model_by_hand import scene

from homeward.lab.engine.program import Machine, filter_program
from homeward.lab.filters.ekf import ExtendedKalmanFilter, UnscentedFilter, cholesky
from homeward.lab.model import PolarModel

Q, DT = 5, 0.2


def machine(kind, stored, control, input_covariance, walk=0.0):
    """Return the steps of a filter with every landmark seen before."""
    steps = Machine(filter_program(kind))
    given = {"stored": stored, "dt": DT, "control": control, "input_covariance": input_covariance}
    for name, value in (given | {"state_variance": walk, "active": 1.0}).items():
        steps.variables[name][...] = value
    return steps


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
        steps = machine(kind, stored, [0.0, 0.7], noise, 1e-4)
        given = steps.variables
        given["state"][:], given["covariance"][...] = x, P
        given["mask"][:], given["variance"][:], given["gate"][:] = 1.0, 0.05**2, np.inf
        for k in range(20):
            given["bearings"][:] = x[3:] - 0.14 * (k + 1)
            steps.do()
        beliefs.append(given)
    for name in ("state", "covariance"):
        np.testing.assert_allclose(beliefs[0][name], beliefs[1][name], atol=1e-12)


def test_moments_of_a_curved_step_are_nearer_the_samples_than_those_of_the_ekf():
    x, stored = start()
    x[0] = 1.0
    P = np.diag(np.r_[0.05, 0.3, 0.5, np.full(Q, 0.02)] ** 2)
    noise, control = np.diag([0.3**2, 0.5**2]), [1.0, 0.8]
    one = machine(ExtendedKalmanFilter(PolarModel(Q, guard=1e-3)), stored, control, noise)
    rng, moved = np.random.default_rng(1), []
    for _ in range(20_000):
        one.variables["state"][:] = rng.multivariate_normal(x, P)
        one.variables["control"][:] = rng.multivariate_normal(control, noise)
        one.do("predict")
        moved.append(one.variables["state"][:3].copy())
    mean, spread = np.mean(moved, axis=0), np.cov(np.transpose(moved))
    off = {}
    for kind in (UnscentedFilter, ExtendedKalmanFilter):
        steps = machine(kind(PolarModel(Q, guard=1e-3)), stored, control, noise)
        steps.variables["state"][:], steps.variables["covariance"][...] = x, P
        steps.do("predict")
        difference = steps.variables["state"][:3] - mean
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
