"""Motions that are composed of twists of all kinds have symmetric and positive covariances."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from homeward.drives.settings import OdometryDefaults, OdometryNoise, noise_rates
from homeward.geometry.statistics import ROUNDING
from homeward.localizer.localizer import Localizer
from homeward.localizer.motion.odometry import OdometryIntegrator, ProcessNoise
from homeward.localizer.motions import DELAY, NC, TIME_CONSTANT, Motion, camera_after
from homeward.odometry.history import TwistHistory

SPEEDS = st.sampled_from([0.0, 0.0, 1e-9, 0.3, -0.2, 1.0, 5.0])
RATES = st.sampled_from([0.0, 0.0, 1e-9, 0.4, -0.7, 3.0, -6.0])
STEPS = st.sampled_from([0.0, 1e-6, 0.02, 0.1, 0.9, 3.0])
"""Intervals [s]: none, so that stamps are equal; and longer than a twist is valid."""
NOISE = st.sampled_from(
    [
        OdometryNoise(),
        OdometryNoise(speed_sigma=0.0, turn_sigma=0.0),
        OdometryNoise(speed_sigma=1e-6, turn_sigma=0.5),
    ]
)
TWISTS = st.lists(st.tuples(STEPS, SPEEDS, RATES, SPEEDS), min_size=1, max_size=12)
LAGS = st.tuples(st.sampled_from([0.0, 0.05, -0.1, 0.4]), st.sampled_from([0.0, 0.07, 0.5]))


def is_positive(motion, terms=0.0):
    """Whether a motion can be used: symmetric, variances not negative, and not indefinite."""
    covariance = motion.covariance
    assert (covariance == covariance.T).all()
    assert (covariance.diagonal() >= 0.0).all()
    size = max(terms, float(covariance.trace()))
    return np.linalg.eigvalsh(covariance)[0] >= -ROUNDING * size


@settings(max_examples=300, deadline=None)
@given(TWISTS, LAGS, NOISE)
def test_motions_of_any_twists_have_positive_covariances(twists, lags, noise):
    history, calibration, t = TwistHistory(), np.zeros(NC), 0.0
    calibration[[DELAY, TIME_CONSTANT]] = lags
    integrator = OdometryIntegrator(history, ProcessNoise(noise, OdometryDefaults()))
    integrator.restart(0.0)
    total, mount = Motion.identity(), np.array([0.3, -0.1, 1.0])
    for step, v, omega, vy in twists:
        t += step
        history.add(t, v, omega, vy=vy)
        motion = integrator.advance(t, calibration)
        assert is_positive(motion)
        assert is_positive(integrator.motion(t + 0.3, calibration))
        assert is_positive(camera_after(motion, mount, calibration))
        total = total.compose(motion)
        there_and_back = motion.compose(motion.inverse())
        assert is_positive(there_and_back)
        assert is_positive(total.compose(there_and_back))
    assert is_positive(total)


def test_a_dropout_that_begins_by_rounding_before_the_validity_ends_has_no_negative_variance():
    calibration = np.zeros(NC)
    for k in range(200):
        history, begin = TwistHistory(), 1.7e9 + 0.0137 * k
        history.add(begin, 0.3, 0.2)
        integrator = OdometryIntegrator(history, ProcessNoise(OdometryNoise(), OdometryDefaults()))
        integrator.restart(begin)
        validity = history.before(begin).until - begin
        for more in (1e-7, 3e-7, 1e-6):
            assert is_positive(integrator.motion(begin + validity + more, calibration))


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.floats(-20.0, 20.0), st.floats(-3.2, 3.2)), min_size=1, max_size=8))
def test_a_turn_about_a_far_point_and_back_leaves_no_negative_variance(levers):
    turn = Motion(np.zeros(3), np.diag([0.0, 0.0, 1e-4]), np.zeros((3, NC)))
    for shift, heading in levers:
        out = Motion(np.array([shift, 0.0, heading]), np.zeros((3, 3)), np.zeros((3, NC)))
        turn = turn.compose(out).compose(out.inverse())
        assert is_positive(turn)
    assert turn.covariance[2, 2] == pytest.approx(1e-4)


@settings(max_examples=12, deadline=None)
@given(
    st.lists(st.tuples(SPEEDS, RATES), min_size=3, max_size=12),
    st.sampled_from([0.0, 0.1, 0.35]),
    NOISE,
)
def test_a_localiser_that_estimates_a_time_constant_survives_any_drive(phases, constant, noise):
    rates = noise_rates(noise, OdometryDefaults())
    assert np.isfinite(rates).all()
    marks = {f"L{k}": (4.0 * math.cos(k), 4.0 * math.sin(k)) for k in range(6)}
    home = {name: math.atan2(y, x) for name, (x, y) in marks.items()}
    settings = {"time_constant_sigma": constant, "keyframe_interval": 0.2}
    localizer = Localizer(home, settings=settings, odometry=noise)
    t, x, y, heading = 0.0, 0.0, 0.0, 0.0
    for v, omega in phases:
        for _ in range(6):
            localizer.odometry(t, v, omega)
            localizer.odometry(t, v, omega)  # a stamp twice
            seen = {n: math.atan2(b - y, a - x) - heading for n, (a, b) in marks.items()}
            localizer.bearings(t, seen)
            t += 0.1
            heading += 0.1 * omega
            x, y = x + 0.1 * v * math.cos(heading), y + 0.1 * v * math.sin(heading)
    assert localizer.estimate(t).t == t
