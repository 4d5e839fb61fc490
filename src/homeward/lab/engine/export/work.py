"""How much an exported filter computes at most: known from the symbols and from the loops' bounds.

The formulas follow templates/homeward_ekf.c; a test compiles that with numbers that count.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from math import comb
from typing import NamedTuple

from homeward.lab.engine.export.source import STRETCHES, block_lines, step_lines
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.filters.settings import FilterSettings
from homeward.lab.model import PolarModel

MOST_STEPS = 11
"""Of one call, however long the gap: a second in steps of 0.1 s, and the rest in one."""


class Work(NamedTuple):
    """Operations of one call."""

    arithmetic: int
    """+, -, * and /."""
    functions: int
    """Calls of libm."""

    def __add__(self, other: Work) -> Work:  # type: ignore[override]
        """Return both together."""
        return Work(self[0] + other[0], self[1] + other[1])

    def __rmul__(self, times: int) -> Work:  # type: ignore[override]
        """Return it so many times."""
        return Work(times * self[0], times * self[1])


WRAP = Work(4, 1)


def of_lines(lines: Iterable[str]) -> Work:
    """Return the work of generated lines."""
    text = "\n".join(lines)
    arithmetic = len(re.findall(r" [-+*/] |v_inverse", text))
    return Work(
        arithmetic, len(re.findall("v_(?:ceil|sqrt|atan2)", text)) + 2 * text.count("turn(")
    )


def most_work(q: int, settings: FilterSettings) -> dict[str, Work]:
    """Return what the functions of an exported EKF of `q` landmarks compute at most.

    Returns
    -------
    dict of str to Work
        ``odometry`` and ``bearings`` with one step of prediction, as at rates of 10 Hz and more;
        ``odometry, longest`` after any gap; ``solve`` of the resection.
    """
    step = step_lines(
        ExtendedKalmanFilter(PolarModel(q, guard=settings.guard), settings.integration)
    )
    n, clock = q + 3, Work(5, 0)
    predict = (
        of_lines(step.shared) + q * of_lines(step.own) + Work(124 + 51 * q + 9 * q * n - 18 * q, 0)
    )
    update = q * (Work(12, 0) + 2 * WRAP + Work(n * n + 4 * n, 0))
    return {
        "odometry": clock + predict,
        "odometry, longest": clock + MOST_STEPS * predict,
        "bearings": clock + predict + update,
        "solve": _solve(q),
    }


def _solve(q: int) -> Work:
    look, relative = (of_lines(block_lines(k)) for k in ("look", "relative"))
    misfit = look + Work(11, 0) + WRAP
    astray = relative + Work(3, 0) + WRAP
    judged = astray + Work(27, 0) + q * (misfit + Work(3, 0))
    inverted, solved = Work(29, 0), Work(14, 0)

    def refined(marks: int) -> Work:
        return astray + Work(108 + 18, 0) + inverted + marks * (misfit + Work(27, 0))

    meeting = STRETCHES * Work(21, 2) + solved + Work(12, 0)
    nearer = STRETCHES * (look + Work(15, 0) + WRAP) + solved + Work(2, 0)
    located = meeting + 9 * nearer + Work(6, 0)
    search = judged + comb(q, 3) * (3 * refined(3) + judged)
    rounds = 4 * (judged + 4 * refined(q)) + judged
    answer = relative + Work(94, 0) + q * (misfit + Work(1, 0))
    return inverted + q * located + search + rounds + answer
