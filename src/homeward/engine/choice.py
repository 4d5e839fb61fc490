"""Which engine executes a program: the one place that decides."""

from __future__ import annotations

from typing import Literal

from homeward.engine.native.compiler import NativeError
from homeward.engine.native.library import is_kept

Engine = Literal["auto", "interpreter", "native"]
"""auto: native where a compiler is there and the work pays for compiling, or has been compiled
before; else the interpreter."""
PAYS_FROM = 50_000
"""Steps of a filter from which on compiling costs less than it saves."""


def wants_native(engine: Engine, steps: int, source: str) -> bool:
    """Tell whether to try the native engine for so many steps of a C source."""
    if engine == "auto" and steps < PAYS_FROM:
        try:
            return is_kept(source)
        except NativeError:
            return False
    return engine != "interpreter"


def without_native(error: NativeError, times: str) -> str:
    """Return the line that says why the interpreter runs instead, and what that costs.

    Parameters
    ----------
    error : NativeError
        Why there is no compiled code.
    times : str
        How much slower it is, in words.
    """
    return f"Without compiled code ({error}): the interpreter runs instead, {times} slower."
