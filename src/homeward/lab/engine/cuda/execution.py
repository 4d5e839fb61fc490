"""Execution of a batch on a GPU: chunks that fit its memory, and doubles where floats fail."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from typing import Any

import numpy as np

from homeward.lab.engine.batch.job import Given, Job, Result, empty_result
from homeward.lab.engine.cuda.device import Gpu, gpu, loaded_kernel
from homeward.lab.engine.cuda.source import BLOCK, CudaSource, cuda_source

SHARE = 0.8
"""Fraction of the GPU's free memory for a chunk of runs."""


def execute(job: Job, single: bool) -> Result:
    """Run a job, whose program must be `Separable`, on the GPU.

    With `single` it computes in floats, and again in doubles where rounding may have spoilt a run:
    a variance became negative, or the belief too large. Raises `CudaError` when there is no GPU, or
    the kernel cannot run the job.
    """
    device = gpu()
    device.use()
    result = empty_result(job)
    chunk = max(1, int(device.free_bytes() * SHARE) // _bytes_per_run(job, result))
    for first in range(0, job.runs, chunk):
        _execute_chunk(device, job, result, range(first, min(first + chunk, job.runs)), single)
    result.engine = "cuda"
    if result.again:
        result.notes = (f"{result.again} of {job.runs} runs were computed again in doubles.",)
    return result


def _bytes_per_run(job: Job, result: Result) -> int:
    given = [int(g.values[0].nbytes) for g in (*job.start, *job.series) if len(g.values) > 1]
    return sum(given) + sum(int(a[0].nbytes) for a in outputs_of(result).values()) + 8


def outputs_of(result: Result) -> dict[str, np.ndarray]:
    """Return the output arrays by the names of the kernel's pointers."""
    arrays = {k: getattr(result, k) for k in ("samples", "stopped", "diverged")}
    for what, kept in (("sum", result.sums), ("final", result.final), ("history", result.history)):
        arrays |= {f"{what}_{name}": array for name, array in kept.items()}
    return arrays


def _execute_chunk(device: Gpu, job: Job, result: Result, runs: range, single: bool) -> None:
    """Run some of a job's runs."""
    part = replace(
        job,
        runs=len(runs),
        first_run=job.first_run + runs.start,
        start=tuple(_runs_of(g, runs) for g in job.start),
        series=tuple(_runs_of(g, runs) for g in job.series),
    )
    outputs = {k: a[runs.start : runs.stop] for k, a in outputs_of(result).items()}
    doubtful, again = np.zeros(len(runs), np.uint8), np.zeros(0, np.int64)
    with device.arrays() as memory:
        places = {k: memory.blank(a) for k, a in (outputs | {"doubtful": doubtful}).items()}
        places |= {f"given_{g.name}": memory.put(g.values) for g in part.start}
        places |= {f"series_{g.name}": memory.put(g.values) for g in part.series}

        def launch(in_floats: bool, only: np.ndarray) -> float:
            code = cuda_source(part, in_floats)
            kernel = loaded_kernel(device, code.text, BLOCK, code.shared)
            count = only.size or part.runs
            known = places | {"next": memory.put(np.zeros(1, np.int64)), "only": memory.put(only)}
            argument = argument_of(part, code, known | {"runs": count, "selected": only.size})
            return device.launch(kernel, argument, -(-count * code.group // BLOCK))

        result.seconds += launch(single, again)
        if single:
            memory.fetch(places["doubtful"], doubtful)
            again = np.flatnonzero(doubtful)
            if again.size:
                result.seconds += launch(False, again)
                result.again += again.size
        for name, array in outputs.items():
            memory.fetch(places[name], array)
    for run in again:
        for kept in result.history.values():
            kept[runs.start + run, outputs["samples"][run] :] = np.nan


def _runs_of(given: Given, runs: range) -> Given:
    values = given.values if len(given.values) == 1 else given.values[runs.start : runs.stop]
    return Given(given.name, np.ascontiguousarray(values))


def argument_of(job: Job, code: CudaSource, places: dict[str, int]) -> Any:
    """Return the argument structure of the kernel."""
    number = ctypes.c_float if code.constants.dtype == np.float32 else ctypes.c_double
    fields = [*code.fields, ("c", number * code.constants.size)]
    argument = type("_Argument", (ctypes.Structure,), {"_fields_": fields})()
    values = places | {"steps": job.steps, "first": job.first_run}
    for given in job.series:
        runs, steps, size = given.values.shape
        values[f"series_{given.name}_run"] = steps * size if runs > 1 else 0
        values[f"series_{given.name}_step"] = size if steps > 1 else 0
    for name, _ in code.fields:
        setattr(argument, name, _keys(job.seed) if name == "keys" else values[name])
    ctypes.memmove(
        ctypes.addressof(argument) + type(argument).c.offset,
        code.constants.ctypes.data,
        code.constants.nbytes,
    )
    return argument


def _keys(seed: int) -> Any:
    """Return the keys of Philox, two for each of its ten rounds."""
    keys = [
        (half + k * step) % 2**32
        for k in range(10)
        for half, step in ((seed % 2**32, 0x9E3779B9), (seed >> 32, 0xBB67AE85))
    ]
    return (ctypes.c_uint32 * 20)(*keys)
