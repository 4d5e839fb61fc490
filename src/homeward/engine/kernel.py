"""The one shape that everything executable has, whichever engine made it."""

from __future__ import annotations

from typing import Protocol

import numpy as np


class Kernel(Protocol):
    """A function with arrays of its own for what goes in and what comes out.

    Fill `inputs` in place, call, read `outputs`.
    """

    inputs: dict[str, np.ndarray]
    outputs: dict[str, np.ndarray]

    def __call__(self) -> None:
        """Compute the outputs from the inputs."""
