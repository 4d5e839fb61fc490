"""A filter over recorded runs: many at once, or one whole drive in one call."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from homeward.lab.engine.batch.execution import BatchEngine, Precision, execute
from homeward.lab.engine.batch.job import Job, Result, given_values
from homeward.lab.engine.program.stages import filter_program
from homeward.lab.filters.ekf import ExtendedKalmanFilter


def run_recorded(
    kind: ExtendedKalmanFilter,
    given: Mapping[str, ArrayLike],
    series: Mapping[str, ArrayLike],
    *,
    runs: int,
    steps: int,
    final: Sequence[str] = ("state", "covariance"),
    history: Sequence[str] = ("state",),
    engine: BatchEngine = "auto",
    threads: int | None = None,
    precision: Precision = "double",
) -> Result:
    """Run a filter over what was recorded: at each step, predict and then update.

    Parameters
    ----------
    kind : ExtendedKalmanFilter
        The filter.
    given : mapping of str to array_like
        What does not change, and the belief at the start, by the names of
        `homeward.lab.filters.belief` (state, covariance, active, stored, dt, ...): one value for
        all runs, or with a leading axis of runs. What is in neither mapping is zero.
    series : mapping of str to array_like
        What changes from step to step (control, bearings, mask, ...): (steps, ...) for all runs, or
        (runs, steps, ...). Where a bearing is NaN or its mask 0, nothing was seen; without a mask,
        every other bearing was. A step without any only predicts.
    runs, steps : int
        Their numbers.
    final, history : sequence of str
        Variables to return at the end, and at every sample; the first sample is the start.
    engine, threads, precision
        See `homeward.lab.engine.batch.execution.execute`.

    Raises
    ------
    ValueError
        For a name that the filter does not have, or a shape that does not fit.
    """
    program, series = filter_program(kind), _seen(series)
    known = program.shapes
    for name in (*given, *series, *final, *history):
        if name not in known:
            raise ValueError(f"{name}: the filter has no such variable")
    job = Job(
        program=program,
        runs=runs,
        steps=steps,
        start=tuple(given_values(k, v, known[k], runs) for k, v in given.items()),
        series=tuple(given_values(k, v, known[k], runs, steps) for k, v in series.items()),
        final=tuple(final),
        history=tuple(history),
    )
    return execute(job, engine, threads, precision)


def _seen(series: Mapping[str, ArrayLike]) -> dict[str, ArrayLike]:
    """Return the series with a mask, and with a number for every bearing."""
    if "bearings" not in series:
        return dict(series)
    bearings = np.asarray(series["bearings"], float)
    if np.isfinite(bearings.sum()):
        return {"mask": np.ones(bearings.shape[-1]), **series}
    there = np.isfinite(bearings)
    mask = there * np.asarray(series.get("mask", 1.0), float)
    return {**series, "bearings": np.where(there, bearings, 0.0), "mask": mask}
