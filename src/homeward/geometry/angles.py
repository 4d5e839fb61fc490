"""Angles in radians, the same functions on floats, arrays and CasADi symbols."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

TWO_PI = 2.0 * math.pi


def apply(name: str, *values: Any) -> Any:
    """Apply an elementary function to floats, arrays or CasADi symbols alike.

    Parameters
    ----------
    name : str
        NumPy's name of the function: ``"sin"``, ``"hypot"``, ``"arctan2"`` and so on.
    *values : float, ndarray or casadi.SX
        Its arguments; symbols if any of them is one.
    """
    if any(hasattr(value, "is_symbolic") for value in values):
        # Imported here alone: whoever has symbols has paid for CasADi already.
        import casadi

        return getattr(casadi, name)(*values)
    return getattr(np, name)(*values)


def wrap(angle: Any) -> Any:
    """Wrap an angle to (-pi, pi].

    Angles already inside come back unchanged to the last bit.

    Parameters
    ----------
    angle : float, ndarray or casadi.SX
        Angle [rad].
    """
    if isinstance(angle, float) and math.isfinite(angle):  # the same, much quicker
        return angle - TWO_PI * math.ceil((angle - math.pi) / TWO_PI)
    if isinstance(angle, np.ndarray):
        return angle - TWO_PI * np.ceil((angle - math.pi) / TWO_PI)
    return angle - TWO_PI * apply("ceil", (angle - math.pi) / TWO_PI)


def guarded_inverse(x: Any, guard: float) -> Any:
    """Return ``x / (x^2 + guard^2)``: ``1/x``, but finite and smooth through zero.

    Its relative error is ``-guard^2 / (x^2 + guard^2)``: the result is always too small, by half
    at ``x = guard`` and by 1 % at ``x = 10 guard``.

    Parameters
    ----------
    x : float, ndarray or casadi.SX
        The divisor.
    guard : float
        In the unit of `x`; zero gives the plain inverse.
    """
    return x / (x * x + guard * guard)


def interpolate(t: Any, stamps: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Interpolate angles linearly along their shorter arcs.

    Parameters
    ----------
    t : array_like, shape (m,)
        Times asked for [s], within `stamps`.
    stamps : ndarray, shape (n,)
        Increasing times [s].
    angles : ndarray, shape (n,)
        Angles at those times [rad].

    Returns
    -------
    ndarray, shape (m,)
        Wrapped angles [rad].
    """
    return np.asarray(wrap(np.interp(t, stamps, np.unwrap(angles))))
