"""A program, stage by stage, on named variables; and the kernels that interpret its stages.

An unrolled step grows with q^2 to q^3; the kernels in NumPy, whose model stays symbolic, grow with
memory alone and visit only the landmarks in sight. They are tested against the symbolic steps.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any, Protocol

import casadi as ca
import numpy as np

from homeward.geometry.angles import wrap
from homeward.lab.filters.ekf import (
    LEAST_PIVOT,
    UPDATE_OUTPUTS,
    Belief,
    ExtendedKalmanFilter,
    Measurement,
    Prediction,
    UnscentedFilter,
    predict_function,
    propagate_function,
    shapes,
    update_function,
)
from homeward.lab.model import INPUTS, POLAR


class Kernel(Protocol):
    """A function with arrays of its own for what goes in and what comes out.

    Fill `inputs` in place, call, read `outputs`; the two may be the same memory.
    """

    inputs: dict[str, np.ndarray]
    outputs: dict[str, np.ndarray]
    given: np.ndarray
    """The memory of all inputs in their order."""
    found: np.ndarray
    """The memory of all outputs in their order."""

    def __call__(self) -> None:
        """Compute the outputs from the inputs."""


def allocate(shapes: Mapping[str, tuple[int, ...]]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return zeros for several variables in one piece of memory, and views of it by name.

    Matrices are column-major, as CasADi's are.
    """
    sizes = [int(np.prod(shape)) for shape in shapes.values()]
    memory = np.zeros(sum(sizes))
    pieces = np.split(memory, np.cumsum(sizes)[:-1])
    views = {
        name: piece.reshape(shape, order="F")
        for (name, shape), piece in zip(shapes.items(), pieces, strict=True)
    }
    return memory, views


class Interpreter:
    """A dense CasADi function with named inputs and outputs, on buffers of its own (a `Kernel`).

    A suffix ``_out`` is dropped from the names of outputs.
    """

    def __init__(self, function: ca.Function) -> None:
        f = function
        ins = {f.name_in(i): _shape(f.size_in(i)) for i in range(f.n_in())}
        outs = {f.name_out(i): _shape(f.size_out(i)) for i in range(f.n_out())}
        self.given, self.inputs = allocate(ins)
        self.found, self.outputs = allocate({k.removesuffix("_out"): v for k, v in outs.items()})
        # The evaluator keeps only addresses: buffer and arrays must live as long as it does.
        buffer: Any = None  # CasADi's stubs ask for sizes that it takes from the memoryview
        buffer, self._evaluate = function.buffer()
        self._buffer = buffer
        for i, array in enumerate(self.inputs.values()):
            buffer.set_arg(i, memoryview(_flat(array)))
        for i, array in enumerate(self.outputs.values()):
            buffer.set_res(i, memoryview(_flat(array)))

    def __call__(self) -> None:
        """Compute the outputs from the inputs."""
        self._evaluate()


def _shape(size: tuple[int, int]) -> tuple[int, ...]:
    """Return the shape of an array in CasADi's layout: vectors flat."""
    return size[:1] if size[1] == 1 else size


def _flat(array: np.ndarray) -> Any:
    """Return the memory of the array in the order in which CasADi reads it."""
    flat = array.reshape(-1, order="F")
    # A buffer cannot have length zero; CasADi never reads this one.
    return flat if flat.size else np.zeros(1)


BELIEF = tuple(field.name for field in fields(Belief))


def _arrays(
    kind: ExtendedKalmanFilter,
    *parts: type[Belief | Prediction | Measurement],
    also: Iterable[str] = (),
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return arrays for parts of a step, and `also` for one number of each landmark."""
    sizes = shapes(kind.model, kind.integral)
    wanted = {f.name: sizes[f.name] for part in parts for f in fields(part)}
    return allocate(wanted | dict.fromkeys(also, (kind.model.q,)))


class GenericPredict:
    """The predicting step of a filter (a `Kernel`)."""

    def __init__(self, kind: ExtendedKalmanFilter) -> None:
        self._propagate = Interpreter(propagate_function(kind))
        self.given, self.inputs = self._propagate.given, self._propagate.inputs
        self.found, self.outputs = _arrays(kind, Belief)

    def __call__(self) -> None:
        """Compute the outputs from the inputs."""
        self._propagate()
        given, step, out = self.inputs, self._propagate.outputs, self.outputs
        by_state, by_input = step["by_state"], step["by_input"]
        covariance = by_state @ given["covariance"] @ by_state.T
        covariance += by_input @ given["input_covariance"] @ by_input.T
        covariance[np.diag_indices_from(covariance)] += given["state_variance"]
        out["state"][:] = step["state"]
        out["covariance"][:] = (covariance + covariance.T) / 2
        out["active"][:], out["integral"][:] = given["active"], given["integral"]


class UnscentedPredict:
    """The predicting step of the UKF (a `Kernel`)."""

    def __init__(self, kind: UnscentedFilter) -> None:
        self.given, self.inputs = _arrays(kind, Belief, Prediction)
        self.found, self.outputs = _arrays(kind, Belief)
        self._points = 2 * (kind.model.n + INPUTS)
        # dt, stored and active are the same for all points.
        self._step = kind.step().map("points", "serial", self._points, [2, 3, 4], [])

    def __call__(self) -> None:
        """Compute the outputs from the inputs."""
        given, out = self.inputs, self.outputs
        n = given["state"].size
        spread = np.zeros((n + INPUTS, n + INPUTS))
        spread[:n, :n] = _root(given["covariance"])
        spread[n:, n:] = _root(given["input_covariance"])
        shifts = np.sqrt(n + INPUTS) * np.hstack([spread, -spread])
        shifts += np.concatenate([given["state"], given["control"]])[:, None]
        same = given["dt"], given["stored"], given["active"]
        points = np.asarray(self._step(shifts[:n], shifts[n:], *same))
        out["state"][:] = points.mean(axis=1)
        off = points - out["state"][:, None]
        out["covariance"][...] = off @ off.T / self._points + np.diag(given["state_variance"])
        out["active"][:] = given["active"]


def _root(matrix: np.ndarray) -> np.ndarray:
    """Return what `homeward.lab.filters.ekf.cholesky` does."""
    root = np.zeros(matrix.shape)
    for j in range(len(matrix)):
        column = matrix[j:, j] - root[j:, :j] @ root[j, :j]
        if column[0] > LEAST_PIVOT:
            root[j:, j] = column / np.sqrt(column[0])
    return root


class GenericUpdate:
    """The updating step of a filter (a `Kernel`)."""

    def __init__(self, kind: ExtendedKalmanFilter) -> None:
        self.given, self.inputs = _arrays(kind, Belief, Measurement)
        self.found, self.outputs = _arrays(kind, Belief, also=UPDATE_OUTPUTS)
        self._bearings, self._considered = kind.model.bearing_slice, kind.considered

    def __call__(self) -> None:
        """Compute the outputs from the inputs."""
        given, out = self.inputs, self.outputs
        for name in BELIEF:
            out[name][...] = given[name]
        state, covariance, variance = out["state"], out["covariance"], given["variance"]

        enough = given["mask"].sum() >= given["minimum_visible"][0]
        visible = (given["mask"] > 0) & enough
        entering = np.flatnonzero(visible & (given["active"] == 0))
        compared = visible & (given["active"] > 0)
        innovation = np.where(compared, wrap(given["bearings"] - state[self._bearings]), 0.0)
        predicted = np.diag(covariance)[self._bearings] + variance
        accepted = compared & (innovation**2 <= given["gate"][0] * predicted)

        rows = POLAR + entering
        state[rows] = given["bearings"][entering]
        covariance[rows, :] = covariance[:, rows] = 0.0
        covariance[rows, rows] = variance[entering]
        out["active"][entering] = 1.0
        before, fixed = state.copy(), self._considered
        for i in np.flatnonzero(accepted):
            j = POLAR + i
            gain = covariance[:, j] / (covariance[j, j] + variance[i])
            loss = np.outer(gain, covariance[j, :])
            gain[fixed] = loss[fixed, fixed] = 0.0
            state += gain * (innovation[i] - (state[j] - before[j]))
            covariance -= loss
            covariance[:] = (covariance + covariance.T) / 2
        if given["integral"].size:
            out["integral"] += given["integral_gain"] @ (innovation * accepted)
        out["innovation"][:], out["innovation_variance"][:] = innovation, predicted
        out["accepted"][:] = accepted


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
    """Return the parts ``predict`` and ``update`` of a filter, unrolled up to a number of states.

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
