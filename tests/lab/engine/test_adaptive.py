"""The adaptive EKF: noise that is known in simulation is found from the innovations."""

import numpy as np
import pytest
from lab.model_by_hand import scene

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing, from_polar
from homeward.lab.engine.estimators.adaptive import AdaptiveRunner, log_likelihood
from homeward.lab.engine.estimators.runner import FilterRunner, Tuning
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.model import PolarModel

Q, DT = 7, 0.1
BEARING, SPEED, TURN = 0.02, 0.02, 0.05


def tuning(polar, stored, bearing=BEARING, speed=SPEED, turn=TURN, walk=0.01):
    sigmas, empty = np.full(3, 0.01), np.zeros((0, 0))
    density = np.r_[np.zeros(3), np.full(Q, walk**2)]
    setup = polar, sigmas, stored, bearing, np.square([speed, turn]), 11.0, 1
    return Tuning(*setup, np.r_[sigmas**2, np.ones(Q)], density, empty, empty)


def drive(backend, seconds, seed=1):
    landmarks, polar, _, _ = scene(Q, seed)
    rng, pose = np.random.default_rng(seed), np.array(from_polar(polar))
    belief = backend.start()
    for k in range(round(seconds / DT)):
        twist = np.array([0.15, 0.5 + 0.4 * np.sin(0.3 * k * DT)])
        true = twist + rng.normal(size=2) * [SPEED, TURN] / np.sqrt(DT)
        pose = pose + DT * np.array([true[0] * np.cos(pose[2]), true[0] * np.sin(pose[2]), true[1]])
        belief = backend.predict(belief, DT, tuple(twist))
        y = np.array([bearing(Pose(*pose), *mark) for mark in landmarks])
        y = wrap(y + rng.normal(size=Q) * BEARING)
        belief, out = backend.update(belief, dict(enumerate(y.tolist())), {})
    return belief, pose, out


@pytest.mark.parametrize("wrong", [(4.0, 1.0), (0.25, 1.0), (1.0, 4.0), (2.0, 0.3)])
def test_noise_of_bearings_and_turn_rate_is_found(wrong):
    _, polar, _, stored = scene(Q, 1)
    assumed = tuning(polar, stored, BEARING * wrong[0], turn=TURN * wrong[1])
    backend = AdaptiveRunner(ExtendedKalmanFilter(PolarModel(Q)), assumed)
    drive(backend, 20.0)
    found = np.exp(backend.factors) * [wrong[0], 1.0, wrong[1], 1.0]
    assert found[0] == pytest.approx(1.0, abs=0.2)
    assert 0.6 < found[2] < 1.7


def test_the_likelihood_is_that_of_a_gaussian_in_all_landmarks():
    _, polar, beta, stored = scene(Q, 1)
    assumed = tuning(polar, stored)
    runner = FilterRunner(ExtendedKalmanFilter(PolarModel(Q)), assumed)
    belief = runner.start()
    root = np.random.default_rng(0).normal(size=(3 + Q, 3 + Q)) * 0.02
    belief.covariance[...], belief.active[:] = root @ root.T, 1.0
    belief.state[3:] = beta
    e = np.array([0.01, -0.03, 0.02])
    S = belief.covariance[3:6, 3:6] + BEARING**2 * np.eye(3)
    density = np.exp(-0.5 * e @ np.linalg.inv(S) @ e) / np.sqrt(np.linalg.det(S))
    seen = {i: float(beta[i] + e[i]) for i in range(3)}
    assert log_likelihood(belief, seen, {}, assumed) == pytest.approx(np.log(density))
    # A wrong sighting costs no more than one at the edge of the gate, however wrong it is.
    far = [log_likelihood(belief, {0: float(beta[0] + d)}, {}, assumed) for d in (1.0, 2.0)]
    assert far[0] == far[1]


def test_before_the_first_identification_it_is_the_ekf():
    _, polar, _, stored = scene(Q, 1)
    assumed = tuning(polar, stored, bearing=0.05)
    kind = ExtendedKalmanFilter(PolarModel(Q))
    adaptive, _, _ = drive(AdaptiveRunner(kind, assumed), 3.0)
    plain, _, _ = drive(FilterRunner(kind, assumed), 3.0)
    assert np.array_equal(adaptive.memory, plain.memory)
