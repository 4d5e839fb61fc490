"""Each filter's symbolic steps against the NumPy oracle, over whole runs."""

import numpy as np
import pytest
from lab.model_by_hand import scene
from numpy_oracle import Oracle

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, from_polar
from homeward.lab.engine.estimators.runner import filter_machine
from homeward.lab.engine.program import BELIEF, Machine, Program
from homeward.lab.filters.ekf import (
    ExtendedKalmanFilter,
    ProportionalIntegralFilter,
    SchmidtFilter,
    UnscentedFilter,
    augmented_ekf,
    steps,
)
from homeward.lab.model import PolarModel

DT = 0.05


def kinds(q):
    return {
        "ekf": ExtendedKalmanFilter(PolarModel(q)),
        "ekf, euler": ExtendedKalmanFilter(PolarModel(q), "euler"),
        "a-ekf, one": augmented_ekf(q, [2]),
        "a-ekf, all": augmented_ekf(q),
        "pi-ekf": ProportionalIntegralFilter(PolarModel(q)),
    }


def drive(q, steps, seed):
    """Yield commands, bearings and masks of a robot on a weaving path near home."""
    landmarks, polar, _, stored = scene(q, seed)
    rng = np.random.default_rng(seed)
    pose = np.array(from_polar(polar))
    for k in range(steps):
        u = np.array([0.125, 0.6 + 0.3 * np.sin(0.05 * k)])
        pose = pose + DT * np.array([u[0] * np.cos(pose[2]), u[0] * np.sin(pose[2]), u[1]])
        y = np.array([bearing(Pose(*pose), *mark) for mark in landmarks])
        y = wrap(y + rng.normal(size=q) * 0.02)
        yield u, y, (rng.random(q) < 0.6).astype(float)
    assert stored.size == q


def start(kind, q, seed):
    _, polar, _, stored = scene(q, seed)
    n = kind.model.n
    x = np.zeros(n)
    x[:3] = np.add(polar, [0.03, -0.05, 0.04])
    x[3 + q :] = stored[list(kind.model.estimated)]
    P = np.diag(np.r_[0.05**2, 0.1**2, 0.1**2, np.ones(q), np.full(n - 3 - q, 0.05**2)])
    return x, P, stored


def machine(kind, max_unrolled=None):
    return Machine(Program(steps(kind, max_unrolled)))


def run(kind, steps_of, q, steps, seed, gate, minimum):
    """Return the largest difference between a machine and the oracle over a run."""
    x, P, stored = start(kind, q, seed)
    n, given = kind.model.n, steps_of.variables
    oracle = Oracle(kind.model, stored, x.copy(), P.copy(), method=kind.integration)
    Q, walk = np.diag([0.01**2, 0.02**2]), np.zeros(n)
    walk[3 + q :] = 1e-7
    r = np.random.default_rng(seed).uniform(0.02, 0.04, q) ** 2
    if kind.integral:
        # A Pi and an M with structure of their own: nothing may lean on their being diagonal.
        rng = np.random.default_rng(seed + 1)
        oracle.Pi = 1e-3 * (np.eye(n) + 0.1 * rng.normal(size=(n, n)))
        oracle.M = 1e-3 * rng.normal(size=(n, q))
        given["proportional"][...], given["integral_gain"][...] = oracle.Pi, oracle.M
    constant = {"state": x, "covariance": P, "active": 0, "integral": 0, "dt": DT, "stored": stored}
    constant |= {"input_covariance": Q, "state_variance": walk, "variance": r}
    constant |= {"gate": gate, "minimum_visible": minimum}
    for name, value in constant.items():
        given[name][...] = value
    worst = 0.0
    for u, y, mask in drive(q, steps, seed):
        oracle.predict(u, DT, Q, walk)
        oracle.update(y, mask, r, gate, minimum)
        given["control"][:], given["bearings"][:], given["mask"][:] = u, y * mask, mask
        steps_of.do("predict")
        steps_of.do("update")
        worst = max(
            worst,
            np.abs(given["state"] - oracle.x).max(),
            np.abs(given["covariance"] - oracle.P).max(),
        )
        assert np.array_equal(given["covariance"], given["covariance"].T)
        assert np.array_equal(given["active"], oracle.active)
    assert np.linalg.norm(given["state"][:3]) < 100
    return worst


@pytest.mark.parametrize("name", kinds(3))
@pytest.mark.parametrize(("q", "steps", "seed"), [(7, 2400, 1), (20, 400, 2)])
def test_steps_agree_with_the_oracle(name, q, steps, seed):
    kind = kinds(q)[name]
    assert run(kind, machine(kind), q, steps, seed, np.inf, 1) < 1e-9


@pytest.mark.parametrize("max_unrolled", [0, 20])
@pytest.mark.parametrize("name", kinds(3))
def test_steps_with_gate_and_minimum_agree_with_the_oracle(name, max_unrolled):
    kind = kinds(7)[name]
    assert run(kind, machine(kind, max_unrolled), 7, 500, 3, 3.0, 3) < 1e-9


@pytest.mark.parametrize(
    "kind", [UnscentedFilter(PolarModel(7)), SchmidtFilter(PolarModel(7, (1, 4)))]
)
def test_steps_of_the_peers_with_loops_agree_with_unrolled_ones(kind):
    unrolled, loops = machine(kind), machine(kind, 0)
    x, P, stored = start(kind, 7, 5)
    given = {"state": x, "covariance": P, "dt": DT, "stored": stored, "state_variance": 1e-6}
    given |= {"input_covariance": np.diag([0.01**2, 0.02**2])}
    given |= {"variance": 1e-3, "gate": 9.0, "minimum_visible": 1.0}
    for u, y, mask in drive(7, 300, 5):
        given |= {"control": u, "bearings": y, "mask": mask}
        for made in (unrolled, loops):
            for name, value in given.items():
                made.variables[name][...] = value
            made.do()
        for name, found in unrolled.variables.items():
            np.testing.assert_allclose(loops.variables[name], found, atol=1e-9)
        given = {name: unrolled.variables[name].copy() for name in BELIEF}


@pytest.mark.parametrize(
    "kind", [UnscentedFilter(PolarModel(60)), SchmidtFilter(PolarModel(60, (1, 4)))]
)
def test_filters_with_many_landmarks_run_with_loops_and_say_why_not_compiled(kind):
    """Unrolled, their steps would take minutes to build, and with hundreds all memory."""
    made = filter_machine(kind, "native")
    made.do()
    assert made.engine == "interpreter"
    assert "too many landmarks" in made.notes[0]


def test_augmented_filter_refuses_parameters_that_are_no_landmarks():
    for wrong in ([7], [-1], [1, 1]):
        with pytest.raises(ValueError, match="distinct landmarks"):
            augmented_ekf(7, wrong)
