"""C source of a program, the compiled program, and the choice between it and the interpreter."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np

from homeward.lab.engine.native.cache import default_folder
from homeward.lab.engine.native.compiler import NativeError
from homeward.lab.engine.native.emit import emit
from homeward.lab.engine.native.library import Library, is_kept, load
from homeward.lab.engine.program import OBSERVE, Program, allocate
from homeward.lab.filters.settings import Engine


@lru_cache(maxsize=64)
def source_of(program: Program, single: bool, extra: tuple[tuple[str, int], ...] = ()) -> Source:
    """Return a program's `Source`, the same object for the same program."""
    return Source(program, single, dict(extra))


class Source:
    """A program in C: for one run on doubles (`single`), or for one run per lane.

    `extra` are variables that no function has, with their sizes. Raises `NativeError` for a program
    that is too large to be unrolled.
    """

    def __init__(self, program: Program, single: bool, extra: dict[str, int]) -> None:
        if not program.is_unrolled:
            raise NativeError("the filter has too many landmarks")
        sizes = {name: program.size(name) for name in program.shapes} | extra
        *starts, size = np.cumsum([0, *sizes.values()]).tolist()
        self.places: dict[str, int] = dict(zip(sizes, starts, strict=True))
        """Start of each variable in the pool; they lie as `allocate` puts them."""
        lines = [emit(f"part_{name}", f, self.places) for name, f in program.parts.items()]
        calls = {name: f"part_{name}(p);" for name in program.parts}
        observe = calls.pop(OBSERVE, "(void)p;")
        calls |= {"advance": " ".join(calls.values()), OBSERVE: observe}
        lines += [f"static void {part}(V *p) {{ {calls[part]} }}" for part in ("advance", OBSERVE)]
        if single:
            lines += [f"void homeward_{k}(double *p) {{ {call} }}" for k, call in calls.items()]
        texts = ["#define SINGLE"] if single else []
        texts += [_template("lanes.h"), _template("noise.h"), f"#define POOL {max(size, 1)}"]
        self.text = "\n".join([*texts, *lines, _template("loop.c")])


def _template(name: str) -> str:
    return files("homeward.lab.engine.native").joinpath(name).read_text(encoding="utf-8")


class NativeProgram:
    """A program compiled for one run, in place of a `Machine`.

    Raises `NativeError` when it cannot be compiled.
    """

    engine: Engine = "native"

    def __init__(self, program: Program) -> None:
        self.library: Library = load(source_of(program, single=True).text)
        self.notes = self.library.notes
        self.pool, self.variables = allocate(program.shapes)
        self._address = ctypes.c_void_p(self.pool.ctypes.data)
        self._functions: dict[str, Any] = {}
        for part in (*program.parts, "advance"):
            function = getattr(self.library.functions, f"homeward_{part}")
            function.argtypes, function.restype = (ctypes.c_void_p,), None
            self._functions[part] = function

    def do(self, part: str = "advance") -> None:
        """Execute a part of the program; by default all but `OBSERVE`."""
        self._functions[part](self._address)


COMPILING_S = 25e-6
"""Compile time per character of C [s]."""


def choose(
    engine: Engine, saved: float, source: Callable[[], Source], slower: str
) -> tuple[Library | None, tuple[str, ...]]:
    """Return the compiled code of a source, or None for the interpreter; and notes for the user.

    A note gives the reason why compiled code is not available, with `slower` as the consequence.
    `saved` is the time that compiled code saves in this run [s].
    """
    if engine == "interpreter":
        return None, ()
    try:
        if engine == "auto" and not _pays(saved, source):
            return None, ()
        library = load(source().text)
        return library, library.notes
    except NativeError as error:
        if engine == "auto" and not _is_long(saved):
            return None, ()
        return None, (f"No compiled code ({error}): the interpreter runs instead, {slower}.",)


def _pays(saved: float, source: Callable[[], Source]) -> bool:
    """Return whether compiling pays, or the compiled code is cached."""
    if not (_is_long(saved) or any(default_folder().glob("*.so"))):
        return False
    text = source().text
    return saved > COMPILING_S * len(text) or is_kept(text)


def _is_long(saved: float) -> bool:
    return saved > 1.0
