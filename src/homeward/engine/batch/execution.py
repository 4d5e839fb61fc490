"""A batch by the engine that was chosen."""

from __future__ import annotations

import os

from homeward.engine.batch import compiled, interpreted
from homeward.engine.batch.job import Job, Result, empty_result, shaped
from homeward.engine.choice import Engine, wants_native, without_native
from homeward.engine.native.compiler import NativeError

COST = "50 to 500 times"
"""What a batch takes longer without compiled code."""


def execute(job: Job, engine: Engine = "auto", threads: int | None = None) -> Result:
    """Run a job; what comes out depends neither on threads nor on the size of the batch.

    Parameters
    ----------
    job : Job
        What to run.
    engine : {"auto", "interpreter", "native"}
        See `homeward.engine.choice`.
    threads : int, optional
        None: as many as this process may use processors.
    """
    result = empty_result(job)
    if engine != "interpreter":
        code = compiled.source(job)
        if wants_native(engine, job.runs * job.steps, code.text):
            try:
                count = threads or available_threads()
                result.notes = compiled.execute(job, result, code, count)
                result.engine = "native"
                return shaped(job, result)
            except NativeError as error:
                result.notes = (without_native(error, COST),)
    interpreted.execute(job, result)
    result.engine = "interpreter"
    return shaped(job, result)


def available_threads() -> int:
    """Return how many processors this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
