"""Compiled operations and steps against the interpreter and the oracle."""

import platform

import casadi as ca
import numpy as np
import pytest
from native_rig import COMPILER
from test_steps import kinds, run

from homeward.lab.engine.batch.execution import execute
from homeward.lab.engine.batch.job import Job, given_values
from homeward.lab.engine.native import library
from homeward.lab.engine.native.source import NativeProgram, source_of
from homeward.lab.engine.program import OBSERVE, Program, filter_program

Q = 3


@pytest.mark.parametrize("name", ["ekf", "a-ekf, one", "pi-ekf"])
def test_compiled_steps_agree_with_the_oracle(name):
    kind = kinds(Q)[name]
    native = NativeProgram(filter_program(kind))
    assert run(kind, native, Q, 600, 1, np.inf, 1) < 1e-9
    assert run(kind, native, Q, 600, 4, 6.0, 2) < 1e-9


def every_operation():
    """A function with every operation that can be emitted, and numbers that try them."""
    x, y = ca.SX.sym("x", 9), ca.SX.sym("y", 9)
    forms = [
        *(f(x) for f in (ca.sin, ca.cos, ca.sqrt, ca.fabs, ca.ceil, ca.floor)),
        *(f(x, y) for f in (ca.atan2, ca.hypot)),
        *(x + y, x - y, x * y, x / y, -x, x**2, 2 * x, 1 / y),
        *(x < y, x <= y, x == y, x != y, ca.logic_not(x), ca.logic_and(x, y), ca.logic_or(x, y)),
        *(ca.fmin(x, 0.5), ca.fmax(x, 0.5), ca.if_else(x > 0, y, x)),
    ]
    f = ca.Function("f", [x, y], [ca.densify(ca.vertcat(*forms))], ["x", "y"], ["z"])
    values = [0.0, -0.0, 1.0, -1.0, 1e-30, 3e5, -7e8, 2.5, -0.4, 1e15, -1e30, np.pi, 0.25]
    rows = [(np.roll(values, 5 * k)[:9], np.roll(values, 3 * k)[:9]) for k in range(13)]
    return f, [(*row, np.array(f(*row)).ravel()) for row in rows]


def test_every_operation_is_the_interpreters():
    f, rows = every_operation()
    native = NativeProgram(Program({"part": f}))
    for x, y, z in rows:
        native.variables["x"][:], native.variables["y"][:] = x, y
        native.do("part")
        assert np.allclose(native.variables["z"], z, rtol=1e-14, atol=1e-15, equal_nan=True)


WIDTHS = {"own": [], "four": ["-mno-avx512f"], "two": ["-mno-avx"]}
"""Lanes by what keeps this machine's compiler from using more; two are NEON's, too."""


@pytest.mark.parametrize("width", WIDTHS)
def test_every_operation_in_lanes_is_the_interpreters(width, monkeypatch):
    if WIDTHS[width] and platform.machine() != "x86_64":
        pytest.skip("only x86 has vectors of several widths")
    monkeypatch.setenv("CC", " ".join([COMPILER.command[0], *WIDTHS[width]]))
    f, rows = every_operation()
    program, count = Program({OBSERVE: f}), len(rows)
    start = {
        k: given_values(k, np.array([r[i] for r in rows]), (9,), count) for i, k in enumerate("xy")
    }
    job = Job(program, count, 0, start, series={}, final=("z",), history=(), guarded=())
    z = execute(job, "native", 1).final["z"]
    assert np.allclose(z, [r[2] for r in rows], rtol=1e-14, atol=1e-15, equal_nan=True)
    lanes = library.load(source_of(program, False).text).lanes
    assert lanes == {"four": 4, "two": 2}.get(width, lanes)


def test_circular_functions_are_right_to_the_last_digits():
    x = ca.SX.sym("x", 200)
    f = ca.Function("f", [x], [ca.sin(x), ca.cos(x)], ["x"], ["s", "c"])
    native = NativeProgram(Program({"part": f}))
    rng = np.random.default_rng(0)
    for scale in (1e-8, 1.0, 10.0, 1e4, 9e5, 1e7, 1e15):
        native.variables["x"][:] = angles = rng.uniform(-scale, scale, 200)
        native.do("part")
        assert np.allclose(native.variables["s"], np.sin(angles), rtol=4e-16, atol=2e-16)
        assert np.allclose(native.variables["c"], np.cos(angles), rtol=4e-16, atol=2e-16)


def test_an_unknown_operation_is_refused():
    x = ca.SX.sym("x")
    odd = Program({"part": ca.Function("f", [x], [ca.erf(x)], ["x"], ["y"])})
    with pytest.raises(NotImplementedError, match="operation"):
        source_of(odd, single=True)
