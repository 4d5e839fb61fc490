"""Batches by the chosen engine; and a filter over recorded runs, many at once."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from homeward.lab.engine.batch import compiled, interpreted
from homeward.lab.engine.batch.job import Job, Result, empty_result, given_values, shaped
from homeward.lab.engine.cuda import execution as cuda
from homeward.lab.engine.native.source import choose
from homeward.lab.engine.program.stages import filter_program
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.filters.settings import Engine

BatchEngine = Engine | Literal["cuda"]
"""What executes a batch; cuda: an NVIDIA GPU, for which nothing else stands in."""
Precision = Literal["double", "single"]
"""Of a GPU. single: about ten times as fast; a run that rounding may have spoilt is computed again
in doubles, and the others differ from doubles in the fifth digit or so."""

SAVED_S = 1e-4
"""What compiled code saves in each step of each run [s]."""
SLOWER = "which takes 50 to 500 times as long"


def execute(
    job: Job,
    engine: BatchEngine = "auto",
    threads: int | None = None,
    precision: Precision = "double",
) -> Result:
    """Run a job; the result depends neither on threads nor on the size of the batch.

    None stands for as many threads as this process may use. Engines other than cuda compute in
    doubles. Raises `CudaError` when a GPU is asked for and there is none, or it cannot do the job.
    """
    if engine == "cuda":
        return shaped(job, cuda.execute(job, single=precision == "single"))

    def native() -> Result:
        result, count = empty_result(job), threads or available_threads()
        result.notes = compiled.execute(job, result, compiled.source(job), count)
        result.engine = "native"
        return result

    saved = SAVED_S * job.runs * job.steps
    made, notes = choose(engine, saved, lambda: compiled.source(job), native, SLOWER)
    if made is not None:
        return shaped(job, made)
    result = empty_result(job)
    interpreted.execute(job, result)
    result.engine, result.notes = "interpreter", notes
    return shaped(job, result)


def available_threads() -> int:
    """Return how many processors this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


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
        `homeward.lab.filters.ekf` (state, covariance, active, stored, dt, ...): one value for
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
    start = tuple(given_values(k, v, known[k], runs) for k, v in given.items())
    each = tuple(given_values(k, v, known[k], runs, steps) for k, v in series.items())
    job = Job(program, runs, steps, start, each, tuple(final), tuple(history))
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
