"""C source of a program, the compiled program, and the choice between it and the interpreter."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import lru_cache
from importlib.resources import files
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from homeward.lab.engine.native.emit import Code, emit
from homeward.lab.engine.program.stages import OBSERVE, Program, Stage, Symbolic
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.filters.settings import Engine
from homeward.native.cache import default_folder
from homeward.native.compiler import NativeError
from homeward.native.library import Library, is_kept, load


@lru_cache(maxsize=64)
def source_of(program: Program, single: bool, extra: tuple[tuple[str, int], ...] = ()) -> Source:
    """Return a program's `Source`, the same object for the same program."""
    return Source(program, single, dict(extra))


class Source:
    """A program in C: for one run on doubles (`single`), or for one run per lane.

    `extra` are variables that no stage has, with their sizes.
    """

    def __init__(self, program: Program, single: bool, extra: dict[str, int]) -> None:
        self.places: dict[str, int] = {}
        """Start of each variable in the pool."""
        self.size = 0
        """Size of the pool."""
        for name in program.shapes:
            self._place(name, program.size(name))
        for name, size in extra.items():
            self._place(name, size)
        functions, calls = self._stages(program)
        kept = [f"#define POOL {max(self.size, 1)}", *functions]
        for part, body in calls.items():
            kept.append(f"static void {part}(V *p) {{ {body} }}")
            if single:
                kept.append(f"void homeward_{part}(double *p) {{ {part}(p); }}")
        text = "#define SINGLE\n" if single else ""
        self.text = text + "\n".join([_template("lanes.h"), _template("noise.h"), *kept])
        self.text += "\n" + _template("loop.c")

    def _place(self, name: str, size: int) -> None:
        if name not in self.places:
            self.places[name] = self.size
            self.size += size

    def _stages(self, program: Program) -> tuple[list[str], dict[str, str]]:
        """Return the C functions of the stages, and the body of each part."""
        functions: list[str] = []
        calls: dict[str, str] = {}
        for part, stages in program.parts.items():
            names = [self._stage(f"{part}_{k}", s, functions) for k, s in enumerate(stages)]
            calls[part] = " ".join(f"{name}(p);" for name in names)
        observe = calls.pop(OBSERVE, "(void)p;")
        return functions, {**calls, "advance": " ".join(calls.values()), OBSERVE: observe}

    def _stage(self, name: str, stage: Stage, functions: list[str]) -> str:
        """Add a stage's C function and return its name."""
        if isinstance(stage, Symbolic):
            functions.append(emit(name, stage.function, self.places))
            return name
        if stage.predicts:
            functions.append(self._generic(stage.kind, stage.propagate))
            return "generic_predict_all"
        return "generic_update"

    def _generic(self, kind: ExtendedKalmanFilter, propagate: ca.Function) -> str:
        """Return the generic functions for a filter, after its propagation."""
        n, q = kind.model.n, kind.model.q
        for name, size in (("by_state", n * n), ("by_input", 2 * n), ("scratch", 2 * n * n)):
            self._place(name, size)
        defined = {"N": n, "Q": q} | {k.upper(): v for k, v in self.places.items()}
        if not kind.integral:
            del defined["INTEGRAL"], defined["INTEGRAL_GAIN"]
        rows = _pattern(propagate, n)
        starts = [sum(map(len, rows[:i])) for i in range(n + 1)]
        entries = [k for row in rows for k in row]
        lines = [f"#define {key} {value}" for key, value in defined.items()]
        lines.append(f"static const int row_start[] = {{{', '.join(map(str, starts))}}};")
        lines.append(f"static const int row_entry[] = {{{', '.join(map(str, entries))}}};")
        lines.append(_template("generic.c"))
        lines.append(emit("propagate", propagate, self.places))
        lines += [f"#undef {key}" for key in defined]
        lines.append("static void generic_predict_all(V *p) { propagate(p); generic_predict(p); }")
        return "\n".join(lines)


def _pattern(propagate: ca.Function, n: int) -> list[list[int]]:
    """Return for each row of G the columns that are not always zero."""
    code = Code(propagate)
    which = propagate.name_out().index("by_state_out")
    rows: list[list[int]] = [[] for _ in range(n)]
    for output, entry, node in code.outputs:
        if output == which and not code.is_zero(node):
            rows[entry % n].append(entry // n)
    return rows


def _template(name: str) -> str:
    return files("homeward.lab.engine.native").joinpath(name).read_text(encoding="utf-8")


class NativeProgram:
    """A program compiled for one run, in place of a `Machine`.

    Raises `NativeError` when it cannot be compiled.
    """

    engine: Engine = "native"

    def __init__(self, program: Program) -> None:
        source = source_of(program, single=True)
        self.library: Library = load(source.text)
        self.notes = self.library.notes
        self.pool = np.zeros(source.size)
        self.variables = {
            name: self._view(source.places[name], shape) for name, shape in program.shapes.items()
        }
        """Views of the pool by name; matrices are column-major."""
        self._address = ctypes.c_void_p(self.pool.ctypes.data)
        self._functions: dict[str, Any] = {}
        for part in (*program.parts, "advance"):
            function = getattr(self.library.functions, f"homeward_{part}")
            function.argtypes, function.restype = (ctypes.c_void_p,), None
            self._functions[part] = function

    def do(self, part: str = "advance") -> None:
        """Execute a part of the program; by default all but `OBSERVE`."""
        self._functions[part](self._address)

    def _view(self, place: int, shape: tuple[int, ...]) -> np.ndarray:
        size = int(np.prod(shape))
        return self.pool[place : place + size].reshape(shape, order="F")


COMPILING_S = 25e-6
"""Compile time per character of C [s]."""

T = TypeVar("T")


def choose(
    engine: Engine,
    saved: float,
    source: Callable[[], Source],
    native: Callable[[], T],
    slower: str,
) -> tuple[T | None, tuple[str, ...]]:
    """Return the result of `native`, or None for the interpreter; and notes for the user.

    A note gives the reason why compiled code is not available, with `slower` as the consequence.
    `saved` is the time that compiled code saves in this run [s]; `source` writes the C.
    """
    if engine == "interpreter":
        return None, ()
    try:
        if engine == "auto" and not _pays(saved, source):
            return None, ()
        return native(), ()
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
