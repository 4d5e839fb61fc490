"""How near each engine comes to what this machine can do: flops and bytes of a step, and its peaks.

`python -m benchmarks.roofline` counts the operations of the EKF's step (q = 7, RK4) and the numbers
that it reads and writes from the symbolic graph that the engines are made of; measures the peaks of
one core by a loop of multiply-adds and by a triad, compiled by the same compiler with the same
flags; and prints how much of them each engine reaches. `benchmarks.engine` prints it, too.
"""

from __future__ import annotations

import ctypes
from collections import Counter
from functools import partial
from importlib.resources import files
from typing import NamedTuple

import casadi as ca
import numpy as np

from benchmarks.peers.scene import GUARD, given, make_scene, series
from benchmarks.timing import clock, in_turns
from homeward.engine.batch.recorded import run_recorded
from homeward.engine.native.emit import CIRCULAR, Code
from homeward.engine.native.library import load
from homeward.engine.program.stages import filter_program
from homeward.filters.ekf import ExtendedKalmanFilter
from homeward.model import PolarModel

EKF = ExtendedKalmanFilter(PolarModel(7, guard=GUARD))
FREE = (ca.OP_CONST, ca.OP_INPUT, ca.OP_ASSIGN)
FUNCTIONS = {ca.OP_SIN: 14, ca.OP_COS: 14, ca.OP_ATAN2: 30}
"""Arithmetic in the functions of lanes.h, by counting its lines: a sine and cosine share 28."""
NUMBER = 8
"""Bytes of a double."""
CHAINS, TURNS = 12, 200_000
"""Independent multiply-adds, enough to hide their latency; and how often."""
NEAR, FAR = 1 << 10, 1 << 22
"""Doubles of each array of the triad: all three in the first cache, and in none."""
HALF = 0.5
"""From this share of a peak on, the peak is the limit."""

PEAKS = """
void multiply_add(int64_t turns, double *out) {
  W a[%(chains)d], b = w_set(0.999999), c = w_set(1e-6);
  for (int i = 0; i < %(chains)d; i++) a[i] = w_set(i);
  for (int64_t k = 0; k < turns; k++) {
    %(body)s
  }
  for (int i = 0; i < %(chains)d; i++) *out += a[i][0];
}
void triad(int64_t turns, int64_t n, W *a, const W *b, const W *c) {
  for (int64_t k = 0; k < turns; k++) {
    for (int64_t i = 0; i < n / WIDTH; i++) a[i] = b[i] + 0.5 * c[i];
    __asm__ volatile("" : : "r"(a) : "memory");
  }
}
int32_t homeward_lanes(void) { return WIDTH; }
"""


class Step(NamedTuple):
    """What one step of the filter takes, however it is executed."""

    flops: int
    """+, -, *, / and the arithmetic inside sines, cosines and arc tangents."""
    numbers: int
    """Read and written by the stages."""
    values: int
    """Made on the way: two of them read for each."""


def step() -> Step:
    """Return the work of one step, from the symbolic graph."""
    flops = numbers = values = 0
    for (stage,) in filter_program(EKF).parts.values():
        code = Code(stage.function)
        ops = Counter(node.op for node in code.nodes)
        flops += sum(FUNCTIONS.get(op, int(op not in FREE)) * k for op, k in ops.items())
        numbers += ops[ca.OP_INPUT] + len(code.outputs)
        values += sum(k for op, k in ops.items() if op not in FREE)
        assert all(op in FUNCTIONS for op in CIRCULAR)
    return Step(flops, numbers, values)


class Peaks(NamedTuple):
    """Of one core, measured."""

    vector: float
    """Multiply-adds side by side [flop/s]."""
    near: float
    """A triad in the first cache [byte/s]."""
    far: float
    """The same in memory [byte/s]."""
    lanes: int


def peaks(rounds: int) -> Peaks:
    """Measure the peaks of one core, the best of some rounds."""
    lanes = files("homeward.engine.native").joinpath("lanes.h").read_text(encoding="utf-8")
    body = " ".join(f"a[{i}] = a[{i}] * b + c;" for i in range(CHAINS))
    library = load(lanes + PEAKS % {"chains": CHAINS, "body": body})
    functions, out, long = library.functions, ctypes.c_double(), ctypes.c_int64
    arrays = np.ones(3 * FAR + 8)
    start = arrays.ctypes.data + -arrays.ctypes.data % 64

    def triad(n: int) -> float:
        turns = FAR // n
        places = (ctypes.c_void_p(start + k * n * NUMBER) for k in range(3))
        call = partial(functions.triad, long(turns), long(n), *places)
        return 3 * NUMBER * n * turns / clock(call)

    def chains() -> float:
        call = partial(functions.multiply_add, long(TURNS), ctypes.byref(out))
        return 2 * CHAINS * library.lanes * TURNS / clock(call)

    timed = {
        "vector": chains,
        "near": lambda: triad(NEAR),
        "far": lambda: triad(FAR),
    }
    best = {name: float(found.max()) for name, found in in_turns(timed, rounds).items()}
    return Peaks(**best, lanes=library.lanes)


def roofline(rounds: int) -> None:
    """Print the table."""
    work, most = step(), peaks(rounds)
    scene, runs = make_scene(400), 512
    bearings = scene.bearings + 0.01 * np.random.default_rng(5).normal(
        size=(runs, *scene.bearings.shape)
    )

    def one(engine: str) -> float:
        call = partial(
            run_recorded, EKF, given(scene, EKF), series(scene), runs=1, steps=scene.steps
        )
        return scene.steps / clock(partial(call, history=(), engine=engine))

    def batch() -> float:
        told = {**series(scene), "bearings": bearings}
        call = partial(run_recorded, EKF, given(scene, EKF), told, runs=runs, steps=scene.steps)
        return runs * scene.steps / clock(partial(call, history=(), engine="native", threads=1))

    speeds = in_turns(
        {
            "interpreter": lambda: one("interpreter"),
            "one run": lambda: one("native"),
            "batch": batch,
        },
        rounds,
    )
    print(
        f"\nroofline of one core: {most.vector / 1e9:.1f} Gflop/s in vectors of {most.lanes}; "
        f"{most.near / 1e9:.0f} GB/s from the first cache, {most.far / 1e9:.0f} from memory.\n"
        f"A step (EKF, q = 7, RK4): {work.flops:,} flops; {work.numbers * NUMBER:,} bytes of "
        f"variables, {3 * work.values * NUMBER:,} if every value passes through the cache.\n"
        "Of the peaks in doubles one by one (interpreter, one run), in vectors (batch):\n"
        "                 steps/s  Gflop/s   of peak  cache, at least and most  next limit"
    )
    for name, found in speeds.items():
        fast, width = float(np.median(found)), most.lanes if name == "batch" else 1
        flops, share = fast * work.flops, width / most.lanes
        of_flops = flops / (most.vector * share)
        least, top = (
            fast * numbers * NUMBER / (most.near * share)
            for numbers in (work.numbers, 3 * work.values)
        )
        print(
            f"  {name:12} {fast:10,.0f} {flops / 1e9:8.2f} {of_flops:9.0%} {least:16.0%} {top:8.0%}"
            f"  {_limit(name, of_flops, top)}"
        )


def _limit(name: str, of_flops: float, of_cache: float) -> str:
    """Say what keeps an engine from being faster."""
    if name == "interpreter":
        return "reading instructions"
    if of_flops >= HALF:
        return "arithmetic"
    return "values that registers do not hold" if of_cache >= HALF else "chains of operations"


if __name__ == "__main__":
    roofline(9)
