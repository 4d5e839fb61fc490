"""Execution of batches by compiled code or the interpreter; filters over recorded runs.

Compiled code uses lanes times threads. The interpreter takes run after run: slow, and the reference
for compiled code. Its noise equals that of `native/noise.h`: Philox4x32-10 with the seed as its
key. The counter is the pair of numbers, the stream, the step and the run, so that no draw depends
on another.

References
----------
Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from homeward.lab.engine.batch.job import (
    MAX_BELIEF,
    Job,
    Result,
    empty_result,
    job_of,
    shaped,
)
from homeward.lab.engine.native.library import Library
from homeward.lab.engine.native.source import Source, choose, source_of
from homeward.lab.engine.program import OBSERVE, Machine, filter_program
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.filters.settings import Engine

_Long = ctypes.c_int64
_Pointer = ctypes.c_void_p
CHUNKS_PER_THREAD = 8
"""More chunks than threads, so that one slow run does not leave the other threads without work."""
_COUNTS = ("start", "series", "draws", "guarded", "sums", "final", "history")


class _Job(ctypes.Structure):
    _fields_ = [
        *((k, _Long) for k in ("runs", "steps", "first", "stop")),
        *((f"n_{k}", _Long) for k in _COUNTS),
        ("seed", ctypes.c_uint64),
        ("largest", ctypes.c_double),
        *((k, _Pointer) for k in (*_COUNTS, "samples", "stopped", "diverged")),
    ]


def source(job: Job) -> Source:
    """Return the C of a job: doubles for one run, lanes for more."""
    return source_of(job.program, job.runs == 1, tuple(job.extra.items()))


def _compiled(job: Job, result: Result, library: Library, threads: int) -> None:
    """Run a job by the compiled code of its source."""
    batch = library.functions.homeward_batch
    batch.argtypes, batch.restype = (ctypes.c_void_p, _Long, _Long), ctypes.c_int32
    description, alive = _described(job, result, source(job).places)
    blocks = -(-job.runs // library.lanes)
    chunk = max(1, -(-blocks // (threads * CHUNKS_PER_THREAD))) * library.lanes
    spans = [(k, min(k + chunk, job.runs)) for k in range(0, job.runs, chunk)]

    def compute(span: tuple[int, int]) -> int:
        return int(batch(ctypes.byref(description), *span))

    if threads == 1 or len(spans) == 1:
        codes = list(map(compute, spans))
    else:
        with ThreadPoolExecutor(threads) as pool:
            codes = list(pool.map(compute, spans))
    del alive
    if any(codes):
        raise MemoryError("not enough memory for the lanes of a batch")


def _described(
    job: Job, result: Result, places: Mapping[str, int]
) -> tuple[_Job, list[np.ndarray]]:
    """Return a job as the structure of the C loop, and the arrays to which it points."""
    tables: dict[str, list[tuple[int, ...]]] = {
        "start": [_given(places[k], v) for k, v in job.start.items()],
        "series": [_given(places[k], v) for k, v in job.series.items()],
        "draws": [
            (places[d.name], job.size(d.name), places[d.scale], int(d.normal), d.stream)
            for d in job.draws
        ],
        "guarded": [(places[k], job.size(k), 0) for k in job.guarded],
        "sums": _outputs(result.sums, places),
        "final": _outputs(result.final, places),
        "history": _outputs(result.history, places),
    }
    description = _Job(
        runs=job.runs,
        steps=job.steps,
        first=job.first_run,
        stop=-1 if job.stop is None else places[job.stop],
        seed=job.seed,
        largest=MAX_BELIEF,
        samples=result.samples.ctypes.data,
        stopped=result.stopped.ctypes.data,
        diverged=result.diverged.ctypes.data,
    )
    alive = []
    for name, rows in tables.items():
        table = np.array(rows, np.int64)  # the structures of loop.c: integers and addresses
        setattr(description, f"n_{name}", len(rows))
        setattr(description, name, table.ctypes.data)
        alive.append(table)
    return description, alive


def _given(place: int, values: np.ndarray) -> tuple[int, ...]:
    """Return place, size, address, and strides by run and by step."""
    runs, steps, size = values.shape
    by_run = steps * size if runs > 1 else 0
    return place, size, values.ctypes.data, by_run, size if steps > 1 else 0


def _outputs(arrays: Mapping[str, np.ndarray], places: Mapping[str, int]) -> list[tuple[int, ...]]:
    """Return place, size and address of each."""
    return [(places[k], a.shape[-1], a.ctypes.data) for k, a in arrays.items()]


_LOW = np.uint64(0xFFFFFFFF)
_32 = np.uint64(32)


def philox(counter: np.ndarray, seed: int) -> np.ndarray:
    """Return 4 words of 32 random bits, uint64 (4, ...), for each counter (4, ...) of words."""
    a, b, c, d = counter
    key = np.array([seed & 0xFFFFFFFF, seed >> 32], np.uint64)
    for _ in range(10):
        left, right = a * np.uint64(0xD2511F53), c * np.uint64(0xCD9E8D57)
        a, b = (right >> _32) ^ b ^ key[0], right & _LOW
        c, d = (left >> _32) ^ d ^ key[1], left & _LOW
        key = (key + np.array([0x9E3779B9, 0xBB67AE85], np.uint64)) & _LOW
    return np.stack([a, b, c, d])


def uniforms(seed: int, run: int, step: int, stream: int, size: int) -> np.ndarray:
    """Return numbers in [0, 1), shape (size,), of one stream at one step of one run."""
    pairs = np.arange((size + 1) // 2, dtype=np.uint64)
    counter = np.zeros((4, pairs.size), np.uint64)
    counter[0] = np.uint64(stream << 16) + pairs
    counter[1], counter[2], counter[3] = step, run & 0xFFFFFFFF, run >> 32
    words = philox(counter, seed)
    bits = (words[0::2] << _32 | words[1::2]) >> np.uint64(12) | np.uint64(0x3FF0000000000000)
    numbers: np.ndarray = bits.T.copy().view(np.float64).reshape(-1)[:size] - 1.0
    return numbers


def normals(seed: int, run: int, step: int, stream: int, size: int) -> np.ndarray:
    """Return standard normal numbers, shape (size,), of one stream at one step of one run."""
    u = uniforms(seed, run, step, stream, size + size % 2).reshape(-1, 2)
    radius = np.sqrt(-2.0 * np.log(1.0 - u[:, 0]))
    angle = 2.0 * np.pi * u[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1).reshape(-1)[:size]


class _Batch:
    """A job, and the machine that computes its runs one after the other."""

    def __init__(self, job: Job) -> None:
        self._job, self._machine = job, Machine(job.program, job.extra)
        self._now = {k: v.reshape(-1, order="F") for k, v in self._machine.variables.items()}

    def run(self, run: int, result: Result) -> None:
        job = self._job
        for array in self._now.values():
            array[:] = 0.0
        for name, values in job.start.items():
            self._now[name][:] = values[run % len(values), 0]
        for k in range(job.steps + 1):
            self._machine.do(OBSERVE)
            if self._ended(run, k, result) or k == job.steps:
                return
            self._take(run, k)
            self._machine.do()

    def _ended(self, run: int, k: int, result: Result) -> bool:
        """Store a sample; return whether the run ends with it."""
        job, now = self._job, self._now
        if not sum(float(np.abs(now[name]).sum()) for name in job.guarded) < MAX_BELIEF:
            result.diverged[run] = 1
            return True
        result.samples[run] = k + 1
        for name in job.sums:
            result.sums[name][run] += now[name]
        for name in job.final:
            result.final[name][run] = now[name]
        for name in job.history:
            result.history[name][run, k] = now[name]
        result.stopped[run] = job.stop is not None and now[job.stop][0] != 0.0
        return bool(result.stopped[run])

    def _take(self, run: int, k: int) -> None:
        """Set the variables that change with the step."""
        job, now = self._job, self._now
        for name, values in job.series.items():
            now[name][:] = values[run % len(values), k]
        for draw in job.draws:
            where = (job.seed, job.first_run + run, k, draw.stream, job.size(draw.name))
            scale = now[draw.scale]
            now[draw.name][:] = normals(*where) * scale if draw.normal else uniforms(*where) < scale


def _interpreted(job: Job, result: Result) -> None:
    """Run a job."""
    batch = _Batch(job)
    with np.errstate(all="ignore"):
        for run in range(job.runs):
            batch.run(run, result)


SAVED_S = 1e-4
"""Time that compiled code saves in each step of each run [s]."""
SLOWER = "which takes 50 to 500 times as long"


def execute(job: Job, engine: Engine = "auto", threads: int | None = None) -> Result:
    """Run a job; the result depends neither on threads nor on the size of the batch.

    By default it uses all available threads.
    """
    saved = SAVED_S * job.runs * job.steps
    library, notes = choose(engine, saved, partial(source, job), SLOWER)
    result = empty_result(job)
    result.engine, result.notes = "interpreter" if library is None else "native", notes
    if library is None:
        _interpreted(job, result)
    else:
        _compiled(job, result, library, threads or available_threads())
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
    engine: Engine = "auto",
    threads: int | None = None,
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
    engine, threads
        See `homeward.lab.engine.batch.execution.execute`.

    Raises
    ------
    ValueError
        For an unknown variable or a wrong shape.
    """
    program = filter_program(kind)
    job = job_of(program, given, _with_mask(series), runs, steps, history, final)
    return execute(job, engine, threads)


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
