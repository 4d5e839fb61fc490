"""A batch by the engine that was chosen."""

from __future__ import annotations

import os
from typing import Literal

from homeward.lab.engine.batch import compiled, interpreted
from homeward.lab.engine.batch.job import Job, Result, empty_result, shaped
from homeward.lab.engine.choice import choose
from homeward.lab.engine.cuda import execution as cuda
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
    """Run a job; what comes out depends neither on threads nor on the size of the batch.

    Parameters
    ----------
    job : Job
        What to run.
    engine : {"auto", "interpreter", "native", "cuda"}
        See `homeward.lab.filters.settings.Engine` and `BatchEngine`.
    threads : int, optional
        Of the processor; None: as many as this process may use.
    precision : {"double", "single"}
        See `Precision`; the other engines compute in doubles.

    Raises
    ------
    CudaError
        When a GPU is asked for and there is none, or it cannot do the job.
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
