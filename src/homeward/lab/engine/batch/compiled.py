"""A batch by compiled code: lanes times threads."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from homeward.lab.engine.batch.job import LARGEST, Given, Job, Result
from homeward.lab.engine.native.source import Source, source_of
from homeward.native.library import load

_Long = ctypes.c_int64
_Pointer = ctypes.c_void_p
CHUNKS_PER_THREAD = 8
"""So that one slow run does not leave the other threads without work."""


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
    """Return the C of a job: one run alone on doubles, more of them side by side."""
    return source_of(job.program, job.runs == 1, tuple(job.extra.items()))


def execute(job: Job, result: Result, code: Source, threads: int) -> tuple[str, ...]:
    """Run a job, and return notes on how its code came about.

    Raises `NativeError` when it cannot be compiled.
    """
    library = load(code.text)
    batch = library.functions.homeward_batch
    batch.argtypes, batch.restype = (ctypes.c_void_p, _Long, _Long), ctypes.c_int32
    told, alive = _described(job, result, code.places)
    blocks = -(-job.runs // library.lanes)
    chunk = max(1, -(-blocks // (threads * CHUNKS_PER_THREAD))) * library.lanes
    spans = [(k, min(k + chunk, job.runs)) for k in range(0, job.runs, chunk)]

    def compute(span: tuple[int, int]) -> int:
        return int(batch(ctypes.byref(told), *span))

    if threads == 1 or len(spans) == 1:
        codes = list(map(compute, spans))
    else:
        with ThreadPoolExecutor(threads) as pool:
            codes = list(pool.map(compute, spans))
    del alive
    if any(codes):
        raise MemoryError("no memory for the lanes of a batch")
    return library.notes


def _described(
    job: Job, result: Result, places: Mapping[str, int]
) -> tuple[_Job, list[np.ndarray]]:
    """Return a job as the C loop takes it, and what must live as long as it is used."""
    tables: dict[str, list[tuple[int, ...]]] = {
        "start": [_given(g, places) for g in job.start],
        "series": [_given(g, places) for g in job.series],
        "draws": [
            (places[d.name], job.size(d.name), places[d.scale], int(d.normal), d.stream)
            for d in job.draws
        ],
        "guarded": [(places[k], job.size(k), 0) for k in job.guarded],
        "sums": _kept(result.sums, places),
        "final": _kept(result.final, places),
        "history": _kept(result.history, places),
    }
    told = _Job(
        runs=job.runs,
        steps=job.steps,
        first=job.first_run,
        stop=-1 if job.stop is None else places[job.stop],
        seed=job.seed,
        largest=LARGEST,
        samples=result.samples.ctypes.data,
        stopped=result.stopped.ctypes.data,
        diverged=result.diverged.ctypes.data,
    )
    alive = []
    for name, rows in tables.items():
        table = np.array(rows, np.int64)  # as the structures of loop.c: whole numbers and addresses
        setattr(told, f"n_{name}", len(rows))
        setattr(told, name, table.ctypes.data)
        alive.append(table)
    return told, alive


def _given(given: Given, places: Mapping[str, int]) -> tuple[int, ...]:
    """Return its place, size, address, and how far it is from run to run and step to step."""
    runs, steps, size = given.values.shape
    by_run = steps * size if runs > 1 else 0
    place = places[given.name]
    return place, size, given.values.ctypes.data, by_run, size if steps > 1 else 0


def _kept(arrays: Mapping[str, np.ndarray], places: Mapping[str, int]) -> list[tuple[int, ...]]:
    """Return place, size and address of each."""
    return [(places[k], a.shape[-1], a.ctypes.data) for k, a in arrays.items()]
