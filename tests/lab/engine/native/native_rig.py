"""The machine's compiler, without which its tests are skipped, and a program to compile."""

import casadi as ca
import pytest

from homeward.lab.engine.native.compiler import NativeError, find_compiler
from homeward.lab.engine.native.source import NativeProgram
from homeward.lab.engine.program import Program

try:
    COMPILER = find_compiler()
except NativeError as error:
    pytest.skip(f"native engine: {error}", allow_module_level=True)


def toy(value=2.0):
    """A program that takes no time to compile: y = value * sin(x)."""
    x = ca.SX.sym("x")
    return Program({"part": ca.Function("f", [x], [value * ca.sin(x)], ["x"], ["y"])})


def answer(program):
    """Return y at x = 0.5."""
    native = NativeProgram(program)
    native.variables["x"][:] = 0.5
    native.do("part")
    return float(native.variables["y"][0])
