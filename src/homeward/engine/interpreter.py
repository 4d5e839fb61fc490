"""The interpreter: CasADi's virtual machine executes a step; no compiler is needed."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np


class Interpreter:
    """A CasADi function on buffers of its own (a `Kernel`).

    Parameters
    ----------
    function : casadi.Function
        Dense, with named inputs and outputs; a suffix ``_out`` is dropped from the latter.
    """

    def __init__(self, function: ca.Function) -> None:
        self.inputs = {
            function.name_in(i): _array(function.size_in(i)) for i in range(function.n_in())
        }
        self.outputs = {
            function.name_out(i).removesuffix("_out"): _array(function.size_out(i))
            for i in range(function.n_out())
        }
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


def _array(size: tuple[int, int]) -> np.ndarray:
    """Return zeros in CasADi's layout: column-major, vectors flat."""
    rows, columns = size
    return np.zeros(rows) if columns == 1 else np.zeros((rows, columns), order="F")


def _flat(array: np.ndarray) -> Any:
    """Return the memory of the array in the order in which CasADi reads it."""
    flat = array.reshape(-1, order="F")
    # A buffer cannot have length zero; CasADi never reads this one.
    return flat if flat.size else np.zeros(1)
