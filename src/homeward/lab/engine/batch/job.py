"""What a batch computes, and what comes out of it, whichever engine executes it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from homeward.lab.engine.program.stages import Program

LARGEST = 1e9
"""A run has diverged when the numbers in its belief (m, rad, or their squares) add up to more."""


@dataclass(frozen=True)
class Draw:
    """A variable that is drawn anew at every step."""

    name: str
    scale: str
    """The variable that holds its standard deviation, or the probability of a 1."""
    normal: bool
    """Else it is 1 or 0."""
    stream: int
    """Its own number: no draw depends on another."""


@dataclass(frozen=True)
class Given:
    """Values of a variable: (runs or 1, steps or 1, entries), column-major."""

    name: str
    values: np.ndarray


@dataclass(frozen=True)
class Job:
    """Runs of a program that differ in what they are given and in their noise."""

    program: Program
    runs: int
    steps: int
    """Largest number of advances of a run; its samples are one more."""
    start: tuple[Given, ...]
    series: tuple[Given, ...]
    final: tuple[str, ...]
    history: tuple[str, ...]
    extra: Mapping[str, int] = field(default_factory=dict)
    """Variables that no stage has, with their sizes."""
    first_run: int = 0
    """Number of the first run in the noise."""
    seed: int = 0
    draws: tuple[Draw, ...] = ()
    guarded: tuple[str, ...] = ("state", "covariance")
    """Variables that end a run as diverged when they are too large; see `LARGEST`."""
    sums: tuple[str, ...] = ()
    stop: str | None = None
    """A variable that ends a run where it is not 0."""

    def __post_init__(self) -> None:
        if self.runs < 1 or self.steps < 0:
            raise ValueError(f"{self.runs} runs of {self.steps} steps are none")
        if not (0 <= self.seed < 2**64 and 0 <= self.first_run < 2**63 - self.runs):
            raise ValueError("seed and first_run must be in [0, 2^64) and [0, 2^63)")

    def size(self, name: str) -> int:
        """Return the number of entries of a variable."""
        return self.extra[name] if name in self.extra else self.program.size(name)


@dataclass
class Result:
    """What came out of a batch; arrays run over its runs. A run's samples include its start."""

    samples: np.ndarray
    """(runs,), int: samples observed before the run ended or diverged."""
    stopped: np.ndarray
    """(runs,), bool: ended by the program's own word."""
    diverged: np.ndarray
    """(runs,), bool: the belief became too large or no number; its last good sample is kept."""
    sums: dict[str, np.ndarray]
    """(runs, entries), over a run's samples."""
    final: dict[str, np.ndarray]
    """(runs, *shape), at a run's last sample."""
    history: dict[str, np.ndarray]
    """(runs, steps + 1, *shape), NaN after a run's last sample."""
    engine: str = ""
    """What executed it: native, interpreter or cuda."""
    notes: tuple[str, ...] = ()
    """What the user must know of that, each a sentence."""
    seconds: float = 0.0
    """Of a GPU's time [s]."""
    again: int = 0
    """Runs that a GPU computed again in doubles."""


def empty_result(job: Job) -> Result:
    """Return a result to be filled; matrices are flat as yet."""
    return Result(
        samples=np.zeros(job.runs, np.int64),
        stopped=np.zeros(job.runs, np.uint8),
        diverged=np.zeros(job.runs, np.uint8),
        sums={k: np.zeros((job.runs, job.size(k))) for k in job.sums},
        final={k: np.full((job.runs, job.size(k)), np.nan) for k in job.final},
        history={k: np.full((job.runs, job.steps + 1, job.size(k)), np.nan) for k in job.history},
    )


def shaped(job: Job, result: Result) -> Result:
    """Give flat matrices their shape, and flags their type."""
    result.stopped, result.diverged = result.stopped.astype(bool), result.diverged.astype(bool)
    for kept in (result.final, result.history):
        for name, flat in kept.items():
            shape = job.program.shapes.get(name, (job.size(name),))
            square = flat.reshape(*flat.shape[:-1], *reversed(shape))
            kept[name] = np.swapaxes(square, -1, -2) if len(shape) == 2 else square
    return result


def given_values(
    name: str, value: ArrayLike, shape: tuple[int, ...], runs: int, steps: int | None = None
) -> Given:
    """Return a variable's values, for all runs at once or for each: at the start, or at every step.

    They are of its `shape`, (1,) for a number, or broadcast to it, behind an axis of steps, if any;
    or behind one of runs before that. Raises `ValueError` when the shape fits neither.
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
    return Given(name, values if each else values[:, None])


def _broadcast(name: str, array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    if array.shape == shape:  # as most are; a long drive is over before NumPy has broadcast ten
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
