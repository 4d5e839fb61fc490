"""The innermost loops in C, where there is a compiler; NumPy does the same without, more slowly.

What is compiled is kept for next time (see `homeward.engine.native`). A function of the localiser
that has a counterpart in ``native/*.c`` asks `compiled` for it, and else goes on by itself; tests
hold the two together.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache

from homeward.engine.native.compiler import NativeError
from homeward.engine.native.program import program

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
    "integrate": "iaaaddi" + 5 * "a",
}
"""What the functions take, in order: integers, doubles, arrays of doubles, a structure."""
MAY_FAIL = (
    *("add_sightings", "eliminate", "predict", "correct"),
    *("solve_home", "fit_home", "judge_home", "doubt_home"),
)
"""Those that return 0, or 1 where an index is out of range or a matrix not positive definite."""


def compiled() -> ctypes.CDLL | None:
    """Return the compiled functions; None where there is no compiler, or it fails."""
    return _load()[0]


def why_not() -> str | None:
    """Return why there is no compiled code, in words; None where there is."""
    return _load()[1]


@lru_cache(maxsize=1)
def _load() -> tuple[ctypes.CDLL | None, str | None]:
    try:
        return program("homeward.localizer", SOURCES, FUNCTIONS, MAY_FAIL), None
    except NativeError as error:
        return None, f"No compiled code ({error}): NumPy does it, which takes twice as long."
