import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from homeward.geometry.angles import guarded_inverse, interpolate, wrap

ANGLES = st.floats(-1e4, 1e4)


@given(ANGLES)
def test_wrap_is_in_the_half_open_interval_and_the_same_angle(angle):
    wrapped = float(wrap(angle))
    assert -math.pi - 1e-11 < wrapped <= math.pi + 1e-11
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)


@given(st.floats(-math.pi, math.pi, exclude_min=True))
def test_wrap_leaves_wrapped_angles_alone(angle):
    # Within one spacing of the numbers near pi: next to -pi, -pi itself is one away.
    assert abs(wrap(angle) - angle) == 0 or abs(angle + math.pi) < 1e-15


def test_wrap_maps_minus_pi_to_pi():
    assert wrap(-math.pi) == math.pi
    assert wrap(math.pi) == math.pi


@given(ANGLES)
def test_wrap_is_the_same_on_floats_arrays_and_symbols(angle):
    x = ca.SX.sym("x")
    symbolic = float(ca.Function("f", [x], [wrap(x)])(angle))
    assert symbolic == float(wrap(angle)) == wrap(np.array([angle]))[0]


@given(st.floats(1e-3, 1e3), st.floats(1e-6, 1e-1))
def test_guarded_inverse_has_the_stated_bias(x, guard):
    bias = guarded_inverse(x, guard) * x - 1
    assert math.isclose(bias, -(guard**2) / (x**2 + guard**2), rel_tol=1e-6, abs_tol=1e-12)


def test_guarded_inverse_is_zero_at_zero():
    assert guarded_inverse(0.0, 0.01) == 0.0


def test_interpolate_goes_the_short_way_round():
    found = interpolate([0.5], np.array([0.0, 1.0]), np.array([3.1, -3.1]))
    assert abs(found[0]) == pytest.approx(math.pi, abs=1e-12)
