"""Functions of angles [rad], on floats, arrays and CasADi symbols."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

TWO_PI = 2.0 * math.pi


def apply(name: str, *values: Any) -> Any:
    """Apply an elementary function to floats, arrays or CasADi symbols.

    `name` is NumPy's: ``"sin"``, ``"hypot"``, ``"arctan2"`` and so on.
    """
    if any(hasattr(value, "is_symbolic") for value in values):
        # Imported here only: symbols exist only where CasADi is loaded already.
        import casadi

        return getattr(casadi, name)(*values)
    return getattr(np, name)(*values)


def wrap(angle: Any) -> Any:
    """Wrap an angle [rad] to (-pi, pi]; an angle within stays bit-identical."""
    if isinstance(angle, float) and math.isfinite(angle):  # same result, much faster
        return angle - TWO_PI * math.ceil((angle - math.pi) / TWO_PI)
    if isinstance(angle, np.ndarray):
        return angle - TWO_PI * np.ceil((angle - math.pi) / TWO_PI)
    return angle - TWO_PI * apply("ceil", (angle - math.pi) / TWO_PI)


def guarded_inverse(x: Any, guard: float) -> Any:
    """Return ``x / (x^2 + guard^2)``: an approximation of ``1/x`` that is finite and smooth at 0.

    Its relative error is ``-guard^2 / (x^2 + guard^2)``: the result is always too small, by half
    at ``x = guard`` and by 1 % at ``x = 10 guard``. The `guard` is in the unit of `x`; 0 gives 1/x.
    """
    return x / (x * x + guard * guard)


def clipped_inverse(x: Any, guard: float) -> Any:
    """Return ``1/x`` with the size of CasADi symbols `x` kept at `guard` or more.

    It is exact outside and discontinuous at 0. The `guard` is in the unit of `x`.
    """
    return 1 / (apply("fmax", x, guard) * (x >= 0) + apply("fmin", x, -guard) * (x < 0))


def interpolate(t: Any, stamps: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Interpolate angles (n,) [rad] linearly along their shorter arcs; return them wrapped, (m,).

    The query times `t` (m,) are within the increasing `stamps` (n,) [s].
    """
    return np.asarray(wrap(np.interp(t, stamps, np.unwrap(angles))))
