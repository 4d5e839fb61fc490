"""A program, stage by stage, on named variables; and the machine that interprets it.

The cost of an unrolled step grows with q^2 to q^3. The generic steps in NumPy, whose model stays
symbolic, grow only with the size of their matrices, and visit only the landmarks in view.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from homeward.geometry.angles import wrap
from homeward.lab.filters.ekf import (
    MIN_PIVOT,
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
from homeward.lab.filters.settings import Engine
from homeward.lab.model import INPUTS, POLAR

Shapes = dict[str, tuple[int, ...]]
Variables = Mapping[str, np.ndarray]
"""Arrays by name; matrices are column-major, as in CasADi."""
Execute = Callable[[], None]
BELIEF = tuple(field.name for field in fields(Belief))
MAX_COMPILED_STATES = 20
"""Up to here unrolled code compiles within seconds and is faster than loops. With 23 states it
takes 20 s to compile, and is no faster for one run."""
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


@dataclass(frozen=True)
class Symbolic:
    """A CasADi function, dense, with named inputs and outputs (a suffix ``_out`` is dropped)."""

    function: ca.Function

    @property
    def inputs(self) -> Shapes:
        """Shapes of its inputs."""
        f = self.function
        return {f.name_in(i): _shape(f.size_in(i)) for i in range(f.n_in())}

    @property
    def outputs(self) -> Shapes:
        """Shapes of its outputs."""
        f = self.function
        names = (f.name_out(i).removesuffix("_out") for i in range(f.n_out()))
        return {name: _shape(f.size_out(i)) for i, name in enumerate(names)}

    @property
    def shapes(self) -> Shapes:
        """Shapes of its variables."""
        return self.inputs | self.outputs

    def on(self, variables: Variables) -> Execute:
        """Return the function on the memory of the variables."""
        # The evaluator keeps only addresses: buffer and arrays must live as long as it does.
        buffer: Any = None  # CasADi's stubs ask for sizes that it takes from the memoryview
        buffer, evaluate = self.function.buffer()
        given = [_flat(variables[name]) for name in self.inputs]
        # It may write an output before it has read every input, so outputs need their own memory.
        outputs = [_flat(variables[name]) for name in self.outputs]
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


def _shape(size: tuple[int, int]) -> tuple[int, ...]:
    """Return the shape of an array in CasADi's layout: vectors flat."""
    return size[:1] if size[1] == 1 else size


def _flat(array: np.ndarray) -> np.ndarray:
    """Return the memory of the array in the order in which CasADi reads it."""
    return array.reshape(-1, order="F")


def _view(flat: np.ndarray) -> memoryview:
    # A buffer cannot have length zero; CasADi never reads this one.
    array: Any = flat if flat.size else np.zeros(1)
    return memoryview(array)


@dataclass(frozen=True)
class Generic:
    """A step of a filter with many landmarks, as loops over matrices instead of symbols."""

    kind: ExtendedKalmanFilter
    predicts: bool
    """Whether it predicts; otherwise it updates."""

    @property
    def propagate(self) -> ca.Function:
        """The symbolic part of a prediction: state, by_state, by_input."""
        return propagate_function(self.kind)

    @property
    def shapes(self) -> Shapes:
        """Shapes of its variables."""
        sizes = shapes(self.kind.model, self.kind.integral)
        names = [*BELIEF, *(f.name for f in fields(Prediction if self.predicts else Measurement))]
        outputs = () if self.predicts else UPDATE_OUTPUTS
        return {k: sizes[k] for k in names} | dict.fromkeys(outputs, (self.kind.model.q,))

    def on(self, variables: Variables) -> Execute:
        """Return the step in NumPy."""
        if not self.predicts:
            return lambda: _update(self.kind, variables)
        if isinstance(self.kind, UnscentedFilter):
            return _unscented_predict(self.kind, variables)
        return _predict(self.propagate, variables)


Stage = Symbolic | Generic
"""A function that reads and writes named variables."""


def _predict(propagate: ca.Function, variables: Variables) -> Execute:
    stage = Symbolic(propagate)
    step = {k: np.zeros(v, order="F") for k, v in stage.outputs.items() if k != "state"}
    propagated = stage.on({**variables, **step})

    def execute() -> None:
        propagated()
        by_state, by_input = step["by_state"], step["by_input"]
        covariance = by_state @ variables["covariance"] @ by_state.T
        covariance += by_input @ variables["input_covariance"] @ by_input.T
        covariance[np.diag_indices_from(covariance)] += variables["state_variance"]
        variables["covariance"][:] = (covariance + covariance.T) / 2

    return execute


def _unscented_predict(kind: UnscentedFilter, variables: Variables) -> Execute:
    n = kind.model.n
    points = 2 * (n + INPUTS)
    # dt, stored and active are the same for all points.
    step = kind.step().map("points", "serial", points, [2, 3, 4], [])

    def execute() -> None:
        spread = np.zeros((n + INPUTS, n + INPUTS))
        spread[:n, :n] = _root(variables["covariance"])
        spread[n:, n:] = _root(variables["input_covariance"])
        shifts = np.sqrt(n + INPUTS) * np.hstack([spread, -spread])
        shifts += np.concatenate([variables["state"], variables["control"]])[:, None]
        same = variables["dt"], variables["stored"], variables["active"]
        moved = np.asarray(step(shifts[:n], shifts[n:], *same))
        variables["state"][:] = moved.mean(axis=1)
        off = moved - variables["state"][:, None]
        variables["covariance"][:] = off @ off.T / points + np.diag(variables["state_variance"])

    return execute


def _root(matrix: np.ndarray) -> np.ndarray:
    """Return the root that `homeward.lab.filters.ekf.cholesky` computes."""
    root = np.zeros(matrix.shape)
    for j in range(len(matrix)):
        column = matrix[j:, j] - root[j:, :j] @ root[j, :j]
        if column[0] > MIN_PIVOT:
            root[j:, j] = column / np.sqrt(column[0])
    return root


def _update(kind: ExtendedKalmanFilter, variables: Variables) -> None:
    state, covariance, variance = (variables[k] for k in ("state", "covariance", "variance"))
    active, bearings, rows = variables["active"], variables["bearings"], kind.model.bearing_slice
    enough = variables["mask"].sum() >= variables["minimum_visible"][0]
    visible = (variables["mask"] > 0) & enough
    entering = np.flatnonzero(visible & (active == 0))
    compared = visible & (active > 0)
    innovation = np.where(compared, wrap(bearings - state[rows]), 0.0)
    predicted = np.diag(covariance)[rows] + variance
    accepted = compared & (innovation**2 <= variables["gate"][0] * predicted)

    entered = POLAR + entering
    state[entered] = bearings[entering]
    covariance[entered, :] = covariance[:, entered] = 0.0
    covariance[entered, entered] = variance[entering]
    active[entering] = 1.0
    before, fixed = state.copy(), kind.considered
    for i in np.flatnonzero(accepted):
        j = POLAR + i
        gain = covariance[:, j] / (covariance[j, j] + variance[i])
        loss = np.outer(gain, covariance[j, :])
        gain[fixed] = loss[fixed, fixed] = 0.0
        state += gain * (innovation[i] - (state[j] - before[j]))
        covariance -= loss
        covariance[:] = (covariance + covariance.T) / 2
    if kind.integral:
        variables["integral"][:] += variables["integral_gain"] @ (innovation * accepted)
    for name, values in zip(UPDATE_OUTPUTS, (innovation, predicted, accepted), strict=True):
        variables[name][:] = values


@dataclass(frozen=True, eq=False)
class Program:
    """Stages by the name of their part; all parts but `OBSERVE`, in order, make one advance."""

    parts: Mapping[str, tuple[Stage, ...]]

    @cached_property
    def shapes(self) -> Shapes:
        """Shapes of all variables."""
        return {k: v for part in self.parts.values() for s in part for k, v in s.shapes.items()}

    def size(self, name: str) -> int:
        """Return the number of entries of a variable."""
        return math.prod(self.shapes[name])


class Machine:
    """A program interpreted, on variables that its stages share.

    `extra` are variables that no stage has, with their sizes.
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
        self._parts = {
            name: [stage.on(self.variables) for stage in part]
            for name, part in program.parts.items()
        }

    def do(self, *parts: str) -> None:
        """Execute parts of the program; all but `OBSERVE` where none is named."""
        for part in parts or [name for name in self._parts if name != OBSERVE]:
            for execute in self._parts.get(part, ()):
                execute()


def filter_parts(
    kind: ExtendedKalmanFilter, max_unrolled: int | None = None
) -> dict[str, tuple[Stage, ...]]:
    """Return the parts ``predict`` and ``update`` of a filter, unrolled up to a number of states.

    The default is `MAX_COMPILED_STATES`, and no limit where there are no loops in C for the filter.
    """
    limit = MAX_COMPILED_STATES if max_unrolled is None else max_unrolled
    if kind.model.n <= limit or (max_unrolled is None and not kind.separable):
        return {
            "predict": (Symbolic(predict_function(kind)),),
            "update": (Symbolic(update_function(kind)),),
        }
    return {"predict": (Generic(kind, True),), "update": (Generic(kind, False),)}


@lru_cache(maxsize=64)
def filter_program(kind: ExtendedKalmanFilter) -> Program:
    """Return a filter alone: predict, then update."""
    return Program(filter_parts(kind))
