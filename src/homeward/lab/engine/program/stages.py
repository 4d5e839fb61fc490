"""What a program does, stage by stage, on named variables; any engine can execute it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca

from homeward.lab.engine.program.kernels import (
    GenericPredict,
    GenericUpdate,
    Interpreter,
    Kernel,
    UnscentedPredict,
    allocate,
)
from homeward.lab.filters.ekf import (
    ExtendedKalmanFilter,
    UnscentedFilter,
    predict_function,
    propagate_function,
    update_function,
)

Shapes = dict[str, tuple[int, ...]]
COMPILES_UP_TO = 20
"""States: up to here unrolled code is compiled within some seconds, and is faster than loops; of 23
states it takes 20 s to compile, and is no faster for one run."""
OBSERVE = "observe"
"""The part of a program that looks at a sample and changes nothing."""


class Stage(ABC):
    """One function on named variables, which it reads and writes."""

    @property
    def shapes(self) -> Shapes:
        """Its variables; matrices are column-major."""
        kernel = self.kernel()
        return {k: a.shape for k, a in (kernel.inputs | kernel.outputs).items()}

    @abstractmethod
    def kernel(self) -> Kernel:
        """Return it interpreted."""


@dataclass(frozen=True)
class Symbolic(Stage):
    """A CasADi function, dense, with named inputs and outputs (a suffix ``_out`` is dropped)."""

    function: ca.Function

    def kernel(self) -> Kernel:
        """Return it interpreted."""
        return Interpreter(self.function)


@dataclass(frozen=True)
class Generic(Stage):
    """A step of a filter with many landmarks, whose matrices are loops rather than symbols."""

    kind: ExtendedKalmanFilter
    predicts: bool
    """Else it updates."""

    @property
    def propagate(self) -> ca.Function:
        """The symbolic part of a prediction: state, by_state, by_input."""
        return propagate_function(self.kind)

    def kernel(self) -> Kernel:
        """Return it in NumPy."""
        if not self.predicts:
            return GenericUpdate(self.kind)
        if isinstance(self.kind, UnscentedFilter):
            return UnscentedPredict(self.kind)
        return GenericPredict(self.kind)


@dataclass(frozen=True)
class Separable:
    """The same program as a filter and functions of one landmark, for who loops over landmarks."""

    kind: ExtendedKalmanFilter
    world: ca.Function | None = None
    """What moves the robot and looks at one landmark; None: all that is recorded."""
    score: ca.Function | None = None
    """How far off the pose is; None: nothing is scored."""


@dataclass(frozen=True, eq=False)
class Program:
    """Stages by the name of their part; all parts but `OBSERVE`, in order, make one advance."""

    parts: Mapping[str, tuple[Stage, ...]]
    separable: Separable | None = None
    """None where a landmark's row of the step depends on more than the robot and itself."""

    @cached_property
    def shapes(self) -> Shapes:
        """All its variables."""
        shapes: Shapes = {}
        for part in self.parts.values():
            for stage in part:
                shapes |= stage.shapes
        return shapes

    def size(self, name: str) -> int:
        """Return the number of entries of a variable."""
        return math.prod(self.shapes[name])


class Machine:
    """A program interpreted: variables that its stages share, and a kernel for each of them.

    `extra` are variables that no stage has, with their sizes.
    """

    def __init__(self, program: Program, extra: Mapping[str, int] | None = None) -> None:
        sizes = {name: (size,) for name, size in (extra or {}).items()}
        _, self.variables = allocate(program.shapes | sizes)
        self.flat = {k: v.reshape(-1, order="F") for k, v in self.variables.items()}
        """The same memory, matrices column by column."""
        self._parts = {
            name: [self._bound(stage) for stage in part] for name, part in program.parts.items()
        }

    def do(self, *parts: str) -> None:
        """Execute parts of the program; all but `OBSERVE` where none is named."""
        for part in parts or [name for name in self._parts if name != OBSERVE]:
            for execute in self._parts.get(part, ()):
                execute()

    def _bound(self, stage: Stage) -> Callable[[], None]:
        kernel = stage.kernel()
        ins = [(self.flat[k], a) for k, a in kernel.inputs.items()]
        outs = [(self.flat[k], a) for k, a in kernel.outputs.items()]

        def execute() -> None:
            for variable, array in ins:
                array[...] = variable.reshape(array.shape, order="F")
            kernel()
            for variable, array in outs:
                variable[:] = array.reshape(-1, order="F")

        return execute


def filter_parts(
    kind: ExtendedKalmanFilter, unrolled_up_to: int | None = None
) -> dict[str, tuple[Stage, ...]]:
    """Return the parts ``predict`` and ``update`` of a filter, unrolled up to so many states.

    None stands for `COMPILES_UP_TO`, and for all where there are no loops in C for the filter.
    """
    most = COMPILES_UP_TO if unrolled_up_to is None else unrolled_up_to
    if kind.model.n <= most or (unrolled_up_to is None and not kind.separable):
        return {
            "predict": (Symbolic(predict_function(kind)),),
            "update": (Symbolic(update_function(kind)),),
        }
    return {"predict": (Generic(kind, True),), "update": (Generic(kind, False),)}


@lru_cache(maxsize=64)
def filter_program(kind: ExtendedKalmanFilter) -> Program:
    """Return a filter alone: predict, then update."""
    return Program(filter_parts(kind), Separable(kind) if kind.separable else None)
