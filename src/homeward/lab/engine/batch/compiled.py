"""Batches in compiled code: lanes times threads."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from homeward.lab.engine.batch.job import MAX_BELIEF, Given, Job, Result
from homeward.lab.engine.native.source import Source, source_of
from homeward.native.library import load

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


def execute(job: Job, result: Result, code: Source, threads: int) -> tuple[str, ...]:
    """Run a job, and return notes on its compilation; `NativeError` when that fails."""
    library = load(code.text)
    batch = library.functions.homeward_batch
    batch.argtypes, batch.restype = (ctypes.c_void_p, _Long, _Long), ctypes.c_int32
    description, alive = _described(job, result, code.places)
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
    return library.notes


def _described(
    job: Job, result: Result, places: Mapping[str, int]
) -> tuple[_Job, list[np.ndarray]]:
    """Return a job as the structure of the C loop, and the arrays to which it points."""
    tables: dict[str, list[tuple[int, ...]]] = {
        "start": [_given(g, places) for g in job.start],
        "series": [_given(g, places) for g in job.series],
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


def _given(given: Given, places: Mapping[str, int]) -> tuple[int, ...]:
    """Return place, size, address, and strides by run and by step."""
    runs, steps, size = given.values.shape
    by_run = steps * size if runs > 1 else 0
    place = places[given.name]
    return place, size, given.values.ctypes.data, by_run, size if steps > 1 else 0


def _outputs(arrays: Mapping[str, np.ndarray], places: Mapping[str, int]) -> list[tuple[int, ...]]:
    """Return place, size and address of each."""
    return [(places[k], a.shape[-1], a.ctypes.data) for k, a in arrays.items()]
