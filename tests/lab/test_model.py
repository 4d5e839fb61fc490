"""The model against its geometry, and every Jacobian against complex steps."""

import casadi as ca
import numpy as np
import pytest
from lab.model_by_hand import complex_jacobian, rates, rk4, scene

from homeward.geometry.angles import guarded_inverse, wrap
from homeward.geometry.frames import Pose, bearing, from_polar
from homeward.lab.filters.ekf import augmented_ekf
from homeward.lab.model import (
    PolarModel,
    discretise,
    landmark_distance,
    true_bearings,
    unicycle_rates,
)


@pytest.mark.parametrize("estimated", [(), (1,), (0, 2, 3)])
@pytest.mark.parametrize("method", ["rk4", "euler"])
def test_step_and_its_jacobians(estimated, method):
    q = 4
    model = PolarModel(q, estimated)
    _, polar, beta, stored = scene(q, 5)
    state = np.concatenate([polar, beta, stored[list(estimated)] + 0.1])
    control, active, dt = np.array([0.125, 0.6]), np.array([1.0, 1, 0, 1]), 0.05

    x, u, h = ca.SX.sym("x", model.n), ca.SX.sym("u", 2), ca.SX.sym("h")
    b, a = ca.SX.sym("b", q), ca.SX.sym("a", q)
    step = discretise(lambda s, c: model.rates(s, c, b, a), x, u, h, method)
    F, G, Gu = (
        np.array(m)
        for m in ca.Function("f", [x, u, h, b, a], list(step))(state, control, dt, stored, active)
    )

    def f(s, c):
        return rates(model, s, c, stored, active)

    def advance(s, c):
        return rk4(f, s, c, dt) if method == "rk4" else s + dt * f(s, c)

    np.testing.assert_allclose(F[:, 0], advance(state, control), atol=1e-14)
    by_state = complex_jacobian(lambda s: advance(s, control), state)
    by_input = complex_jacobian(lambda c: advance(np.tile(state + 0j, (2, 1)).T, c), control)
    np.testing.assert_allclose(G, by_state, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(Gu, by_input, rtol=1e-12, atol=1e-13)


def test_polar_bearings_are_those_of_the_cartesian_truth():
    """The ODE of the paper and the geometry give the same bearings: the rates are right."""
    landmarks, polar, beta, stored = scene(7, 11)
    control, dt, steps = np.array([0.125, 0.5]), 0.01, 1000
    path = [np.array(from_polar(polar))]
    for _ in range(steps):
        path.append(
            rk4(
                lambda p, u: np.array([u[0] * np.cos(p[2]), u[0] * np.sin(p[2]), u[1]]),
                path[-1],
                control,
                dt,
            )
        )
    # The ODE is singular where landmark, home and robot come in line; geometry is not.
    theta = np.arctan2([p[1] for p in path], [p[0] for p in path])
    clear = np.abs(np.sin(stored[:, None] - theta)).min(axis=1) > 0.1
    landmarks, beta, stored = landmarks[clear], beta[clear], stored[clear]
    assert clear.sum() >= 2

    model = PolarModel(len(stored), guard=0.0)
    state = np.concatenate([polar, beta])
    for _ in range(steps):
        state = rk4(
            lambda s, u: rates(model, s, u, stored, np.ones(len(stored))), state, control, dt
        )
    here = Pose(*path[-1])
    seen = np.array([bearing(here, *mark) for mark in landmarks])
    assert state[0] == pytest.approx(np.hypot(here.x, here.y), abs=1e-8)
    np.testing.assert_allclose(wrap(state[3:] - seen), 0, atol=1e-8)
    distance = landmark_distance(state[:3], state[3:], stored)
    np.testing.assert_allclose(distance, np.hypot(*landmarks.T), rtol=1e-7)


def test_symbolic_truth_is_the_unicycle():
    pose, u, marks = ca.SX.sym("p", 3), ca.SX.sym("u", 2), ca.SX.sym("m", 2, 2)
    f = ca.Function("f", [pose, u, marks], [unicycle_rates(pose, u), true_bearings(pose, marks)])
    moved, seen = f([1.0, 2.0, 0.5], [0.3, 0.2], ca.DM([[2.0, 2.0], [0.0, 5.0]]))
    np.testing.assert_allclose(
        np.array(moved)[:, 0], [0.3 * np.cos(0.5), 0.3 * np.sin(0.5), 0.2], rtol=1e-14
    )
    expected = [-0.5, np.arctan2(3, -1) - 0.5]
    np.testing.assert_allclose(np.array(seen)[:, 0], expected, rtol=1e-14)


@pytest.mark.parametrize(
    "polar",
    [(0.0, 0.0, 0.0), (1e-300, 1.0, -2.0), (1.0, 0.5, 0.2), (-0.3, 9.0, 1e4)],
    ids=["at home", "next to home", "in line with a landmark", "R below zero"],
)
def test_rates_and_jacobians_are_finite_everywhere(polar):
    kind = augmented_ekf(2)
    model = kind.model
    x, u = ca.SX.sym("x", model.n), ca.SX.sym("u", 2)
    step = discretise(
        lambda s, c: model.rates(s, c, ca.SX([0.5, 0.5 + np.pi]), ca.SX.ones(2)), x, u, ca.SX(0.1)
    )
    state = [*polar, 0.3, 0.3, 0.5, 0.5 + np.pi]
    for matrix in ca.Function("f", [x, u], list(step))(state, [0.2, 0.1]):
        assert np.all(np.isfinite(np.array(matrix)))


def test_the_guard_has_the_effect_in_the_docstring():
    assert 1 - guarded_inverse(0.05, PolarModel.guard) * 0.05 == pytest.approx(0.04, abs=0.002)
