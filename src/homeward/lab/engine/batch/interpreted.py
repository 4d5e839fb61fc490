"""Batches by the interpreter, run after run: slow, and the reference for the native engine.

The noise equals that of `native/noise.h`: Philox4x32-10 with the seed as its key. The counter is
the pair of numbers, the stream, the step and the run, so that no draw depends on another.

References
----------
Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
"""

from __future__ import annotations

import numpy as np

from homeward.lab.engine.batch.job import MAX_BELIEF, Job, Result
from homeward.lab.engine.program.stages import OBSERVE, Machine

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
        for given in job.start:
            self._now[given.name][:] = given.values[run % len(given.values), 0]
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
        for given in job.series:
            now[given.name][:] = given.values[run % len(given.values), k]
        for draw in job.draws:
            where = (job.seed, job.first_run + run, k, draw.stream, job.size(draw.name))
            scale = now[draw.scale]
            now[draw.name][:] = normals(*where) * scale if draw.normal else uniforms(*where) < scale


def execute(job: Job, result: Result) -> None:
    """Run a job."""
    batch = _Batch(job)
    with np.errstate(all="ignore"):
        for run in range(job.runs):
            batch.run(run, result)
