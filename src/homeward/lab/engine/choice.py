"""Which engine executes a program: the one place that decides."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from homeward.lab.engine.native.source import Source
from homeward.lab.filters.settings import Engine
from homeward.native.cache import default_folder
from homeward.native.compiler import NativeError
from homeward.native.library import is_kept

COMPILING_S = 25e-6
"""What compiling takes for each character of C [s]."""

T = TypeVar("T")


def choose(
    engine: Engine,
    saved: float,
    source: Callable[[], Source],
    native: Callable[[], T],
    slower: str,
) -> tuple[T | None, tuple[str, ...]]:
    """Return what the native engine makes, or None where the interpreter is to run.

    Parameters
    ----------
    engine : {"auto", "interpreter", "native"}
        See `homeward.lab.filters.settings.Engine`.
    saved : float
        About what compiled code will save in this run [s].
    source : callable
        Writes the C.
    native : callable
        Compiles and makes something of it.
    slower : str
        What running without it costs, in words.

    Returns
    -------
    made : T or None
        What `native` returned.
    notes : tuple of str
        What the user must know: why there is no compiled code although it was wanted.
    """
    if engine == "interpreter":
        return None, ()
    try:
        if engine == "auto" and not _pays(saved, source):
            return None, ()
        return native(), ()
    except NativeError as error:
        if engine == "auto" and not _worth_a_word(saved):
            return None, ()
        return None, (f"No compiled code ({error}): the interpreter runs instead, {slower}.",)


def _pays(saved: float, source: Callable[[], Source]) -> bool:
    """Tell whether compiling pays, or has been paid for before."""
    if not (_worth_a_word(saved) or any(default_folder().glob("*.so"))):
        return False
    text = source().text
    return saved > COMPILING_S * len(text) or is_kept(text)


def _worth_a_word(saved: float) -> bool:
    return saved > 1.0
