"""Motions of holonomic robots, which also drive to their left or right."""

import math

import numpy as np
import pytest
from rig import Wheels

from homeward import core
from homeward.drives.settings import OdometryNoise
from homeward.localizer import kernels
from homeward.localizer.motions import (
    DELAY,
    NC,
    SIDEWAYS_SCALE,
    SPEED_SCALE,
    TIME_CONSTANT,
    TURN_SCALE,
    TURN_SLIP,
)

KERNELS = [
    pytest.param(
        core.compiled,
        marks=pytest.mark.skipif(core.compiled is None, reason=f"NumPy only: {core.missing}"),
    ),
    None,
]
NOTHING = np.zeros(NC)
OTHERS = [i for i in range(NC) if i not in (TURN_SLIP, SIDEWAYS_SCALE)]
"""Unknowns of the calibration but those that act on one axis of the robot alone."""


@pytest.fixture(params=KERNELS, ids=["compiled", "numpy"], autouse=True)
def _kernel(request, monkeypatch):
    monkeypatch.setattr(core, "compiled", request.param)


def driven(direction, calibration):
    """Motion of a robot that drives along a direction [rad] off its axis.

    First its twists are slow, and so valid for long; then they are frequent, with a dropout.
    """
    wheels, rng = Wheels(), np.random.default_rng(5)
    wheels.restart(0.0)
    for t in np.r_[0.0:14.0:2.0, 14.0:16.0:0.05, 19.0:20.0:0.05]:
        speed, omega = 0.3 + 0.2 * math.sin(2.0 * t) + 0.05 * rng.normal(), 0.8 * math.cos(t)
        v, vy = speed * math.cos(direction), speed * math.sin(direction)
        wheels.add(float(t), v, omega, vy)
    wheels.advance(1.0, calibration)
    return wheels.motion(20.5, calibration)


@pytest.mark.parametrize("direction", [0.5 * math.pi, -0.7, math.pi])
@pytest.mark.parametrize("time_constant", [0.0, 0.2])
def test_a_motion_off_the_axis_is_that_along_it_but_for_a_rotation(direction, time_constant):
    calibration = np.zeros(NC)
    calibration[[TURN_SCALE, DELAY, TIME_CONSTANT, SPEED_SCALE]] = 0.03, 0.1, time_constant, -0.02
    ahead, found = driven(0.0, calibration), driven(direction, calibration)
    c, s = math.cos(direction), math.sin(direction)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert found.delta == pytest.approx(rotation @ ahead.delta, abs=1e-12)
    assert found.covariance == pytest.approx(rotation @ ahead.covariance @ rotation.T, rel=1e-9)
    expected = rotation @ ahead.jacobian[:, OTHERS]
    assert found.jacobian[:, OTHERS] == pytest.approx(expected, abs=1e-12)
    assert (found.path, found.turned) == pytest.approx((ahead.path, ahead.turned))


@pytest.mark.parametrize("time_constant", [0.0, 0.2])
@pytest.mark.parametrize("scale", [0.0, -0.15])
def test_the_derivative_by_the_sideways_scale_is_that_of_differences(time_constant, scale):
    calibration = np.full(NC, 0.02)
    calibration[[DELAY, TIME_CONSTANT, SIDEWAYS_SCALE]] = 0.1, time_constant, scale
    step = 1e-5 * np.eye(NC)[SIDEWAYS_SCALE]
    after, before = (driven(0.9, calibration + way * step).delta for way in (1.0, -1.0))
    found = driven(0.9, calibration).jacobian[:, SIDEWAYS_SCALE]
    assert found == pytest.approx((after - before) / 2e-5, abs=1e-7)


@pytest.mark.parametrize("speed", [0.0, 0.5])
def test_jitter_to_and_fro_does_not_open_the_sideways_scale(speed):
    wheels = Wheels()
    wheels.restart(0.0)
    for k in range(60):
        wheels.add(k / 50, speed, 0.3, 0.1 * math.sin(0.25 * k))
    assert not wheels.motion(1.15, NOTHING).jacobian[:, SIDEWAYS_SCALE].any()


def test_sideways_noise_is_along_the_axis_of_the_robot():
    noise = OdometryNoise(speed_sigma=0.02, sideways_sigma=0.06, turn_sigma=0.0)
    ahead, side, both = (Wheels(noise) for _ in range(3))
    for wheels, twist in ((ahead, (0.5, 0.0)), (side, (0.0, 0.5)), (both, (0.3, 0.3))):
        wheels.restart(0.0)
        wheels.add(0.0, twist[0], 0.0, twist[1])
    found = [w.motion(0.4, NOTHING).covariance[:2, :2] for w in (ahead, side, both)]
    for covariance in found:  # in the robot's axes, in whatever direction it drives
        assert covariance == pytest.approx(np.diag([0.4 * 0.02**2, 0.4 * 0.06**2]))


def test_a_square_without_turning_ends_where_it_began():
    wheels = Wheels()
    wheels.restart(0.0)
    for k, (v, vy) in enumerate([(0.5, 0.0), (0.0, 0.5), (-0.5, 0.0), (0.0, -0.5), (0.0, 0.0)]):
        wheels.add(0.4 * k, v, 0.0, vy)
    assert wheels.motion(0.6, NOTHING).delta == pytest.approx([0.2, 0.1, 0.0])
    square = wheels.motion(2.0, NOTHING)
    assert square.delta == pytest.approx(np.zeros(3), abs=1e-12)
    assert square.path == pytest.approx(0.8)
    assert not square.jacobian[:, TURN_SLIP].any()


def test_half_a_circle_about_a_point_that_the_robot_faces():
    wheels = Wheels()
    wheels.restart(0.0)
    for k in range(21):
        wheels.add(k / 20 * math.pi, 0.0, -1.0, 2.0)
    motion = wheels.motion(math.pi, NOTHING)
    assert motion.delta == pytest.approx([4.0, 0.0, -math.pi])
    assert motion.covariance[0, 0] > 0.0


def test_noise_is_larger_along_the_motion_than_across():
    wheels = Wheels()
    wheels.restart(0.0)
    wheels.add(0.0, 0.0, 0.0, 0.5)
    across, along = wheels.motion(0.4, NOTHING).covariance.diagonal()[:2]
    assert along > 5.0 * across > 0.0


def test_time_of_sideways_motion_is_time_in_motion():
    wheels = Wheels()
    wheels.add(0.0, 0.0, 0.0, 0.5)
    wheels.add(0.3, 0.0, 0.0)
    inputs = wheels.twists.table, 0.0, 0.5, NOTHING, np.zeros((3, 3)), (0.2, 0.2), 0.0
    motion, by_bend, moving = kernels.preintegrate(*inputs)
    assert (motion.path, moving) == pytest.approx((0.15, 0.3))
    assert not by_bend.any()
