"""The innermost loops in C, where there is a compiler; NumPy does the same without, more slowly.

What is compiled is kept for next time (see `homeward.engine.native`). A function of the localiser
that has a counterpart in ``native/*.c`` asks `compiled` for it, and else goes on by itself; tests
hold the two together.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np

from homeward.engine.native.compiler import NativeError
from homeward.engine.native.library import load

SOURCES = ("shared.h", "window.c", "gaussian.c", "home.c", "verdict.c", "motion.c")
"""Of one program, in this order."""
FUNCTIONS = {
    "residuals": "i" + 6 * "a",
    "add_sightings": "iiiid" + 10 * "a",
    "add_odometry": "ii" + 10 * "a",
    "eliminate": "ii" + 6 * "a",
    "substitute": "ii" + 3 * "a",
    "move_on": "i" + 6 * "a",
    "predict": "ii" + 7 * "a",
    "correct": "ii" + 5 * "a",
    "spread_home": "s" + 3 * "a",
    "solve_home": "s" + 5 * "a" + "d" + 4 * "a",
    "fit_home": "sidd" + 13 * "a",
    "judge_home": "sdd" + 8 * "a" + "d" + 5 * "a",
    "doubt_home": "sd" + 8 * "a",
    "from_home": "ii" + 12 * "a",
    "integrate": "iaaaddddi" + 5 * "a",
}
"""What the functions take, in order: integers, doubles, arrays of doubles, a structure."""
MAY_FAIL = (
    *("add_sightings", "eliminate", "predict", "correct"),
    *("solve_home", "fit_home", "judge_home", "doubt_home"),
)
"""Those that return 0, or 1 where an index is out of range or a matrix not positive definite."""


class _Doubles:
    """An array of doubles as an argument, taken row by row."""

    @staticmethod
    def from_param(array: np.ndarray) -> Any:
        """Return what is passed to a function; the call itself keeps the array alive."""
        assert array.dtype == np.float64
        try:
            return ctypes.byref(ctypes.c_char.from_buffer(array.data))  # the quickest way
        except (TypeError, ValueError):  # read-only or empty, or not contiguous: an error
            return ctypes.c_void_p(address(array))


class _Structure:
    """A structure as an argument."""

    @staticmethod
    def from_param(structure: ctypes.Structure) -> Any:
        """Return what is passed to a function."""
        return ctypes.byref(structure)


_TYPES = {"i": ctypes.c_long, "d": ctypes.c_double, "a": _Doubles, "s": _Structure}


def address(array: np.ndarray) -> int:
    """Return where an array of doubles begins, for a structure whose owner keeps it alive."""
    assert array.dtype == np.float64
    assert array.flags.c_contiguous
    return int(array.ctypes.data)


def compiled() -> ctypes.CDLL | None:
    """Return the compiled functions; None where there is no compiler, or it fails."""
    return _load()[0]


def why_not() -> str | None:
    """Return why there is no compiled code, in words; None where there is."""
    return _load()[1]


@lru_cache(maxsize=1)
def _load() -> tuple[ctypes.CDLL | None, str | None]:
    folder = files("homeward.localizer").joinpath("native")
    source = "\n".join(folder.joinpath(name).read_text(encoding="utf-8") for name in SOURCES)
    try:
        functions = load(source).functions
    except NativeError as error:
        return None, f"No compiled code ({error}): NumPy does it, which takes half as long again."
    for name, kinds in FUNCTIONS.items():
        function = getattr(functions, name)
        function.argtypes = tuple(_TYPES[kind] for kind in kinds)
        function.restype = ctypes.c_int if name in MAY_FAIL else None
    return functions, None
