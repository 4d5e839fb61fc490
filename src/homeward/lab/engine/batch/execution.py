"""Execution of batches by the chosen engine, and filters over many recorded runs at once."""

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
"""Executor of a batch. cuda: an NVIDIA GPU, without fallback."""
Precision = Literal["double", "single"]
"""Precision on a GPU. single is about ten times as fast: a run that rounding may have spoilt is
computed again in doubles; the others differ from doubles in about the fifth digit."""

SAVED_S = 1e-4
"""Time that compiled code saves in each step of each run [s]."""
SLOWER = "which takes 50 to 500 times as long"


def execute(
    job: Job,
    engine: BatchEngine = "auto",
    threads: int | None = None,
    precision: Precision = "double",
) -> Result:
    """Run a job; the result depends neither on threads nor on the size of the batch.

    By default it uses all available threads. Engines other than cuda compute in doubles. Raises
    `CudaError` when cuda is requested without a GPU, or the GPU cannot run the job.
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
    """Return the number of processors that this process may use."""
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
    """Run a filter over recorded inputs: at each step, predict and then update.

    Parameters
    ----------
    kind : ExtendedKalmanFilter
        The filter.
    given : mapping of str to array_like
        Constants and the initial belief, by the names of `homeward.lab.filters.ekf` (state,
        covariance, active, stored, dt, ...): one value for all runs, or with a leading axis of
        runs. Variables in neither mapping are zero.
    series : mapping of str to array_like
        Inputs of each step (control, bearings, mask, ...): (steps, ...) for all runs, or
        (runs, steps, ...). A landmark is out of view where its bearing is NaN or its mask 0. A step
        without bearings only predicts.
    runs, steps : int
        Number of runs, and of steps in each.
    final, history : sequence of str
        Variables to return at the end, and at every sample; the first sample is the start.
    engine, threads, precision
        See `homeward.lab.engine.batch.execution.execute`.

    Raises
    ------
    ValueError
        For an unknown variable or a wrong shape.
    """
    program, series = filter_program(kind), _with_mask(series)
    known = program.shapes
    for name in (*given, *series, *final, *history):
        if name not in known:
            raise ValueError(f"{name}: the filter has no such variable")
    start = tuple(given_values(k, v, known[k], runs) for k, v in given.items())
    each = tuple(given_values(k, v, known[k], runs, steps) for k, v in series.items())
    job = Job(program, runs, steps, start, each, tuple(final), tuple(history))
    return execute(job, engine, threads, precision)


def _with_mask(series: Mapping[str, ArrayLike]) -> dict[str, ArrayLike]:
    """Return the series with a mask, and with finite bearings."""
    if "bearings" not in series:
        return dict(series)
    bearings = np.asarray(series["bearings"], float)
    if np.isfinite(bearings.sum()):
        return {"mask": np.ones(bearings.shape[-1]), **series}
    there = np.isfinite(bearings)
    mask = there * np.asarray(series.get("mask", 1.0), float)
    return {**series, "bearings": np.where(there, bearings, 0.0), "mask": mask}
