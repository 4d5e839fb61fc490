"""Which kernels execute a filter."""

from __future__ import annotations

from homeward.engine.generic import GenericPredict, GenericUpdate
from homeward.engine.interpreter import Interpreter
from homeward.engine.kernel import Kernel
from homeward.filters.ekf import ExtendedKalmanFilter
from homeward.filters.steps import predict_function, update_function

UNROLLED_UP_TO = 48
"""States: up to here an unrolled step is built within half a second and runs faster."""


def filter_kernels(kind: ExtendedKalmanFilter) -> tuple[Kernel, Kernel]:
    """Return (predict, update) for a filter, unrolled where that pays."""
    if kind.model.n > UNROLLED_UP_TO:
        return GenericPredict(kind), GenericUpdate(kind)
    return Interpreter(predict_function(kind)), Interpreter(update_function(kind))
