"""The interpreter: CasADi's virtual machine executes a step; no compiler is needed."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from homeward.engine.program.kernel import allocate


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
