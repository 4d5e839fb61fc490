"""Each filter's symbolic steps against the NumPy oracle, over whole runs."""

import numpy as np
import pytest
from lab.model_by_hand import scene
from numpy_oracle import Oracle

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, from_polar
from homeward.lab.engine.estimators.runner import filter_kernels
from homeward.lab.engine.program.stages import (
    BELIEF,
    GenericPredict,
    GenericUpdate,
    Interpreter,
    UnscentedPredict,
)
from homeward.lab.filters.ekf import (
    ExtendedKalmanFilter,
    ProportionalIntegralFilter,
    SchmidtFilter,
    UnscentedFilter,
    augmented_ekf,
    predict_function,
    update_function,
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
    """A robot on a weaving path some way off home; what it commands and what it sees."""
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


def run(kind, predict, update, q, steps, seed, gate, minimum):
    x, P, stored = start(kind, q, seed)
    n = kind.model.n
    oracle = Oracle(kind.model, stored, x.copy(), P.copy(), method=kind.integration)
    belief = {"state": x, "covariance": P, "active": np.zeros(q)}
    belief["integral"] = np.zeros(n if kind.integral else 0)
    Q, walk = np.diag([0.01**2, 0.02**2]), np.zeros(n)
    walk[3 + q :] = 1e-7
    r = np.random.default_rng(seed).uniform(0.02, 0.04, q) ** 2
    if kind.integral:
        # A Pi and an M with structure of their own: nothing may lean on their being diagonal.
        rng = np.random.default_rng(seed + 1)
        oracle.Pi = 1e-3 * (np.eye(n) + 0.1 * rng.normal(size=(n, n)))
        oracle.M = 1e-3 * rng.normal(size=(n, q))
        predict.inputs["proportional"][...] = oracle.Pi
        update.inputs["integral_gain"][...] = oracle.M
    worst = 0.0
    for u, y, mask in drive(q, steps, seed):
        oracle.predict(u, DT, Q, walk)
        oracle.update(y, mask, r, gate, minimum)
        given = predict.inputs
        for name in BELIEF:
            given[name][...] = belief[name]
        given["control"][:], given["dt"][:], given["stored"][:] = u, DT, stored
        given["input_covariance"][...], given["state_variance"][:] = Q, walk
        predict()
        given = update.inputs
        for name in BELIEF:
            given[name][...] = predict.outputs[name]
        given["bearings"][:], given["mask"][:], given["variance"][:] = y * mask, mask, r
        given["gate"][:], given["minimum_visible"][:] = gate, minimum
        update()
        belief = {name: update.outputs[name].copy() for name in BELIEF}
        worst = max(
            worst,
            np.abs(belief["state"] - oracle.x).max(),
            np.abs(belief["covariance"] - oracle.P).max(),
        )
        assert np.array_equal(belief["covariance"], belief["covariance"].T)
        assert np.array_equal(belief["active"], oracle.active)
    assert np.linalg.norm(belief["state"][:3]) < 100
    return worst


@pytest.mark.parametrize("name", kinds(3))
@pytest.mark.parametrize(("q", "seed"), [(7, 1), (20, 2)])
def test_steps_agree_with_the_oracle(name, q, seed):
    kind = kinds(q)[name]
    kernels = Interpreter(predict_function(kind)), Interpreter(update_function(kind))
    assert run(kind, *kernels, q, 2400, seed, np.inf, 1) < 1e-9


@pytest.mark.parametrize("name", kinds(3))
def test_steps_with_gate_and_minimum_agree_with_the_oracle(name):
    kind = kinds(7)[name]
    kernels = Interpreter(predict_function(kind)), Interpreter(update_function(kind))
    assert run(kind, *kernels, 7, 1000, 3, 3.0, 3) < 1e-9


@pytest.mark.parametrize("name", kinds(3))
def test_generic_kernels_agree_with_the_oracle(name):
    kind = kinds(7)[name]
    assert run(kind, GenericPredict(kind), GenericUpdate(kind), 7, 600, 4, 6.0, 2) < 1e-9


@pytest.mark.parametrize(
    "kind", [UnscentedFilter(PolarModel(7)), SchmidtFilter(PolarModel(7, (1, 4)))]
)
def test_generic_kernels_of_the_peers_agree_with_their_symbolic_steps(kind):
    generic = GenericPredict if isinstance(kind, SchmidtFilter) else UnscentedPredict
    pairs = [
        (Interpreter(predict_function(kind)), generic(kind)),
        (Interpreter(update_function(kind)), GenericUpdate(kind)),
    ]
    x, P, stored = start(kind, 7, 5)
    belief = {"state": x, "covariance": P, "active": np.zeros(7), "integral": np.zeros(0)}
    for u, y, mask in drive(7, 300, 5):
        given = {"control": u, "dt": DT, "stored": stored, "state_variance": 1e-6}
        given |= {"input_covariance": np.diag([0.01**2, 0.02**2]), "bearings": y, "mask": mask}
        given |= {"variance": 1e-3, "gate": 9.0, "minimum_visible": 1.0}
        for kernels in pairs:
            for kernel in kernels:
                for name in kernel.inputs.keys() & (given | belief).keys():
                    kernel.inputs[name][...] = (given | belief)[name]
                kernel()
            for name, found in kernels[0].outputs.items():
                np.testing.assert_allclose(kernels[1].outputs[name], found, atol=1e-9)
            belief = {name: kernels[0].outputs[name].copy() for name in BELIEF}


@pytest.mark.parametrize(
    "kind", [UnscentedFilter(PolarModel(60)), SchmidtFilter(PolarModel(60, (1, 4)))]
)
def test_peers_with_many_landmarks_run_by_the_generic_kernels(kind):
    """Unrolled, their steps would take minutes to build, and with hundreds all memory."""
    kernels = filter_kernels(kind)
    assert isinstance(kernels.predict, (GenericPredict, UnscentedPredict))
    assert isinstance(kernels.update, GenericUpdate)


def test_augmented_filter_refuses_parameters_that_are_no_landmarks():
    for wrong in ([7], [-1], [1, 1]):
        with pytest.raises(ValueError, match="distinct landmarks"):
            augmented_ekf(7, wrong)
