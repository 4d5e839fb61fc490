"""CasADi functions in as many digits as one likes, where floats cannot tell a rank."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import mpmath
import numpy as np
from numpy.typing import ArrayLike

DIGITS = 60
ZERO_DIGITS = 30
"""In so many digits of a pivot there is nothing."""

_OPERATIONS: dict[int, Callable[..., Any]] = {
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b,
    ca.OP_NEG: lambda a, _: -a,
    ca.OP_SQ: lambda a, _: a * a,
    ca.OP_TWICE: lambda a, _: 2 * a,
    ca.OP_INV: lambda a, _: 1 / a,
    ca.OP_SIN: lambda a, _: mpmath.sin(a),
    ca.OP_COS: lambda a, _: mpmath.cos(a),
    ca.OP_SQRT: lambda a, _: mpmath.sqrt(a),
    ca.OP_ASSIGN: lambda a, _: a,
}


def evaluate(function: ca.Function, arguments: Sequence[ArrayLike]) -> list[list[Any]]:
    """Run the operations of a function of SX one by one, on numbers of `DIGITS` digits.

    Parameters
    ----------
    function : casadi.Function
        Of SX, with one dense output, made of sums, products, quotients, sines, cosines and roots.
    arguments : sequence of array_like, each of shape (k,)
        Its inputs, which are taken as exact.

    Returns
    -------
    list of lists of mpf
        The output, row by row.
    """
    rows, columns = function.size_out(0)
    numbers = [np.asarray(a, float).tolist() for a in arguments]
    work: dict[int, Any] = {}
    out: list[Any] = [mpmath.mpf(0)] * (rows * columns)
    with mpmath.workdps(DIGITS):
        for k in range(function.n_instructions()):
            kind = function.instruction_id(k)
            sources, targets = function.instruction_input(k), function.instruction_output(k)
            if kind == ca.OP_CONST:
                work[targets[0]] = mpmath.mpf(function.instruction_constant(k))
            elif kind == ca.OP_INPUT:
                work[targets[0]] = mpmath.mpf(numbers[sources[0]][sources[1]])
            elif kind == ca.OP_OUTPUT:
                out[targets[1]] = work[sources[0]]
            else:
                first, last = work[sources[0]], work[sources[-1]]
                work[targets[0]] = _OPERATIONS[kind](first, last)
    return [out[row::rows] for row in range(rows)]


def precise_rank(matrix: list[list[Any]]) -> int:
    """Return the rank by elimination with full pivoting; rows must be of similar size."""
    with mpmath.workdps(DIGITS):
        rest = [list(row) for row in matrix]
        limit = mpmath.mpf(10) ** -ZERO_DIGITS * max(abs(v) for row in rest for v in row)
        found = 0
        while rest:
            size, i, j = max(
                (abs(v), i, j) for i, row in enumerate(rest) for j, v in enumerate(row)
            )
            if size <= limit:
                break
            found += 1
            pivot = rest.pop(i)
            for row in rest:
                factor = row[j] / pivot[j]
                row[:] = [a - factor * b for a, b in zip(row, pivot, strict=True)]
        return found
