"""The closed loop in one step against its pieces, one after the other."""

import numpy as np
import pytest
from lab.model_by_hand import scene

from homeward.control.laws import homing
from homeward.geometry.angles import wrap
from homeward.geometry.frames import Polar, Pose, advance, bearing, from_polar
from homeward.lab.engine.batch.homing import homing_program
from homeward.lab.engine.program import BELIEF, Machine, filter_program
from homeward.lab.filters.ekf import (
    ExtendedKalmanFilter,
    ProportionalIntegralFilter,
    augmented_ekf,
)
from homeward.lab.model import PolarModel

Q, DT, SPEED = 5, 0.05, 0.125


@pytest.mark.parametrize(
    "kind",
    [
        ExtendedKalmanFilter(PolarModel(Q)),
        augmented_ekf(Q, [1]),
        ProportionalIntegralFilter(PolarModel(Q)),
    ],
    ids=["ekf", "a-ekf", "pi-ekf"],
)
def test_the_loop_is_law_truth_measurement_and_filter_in_turn(kind):
    landmarks, polar, _, stored = scene(Q, 8)
    rng = np.random.default_rng(8)
    loop = Machine(homing_program(kind, homing))
    alone = Machine(filter_program(kind))
    given, pose, n = loop.variables, from_polar(polar), kind.model.n

    given["pose"][:], given["landmarks"][...] = pose, landmarks
    given["speed"][:], given["dt"][:], given["stored"][:] = SPEED, DT, stored
    given["state"][:3] = np.add(polar, [0.02, 0.05, -0.05])
    given["state"][3 + Q :] = stored[list(kind.model.estimated)]
    given["covariance"][...] = 0.01 * np.eye(n)
    given["input_covariance"][...] = np.diag([1e-4, 1e-3])
    given["state_variance"][:] = 1e-6
    given["variance"][:], given["gate"][:], given["minimum_visible"][:] = 1e-3, 9.0, 2
    if kind.integral:
        given["proportional"][...], given["integral_gain"][...] = 1e-3 * np.eye(n), 0.1
    for name in alone.variables:
        alone.variables[name][...] = given[name]

    for _ in range(60):
        given["mask"][:] = rng.random(Q) < 0.7
        given["noise"][:] = rng.normal(size=Q) * 0.02
        given["disturbance"][:] = rng.normal(size=2) * [0.01, 0.05]

        command = homing(Polar(*given["state"][:3]), SPEED)
        pose = advance(pose, type(command)(*np.add(command, given["disturbance"])), DT)
        seen = np.array([bearing(pose, *mark) for mark in landmarks]) + given["noise"]
        alone.variables["control"][:], alone.variables["bearings"][:] = command, seen
        alone.variables["mask"][:] = given["mask"]
        alone.do()

        loop.do()
        np.testing.assert_allclose(given["control"], command, atol=1e-15)
        here = Pose(*given["pose"])
        assert np.hypot(here.x - pose.x, here.y - pose.y) < 1e-9
        assert abs(wrap(here.heading - pose.heading)) < 1e-9
        for name in BELIEF:
            np.testing.assert_allclose(given[name], alone.variables[name], atol=1e-8)
        pose = here
    assert np.linalg.norm(given["pose"][:2]) < 0.6
