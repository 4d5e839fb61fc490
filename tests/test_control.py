"""The homing law on floats, arrays and symbols."""

import math

import casadi as ca
import numpy as np
import pytest

from homeward.control import homing
from homeward.frames import Polar


@pytest.mark.parametrize(
    ("theta", "alpha", "omega"),
    [
        (0.0, math.pi, 0.0),  # looks at home already
        (0.5, 0.5 - math.pi, 0.0),
        (-0.872, 0.349, math.pi - 1.221),  # the paper's start
        (0.0, math.pi - 0.2, 0.2),  # home to the left: turn left
        (0.0, math.pi + 0.2, -0.2),
        (0.0, 0.0, math.pi),  # looks away
        (3.0, -3.0, math.pi - (-6.0 + 2 * math.pi)),  # the shorter way round
    ],
)
def test_turns_by_the_error_of_its_heading(theta, alpha, omega):
    twist = homing(Polar(1.0, theta, alpha), 0.125)
    assert twist.v == 0.125
    assert twist.omega == pytest.approx(omega, abs=1e-12)


def test_is_the_same_on_arrays_and_symbols():
    rng = np.random.default_rng(0)
    theta, alpha = rng.uniform(-4, 4, (2, 50))
    each = [homing(Polar(1.0, a, b), 0.3).omega for a, b in zip(theta, alpha, strict=True)]
    on_array = homing(Polar(1.0, theta, alpha), 0.3).omega
    np.testing.assert_array_equal(on_array, each)
    polar = Polar(*(ca.SX.sym(name) for name in ("R", "theta", "alpha")))
    function = ca.Function("law", list(polar), [homing(polar, 0.3).omega])
    on_symbols = [float(function(1.0, a, b)) for a, b in zip(theta, alpha, strict=True)]
    np.testing.assert_allclose(on_symbols, each, atol=1e-14)
