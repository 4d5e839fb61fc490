"""The consider filter against the joint filter with a gain of zero, in full matrices."""

import numpy as np
from lab.model_by_hand import scene
from test_steps import DT, drive

from homeward.lab.engine.program import BELIEF, Machine, filter_program
from homeward.lab.filters.ekf import ExtendedKalmanFilter, SchmidtFilter
from homeward.lab.model import PolarModel

Q = 5


def run(kind, sigma, steps=200, each=None):
    """Drive with all landmarks in sight, and call `each(before, after, variance)` at updates."""
    _, polar, _, stored = scene(Q, 4)
    parameters = len(kind.model.estimated)
    steps_of, variance = Machine(filter_program(kind)), 0.03**2
    given = {"state": np.r_[polar, np.zeros(Q), stored[list(kind.model.estimated)]]}
    given["covariance"] = np.diag(
        np.r_[0.05, 0.1, 0.1, np.ones(Q), np.full(parameters, sigma)] ** 2
    )
    given |= {"stored": stored, "dt": DT, "input_covariance": np.diag([0.01**2, 0.02**2])}
    given |= {"gate": np.inf, "minimum_visible": 1, "variance": variance, "mask": 1.0}
    belief = steps_of.variables
    for name, value in given.items():
        belief[name][...] = value
    for u, y, _ in drive(Q, steps, 4):
        belief["control"][:], belief["bearings"][:] = u, y
        steps_of.do("predict")
        before = {name: belief[name].copy() for name in BELIEF}
        steps_of.do("update")
        if each is not None and before["active"].all():
            each(before, belief, variance)
    return belief


def test_each_update_is_the_joint_filter_with_a_gain_of_zero_for_what_is_considered():
    kind = SchmidtFilter(PolarModel(Q, (0, 2, 3)))
    n, kept = kind.model.n, 3 + Q

    def compare(before, after, variance):
        P, H = before["covariance"], np.zeros((Q, n))
        H[:, 3:kept] = np.eye(Q)
        gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + variance * np.eye(Q))
        gain[kept:] = 0.0
        left = np.eye(n) - gain @ H
        joint = left @ P @ left.T + variance * gain @ gain.T
        np.testing.assert_allclose(after["covariance"], joint, atol=1e-10)
        assert np.array_equal(after["state"][kept:], before["state"][kept:])
        compared.append(True)

    compared = []
    run(kind, 0.2, each=compare)
    assert len(compared) > 100


def test_without_doubt_it_is_the_ekf_and_with_doubt_it_is_less_sure():
    model = PolarModel(Q, tuple(range(Q)))
    believing = run(ExtendedKalmanFilter(PolarModel(Q)), 0.0)
    found = {sigma: run(SchmidtFilter(model), sigma) for sigma in (0.0, 0.1, 0.3)}
    kept = slice(0, 3 + Q)
    np.testing.assert_allclose(found[0.0]["state"][kept], believing["state"], atol=1e-9)
    np.testing.assert_allclose(
        found[0.0]["covariance"][kept, kept], believing["covariance"], atol=1e-9
    )
    spread = [np.linalg.det(f["covariance"][:3, :3]) for f in found.values()]
    assert spread[0] < spread[1] < spread[2]
