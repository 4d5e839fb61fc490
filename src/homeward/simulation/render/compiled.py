"""The renderer's innermost loop in C, where there is a compiler; NumPy does the same without.

As in `homeward.localizer.compiled`; a test holds the two together.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache

from homeward.engine.native.compiler import NativeError
from homeward.engine.native.program import program

FUNCTIONS = {"cast": "iiii" + "ll" + "fff" + "d" + "fffh"}
"""What the functions take, in order: see `program`."""


@lru_cache(maxsize=1)
def compiled() -> ctypes.CDLL | None:
    """Return the compiled functions; None where there is no compiler, or it fails."""
    try:
        return program("homeward.simulation.render", ("cast.c",), FUNCTIONS, ("cast",))
    except NativeError:
        return None
