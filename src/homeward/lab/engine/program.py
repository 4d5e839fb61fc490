"""A program, CasADi functions on named variables; and the machine that evaluates it by CasADi."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from homeward.lab.filters.ekf import Belief, ExtendedKalmanFilter, steps
from homeward.lab.filters.settings import Engine

Shapes = dict[str, tuple[int, ...]]
Variables = Mapping[str, np.ndarray]
"""Arrays by name; matrices are column-major, as in CasADi."""
Execute = Callable[[], None]
BELIEF = tuple(field.name for field in fields(Belief))
OBSERVE = "observe"
"""The part of a program that scores a sample and changes nothing."""


def allocate(shapes: Shapes) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return zeros for several variables in one piece of memory, and views of it by name."""
    memory, views, start = np.zeros(sum(map(math.prod, shapes.values()))), {}, 0
    for name, shape in shapes.items():
        end = start + math.prod(shape)
        views[name] = memory[start:end].reshape(shape, order="F")
        start = end
    return memory, views


def input_shapes(f: ca.Function) -> Shapes:
    """Return the shapes of a function's inputs by name; vectors are flat."""
    return {f.name_in(i): _shape(f.size_in(i)) for i in range(f.n_in())}


def output_shapes(f: ca.Function) -> Shapes:
    """Return the shapes of a function's outputs by name, without the suffix ``_out``."""
    names = (f.name_out(i).removesuffix("_out") for i in range(f.n_out()))
    return {name: _shape(f.size_out(i)) for i, name in enumerate(names)}


def _shape(size: tuple[int, int]) -> tuple[int, ...]:
    return size[:1] if size[1] == 1 else size


def bound(f: ca.Function, variables: Variables) -> Execute:
    """Return a dense function on the memory of its variables."""
    # The evaluator keeps only addresses: buffer and arrays must live as long as it does.
    buffer: Any = None  # CasADi's stubs ask for sizes that it takes from the memoryview
    buffer, evaluate = f.buffer()
    given = [_flat(variables[name]) for name in input_shapes(f)]
    # It may write an output before it has read every input, so outputs need their own memory.
    outputs = [_flat(variables[name]) for name in output_shapes(f)]
    written = [(array, np.zeros_like(array)) for array in outputs]
    for i, array in enumerate(given):
        buffer.set_arg(i, _view(array))
    for i, (_, found) in enumerate(written):
        buffer.set_res(i, _view(found))

    def execute(_alive: object = (buffer, given)) -> None:
        evaluate()
        for array, found in written:
            array[:] = found

    return execute


def _flat(array: np.ndarray) -> np.ndarray:
    """Return the memory of the array in the order in which CasADi reads it."""
    return array.reshape(-1, order="F")


def _view(flat: np.ndarray) -> memoryview:
    # A buffer cannot have length zero; CasADi never reads this one.
    array: Any = flat if flat.size else np.zeros(1)
    return memoryview(array)


@dataclass(frozen=True, eq=False)
class Program:
    """A dense function for each part; all parts but `OBSERVE`, in order, make one advance."""

    parts: Mapping[str, ca.Function]

    @cached_property
    def shapes(self) -> Shapes:
        """Shapes of all variables."""
        each = [input_shapes(f) | output_shapes(f) for f in self.parts.values()]
        return {name: shape for shapes in each for name, shape in shapes.items()}

    @property
    def is_unrolled(self) -> bool:
        """Whether all functions consist of operations on single numbers."""
        return all(f.is_a("SXFunction") for f in self.parts.values())

    def size(self, name: str) -> int:
        """Return the number of entries of a variable."""
        return math.prod(self.shapes[name])


class Machine:
    """A program evaluated by CasADi, on variables that its functions share.

    `extra` are variables that no function has, with their sizes.
    """

    engine: Engine = "interpreter"

    def __init__(
        self,
        program: Program,
        extra: Mapping[str, int] | None = None,
        notes: tuple[str, ...] = (),
    ) -> None:
        self.notes = notes
        """Reasons why no compiled code runs, as sentences for the user."""
        sizes = {name: (size,) for name, size in (extra or {}).items()}
        self.pool, self.variables = allocate(program.shapes | sizes)
        self._parts = {name: bound(f, self.variables) for name, f in program.parts.items()}

    def do(self, *parts: str) -> None:
        """Execute parts of the program; all but `OBSERVE` where none is named."""
        for part in parts or [name for name in self._parts if name != OBSERVE]:
            if part in self._parts:
                self._parts[part]()


@lru_cache(maxsize=64)
def filter_program(kind: ExtendedKalmanFilter) -> Program:
    """Return a filter alone: predict, then update."""
    return Program(steps(kind))
