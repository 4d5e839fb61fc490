"""The front-end's innermost loops in C, where there is a compiler; NumPy does the same without.

As in `homeward.localizer.compiled`: what has a counterpart in ``native/*.c`` asks `compiled` for
it, and else goes on by itself; tests hold the two together.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache

from homeward.engine.native.compiler import NativeError
from homeward.engine.native.program import program

SOURCES = ("shared.h", "lay.c", "fit.c", "score.c")
"""Of one program, in this order."""
FUNCTIONS = {
    "lay": "iii" + "aaf" + 2 * "ila" + 6 * "a",
    "score": "iii" + "ffdff",
    "residuals": "iiiaadaaab",
    "descend": "iiii" + 5 * "a" + "dda",
}
"""What the functions take, in order: see `program`."""
MAY_FAIL = ("lay", "residuals", "descend")
"""Those that return 0, or 1 where they fail."""


@lru_cache(maxsize=1)
def compiled() -> ctypes.CDLL | None:
    """Return the compiled functions; None where there is no compiler, or it fails."""
    try:
        return program("homeward.vision", SOURCES, FUNCTIONS, MAY_FAIL)
    except NativeError:
        return None
