"""NumPy 1.26, which ROS 2 Jazzy's Python modules need, gets what homeward uses of NumPy 2."""

from __future__ import annotations

from typing import Any

import numpy as np


def _vecdot(a: Any, b: Any) -> Any:
    """Return the dot products along the last axis, the first one conjugated."""
    return np.einsum("...i,...i", np.conj(a), b)


if not hasattr(np, "vecdot"):
    setattr(np, "vecdot", _vecdot)  # noqa: B010
