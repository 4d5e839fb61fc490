"""Jobs of a batch and their results, for all engines."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from homeward.lab.engine.program import Program

MAX_BELIEF = 1e9
"""A run has diverged when the absolute values in its belief (m, rad, squares) sum to more."""


@dataclass(frozen=True)
class Draw:
    """A random variable of every step."""

    name: str
    scale: str
    """Name of the variable with its standard deviation, or the probability of a 1."""
    normal: bool
    """Whether it is normal; otherwise it is 1 or 0."""
    stream: int
    """Number of its independent random stream."""


@dataclass(frozen=True)
class Job:
    """Runs of a program that differ in their given values and their noise."""

    program: Program
    runs: int
    steps: int
    """Largest number of advances of a run, which has one more sample."""
    start: Mapping[str, np.ndarray]
    """Values at the start, (runs or 1, 1, entries), column-major."""
    series: Mapping[str, np.ndarray]
    """Values at each step, (runs or 1, steps or 1, entries), column-major."""
    final: tuple[str, ...]
    history: tuple[str, ...]
    extra: Mapping[str, int] = field(default_factory=dict)
    """Variables that no stage has, with their sizes."""
    first_run: int = 0
    """Number of the first run, which selects its noise."""
    seed: int = 0
    draws: tuple[Draw, ...] = ()
    guarded: tuple[str, ...] = ("state", "covariance")
    """Variables whose size ends a run as diverged; see `MAX_BELIEF`."""
    sums: tuple[str, ...] = ()
    stop: str | None = None
    """A variable that ends a run where it is not 0."""

    def __post_init__(self) -> None:
        if self.runs < 1 or self.steps < 0:
            raise ValueError(f"runs must be at least 1 and steps 0, not {self.runs}, {self.steps}")
        if not (0 <= self.seed < 2**64 and 0 <= self.first_run < 2**63 - self.runs):
            raise ValueError("seed and first_run must be in [0, 2^64) and [0, 2^63)")

    def size(self, name: str) -> int:
        """Return the number of entries of a variable."""
        return self.extra[name] if name in self.extra else self.program.size(name)


@dataclass
class Result:
    """Results of a batch, one entry per run. The samples of a run include its start."""

    samples: np.ndarray
    """(runs,), int: number of samples before the run ended or diverged."""
    stopped: np.ndarray
    """(runs,), bool: ended by the job's variable `stop`."""
    diverged: np.ndarray
    """(runs,), bool: the belief became too large or NaN; results are of the last good sample."""
    sums: dict[str, np.ndarray]
    """(runs, entries), sums over a run's samples."""
    final: dict[str, np.ndarray]
    """(runs, *shape), at a run's last sample."""
    history: dict[str, np.ndarray]
    """(runs, steps + 1, *shape), NaN after a run's last sample."""
    engine: str = ""
    """Executor: native or interpreter."""
    notes: tuple[str, ...] = ()
    """Sentences about the executor for the user."""


def empty_result(job: Job) -> Result:
    """Return an empty result with flat matrices."""
    return Result(
        samples=np.zeros(job.runs, np.int64),
        stopped=np.zeros(job.runs, np.uint8),
        diverged=np.zeros(job.runs, np.uint8),
        sums={k: np.zeros((job.runs, job.size(k))) for k in job.sums},
        final={k: np.full((job.runs, job.size(k)), np.nan) for k in job.final},
        history={k: np.full((job.runs, job.steps + 1, job.size(k)), np.nan) for k in job.history},
    )


def shaped(job: Job, result: Result) -> Result:
    """Return a result with matrices in shape and flags as bool."""
    result.stopped, result.diverged = result.stopped.astype(bool), result.diverged.astype(bool)
    for kept in (result.final, result.history):
        for name, flat in kept.items():
            shape = job.program.shapes.get(name, (job.size(name),))
            square = flat.reshape(*flat.shape[:-1], *reversed(shape))
            kept[name] = np.swapaxes(square, -1, -2) if len(shape) == 2 else square
    return result


def job_of(
    program: Program,
    given: Mapping[str, ArrayLike],
    series: Mapping[str, ArrayLike],
    runs: int,
    steps: int,
    history: Sequence[str],
    final: Sequence[str],
    extra: Mapping[str, int] | None = None,
    **other: Any,
) -> Job:
    """Return a job with values given by name: constants, and inputs of each step.

    `other` are further fields of `Job`. Raises `ValueError` for an unknown name or a wrong shape.
    """
    extra = extra or {}
    shapes = program.shapes | {name: (size,) for name, size in extra.items()}
    for name in (*given, *series, *final, *history):
        if name not in shapes:
            raise ValueError(f"{name}: there is no such variable")
    start = {k: given_values(k, v, shapes[k], runs) for k, v in given.items()}
    each = {k: given_values(k, v, shapes[k], runs, steps) for k, v in series.items()}
    kept = tuple(final), tuple(history)
    return Job(program, runs, steps, start, each, *kept, extra=extra, **other)


def given_values(
    name: str, value: ArrayLike, shape: tuple[int, ...], runs: int, steps: int | None = None
) -> np.ndarray:
    """Return a variable's values at the start, or at every step where `steps` is given.

    `value` broadcasts to ([runs,] [steps,] *shape), without the last axis for a number of `shape`
    (1,). Raises `ValueError` when it does not.
    """
    array = np.asarray(value, float)
    inner = () if shape == (1,) else shape
    each = () if steps is None else (steps,)
    if steps is None and shape == (1,) and array.ndim and array.shape[-1] == 1:
        array = array[..., 0]
    if array.ndim <= len(each) + len(inner):
        array = _broadcast(name, array, (*each, *inner))[None]
    else:
        array = _broadcast(name, array, (runs, *each, *inner))
    values = _flat(array, 1 + len(each), len(inner))
    return values if each else values[:, None]


def _broadcast(name: str, array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    if array.shape == shape:  # the usual case; broadcasting costs more than a short run
        return array
    try:
        return np.broadcast_to(array, shape)
    except ValueError:
        raise ValueError(f"{name}: shape {array.shape} does not fit {shape}") from None


def _flat(array: np.ndarray, leading: int, inner: int) -> np.ndarray:
    """Return the inner axes flat, column-major, contiguous."""
    columns = np.swapaxes(array, -1, -2) if inner == 2 else array
    size = math.prod(array.shape[leading:])
    return np.ascontiguousarray(columns).reshape(*array.shape[:leading], size)
