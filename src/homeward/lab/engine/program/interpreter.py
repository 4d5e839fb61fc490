"""Kernels, the one shape of everything executable, and CasADi's virtual machine as one of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import casadi as ca
import numpy as np


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
    """A CasADi function on buffers of its own (a `Kernel`).

    Parameters
    ----------
    function : casadi.Function
        Dense, with named inputs and outputs; a suffix ``_out`` is dropped from the latter.
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
