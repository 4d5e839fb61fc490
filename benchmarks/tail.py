"""How often each of the paper's filters ends far from home: a figure that takes a GPU.

`python -m benchmarks.tail [--runs 100000000] [--out FILE.png]` lets each filter home from 0.75 m in
layouts of its own for every run, the first landmark moved by 0.3 rad, and counts how many runs are
farther from home at their end (20 s at most) than a distance, with 95 % intervals (Clopper and
Pearson). Floats; the first two million runs are held against doubles.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.gpu import STEPS, scene
from homeward.engine.batch.homing import HomingResult, run_homing
from homeward.engine.cuda.device import CudaError, gpu
from homeward.filters.augmented import augmented_ekf
from homeward.filters.ekf import ExtendedKalmanFilter
from homeward.filters.proportional_integral import ProportionalIntegralFilter
from homeward.model import PolarModel

CHUNK = 2_000_000
LIMITS_M = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0)
KINDS = {
    "ekf": ExtendedKalmanFilter(PolarModel(7)),
    "a-ekf": augmented_ekf(7),
    "pi-ekf": ProportionalIntegralFilter(PolarModel(7)),
}


def chunk(kind: ExtendedKalmanFilter, first: int, runs: int, precision: str) -> HomingResult:
    """Return runs from number `first` on: layouts and noise are their own."""
    given, n = scene(kind, runs, seed=1 + first), kind.model.n
    if kind.integral:  # as printed: Pi = 0.05 I with R in cm, M = ones
        given["proportional"] = np.diag([0.05e-2, *np.full(n - 1, 0.05)])
        given["integral_gain"] = np.ones((n, kind.model.q))
    how = {"steps": STEPS, "seed": 1, "first_run": first, "engine": "cuda", "precision": precision}
    return run_homing(kind, given, runs=runs, **how)


def interval(count: int, runs: int) -> tuple[float, float]:
    """Return Clopper's and Pearson's 95 % interval of a share."""
    from scipy.stats import beta

    low = 0.0 if count == 0 else float(beta.ppf(0.025, count, runs - count + 1))
    return low, float(beta.ppf(0.975, count + 1, runs - count))


def main() -> None:
    """Print the table, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100_000_000)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    try:
        print(f"{gpu().name}, {options.runs:,} runs of each filter")
    except CudaError as error:
        raise SystemExit(f"no GPU: {error}") from None
    rows = {name: counted(name, kind, options.runs) for name, kind in KINDS.items()}
    print("share that ends farther from home than:")
    for name, counts in rows.items():
        for limit, count in zip(LIMITS_M, counts.tolist(), strict=True):
            low, high = interval(count, options.runs)
            share = count / options.runs
            print(f"  {name:6} {limit:.1f} m  {share:.3e}  [{low:.3e}, {high:.3e}]")
    if options.out is not None:
        draw(rows, options.runs, options.out)


def counted(name: str, kind: ExtendedKalmanFilter, runs: int) -> np.ndarray:
    """Return how many runs end farther from home than each of `LIMITS_M`."""
    counts, seconds, again, lost = np.zeros(len(LIMITS_M), np.int64), 0.0, 0, 0
    begin = time.perf_counter()
    for first in range(0, runs, CHUNK):
        some = min(CHUNK, runs - first)
        found = chunk(kind, first, some, "single")
        # A run that diverged did not come home.
        distance = np.where(found.diverged, np.inf, found.final_distance)
        counts += (distance[:, None] > LIMITS_M).sum(axis=0)
        seconds, again, lost = (
            seconds + found.seconds,
            again + found.again,
            lost + found.diverged.sum(),
        )
        if first == 0:
            doubles, floats = chunk(kind, 0, some, "double").final_distance > 0.5, distance > 0.5
            print(
                f"  {name}: beyond 0.5 m in the first {some:,}: doubles {doubles.sum()}, "
                f"floats {floats.sum()}, both {np.sum(doubles & floats)}"
            )
        if sys.stderr.isatty():
            print(f"\r{name} {first + some:,}", end="", file=sys.stderr)
    print(
        f"  {name}: {seconds:.1f} s of the GPU, {time.perf_counter() - begin:.0f} s in all, "
        f"{again} computed again in doubles, {lost} diverged",
        flush=True,
    )
    return counts


def draw(rows: dict[str, np.ndarray], runs: int, file: Path) -> None:
    """Draw the shares over the distance, with their intervals."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    for name, counts in rows.items():
        share = counts / runs
        ends = np.array([interval(int(c), runs) for c in counts]).T
        seen = counts > 0
        bars = np.abs(ends - share)[:, seen]
        axes.errorbar(np.array(LIMITS_M)[seen], share[seen], bars, marker="o", ms=3, label=name)
    axes.set(xscale="log", yscale="log", xlabel="distance from home at the end [m]")
    axes.set(ylabel="share of runs farther off", title=f"{runs:,} homings of each filter")
    axes.set_xticks(LIMITS_M, [str(limit) for limit in LIMITS_M])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(file, dpi=150)


if __name__ == "__main__":
    main()
