"""Which kernels execute a filter."""

from __future__ import annotations

from typing import NamedTuple

from homeward.engine.choice import choose
from homeward.engine.native.source import NativeProgram, Source, source_of
from homeward.engine.program.interpreter import Kernel
from homeward.engine.program.stages import COMPILES_UP_TO, filter_parts, filter_program
from homeward.filters.ekf import ExtendedKalmanFilter
from homeward.filters.settings import Engine

UNROLLED_UP_TO = 48
"""States: up to here an unrolled step is built within half a second and runs faster."""
SAVED_S = 20e-6
"""What compiled code saves in each step [s]."""
WRITING_S = 60.0
"""For more states than that, `auto` wants to save as much [s]: writing the C alone takes long."""
SLOWER = "which takes up to twice as long"


class FilterKernels(NamedTuple):
    """A filter's two steps, ready to run."""

    predict: Kernel
    update: Kernel
    engine: Engine
    """What executes them: native or interpreter."""
    notes: tuple[str, ...]
    """What the user must know of that, each a sentence."""


def filter_kernels(
    kind: ExtendedKalmanFilter, engine: Engine = "auto", steps: int = 0
) -> FilterKernels:
    """Return the kernels of a filter; so many `steps` are coming, as far as that is known."""

    def native() -> NativeProgram:
        return NativeProgram(filter_program(kind))

    def source() -> Source:
        return source_of(filter_program(kind), single=True)

    saved = SAVED_S * steps
    if not kind.separable and kind.model.n > COMPILES_UP_TO:
        engine = "interpreter"  # there are no loops in C for it
    if engine == "auto" and kind.model.n > UNROLLED_UP_TO and saved < WRITING_S:
        engine = "interpreter"
    program, notes = choose(engine, saved, source, native, SLOWER)
    if program is not None:
        notes = program.library.notes
        return FilterKernels(program.part("predict"), program.part("update"), "native", notes)
    predict, update = (part[0].kernel() for part in filter_parts(kind, UNROLLED_UP_TO).values())
    return FilterKernels(predict, update, "interpreter", notes)
