"""The one shape that everything executable has, whichever engine made it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

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
