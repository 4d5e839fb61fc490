"""One part of a compiled program as a kernel: arrays in, arrays out."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from homeward.engine.native.library import Library, load
from homeward.engine.native.source import source_of
from homeward.engine.program.stages import Program


class NativeProgram:
    """A compiled program for one run, and the memory of its variables.

    Raises
    ------
    NativeError
        When it cannot be compiled.
    """

    def __init__(self, program: Program) -> None:
        source = source_of(program, single=True)
        self.library: Library = load(source.text)
        self.pool = np.zeros(source.size)
        self.variables = {
            name: self._view(source.places[name], shape) for name, shape in program.shapes.items()
        }
        """Views of the pool by name; matrices are column-major."""
        self._address = ctypes.c_void_p(self.pool.ctypes.data)

    def part(self, name: str) -> NativeKernel:
        """Return a part as a kernel; all kernels share the program's variables."""
        return NativeKernel(self, getattr(self.library.functions, f"homeward_{name}"))

    def _view(self, place: int, shape: tuple[int, ...]) -> np.ndarray:
        size = int(np.prod(shape))
        return self.pool[place : place + size].reshape(shape, order="F")


class NativeKernel:
    """A part of a `NativeProgram` (a `Kernel`): what it reads and writes are the same arrays."""

    def __init__(self, program: NativeProgram, function: Any) -> None:
        self._program = program  # the arrays live as long as their kernel
        self.inputs = self.outputs = program.variables
        self.given = self.found = program.pool
        function.argtypes, function.restype = (ctypes.c_void_p,), None
        self._function, self._address = function, program._address

    def __call__(self) -> None:
        """Compute the outputs from the inputs."""
        self._function(self._address)
