"""Closed homing loops on an NVIDIA GPU: agreement with the processor; speed against it and JAX.

`python -m benchmarks.gpu [--quick]` prints for 7, 20 and 50 landmarks the differences between
doubles and the native engine, and between floats and doubles; and steps per second (a step: one
sample of world, filter and score) by the GPU's clock and in wall time. Each run has its own layout.
"""

import os
import time
from collections.abc import Callable

import numpy as np

from benchmarks import monte_carlo
from homeward.lab.engine.batch.homing import HomingResult, run_homing
from homeward.lab.engine.cuda.device import CudaError, gpu
from homeward.lab.filters.ekf import ExtendedKalmanFilter, ProportionalIntegralFilter, augmented_ekf
from homeward.lab.model import PolarModel

STEPS = 400
SEED = 1


def scene(kind: ExtendedKalmanFilter, runs: int, seed: int = SEED) -> dict[str, object]:
    """Return homing from 0.75 m with the first landmark moved, a layout for each run."""
    q, n, rng = kind.model.q, kind.model.n, np.random.default_rng(seed)
    angles = 2 * np.pi * np.arange(q) / q + rng.uniform(-0.3, 0.3, (runs, q))
    distances = rng.uniform(1, 2, (runs, q, 1))
    stored = angles + 0.3 * (np.arange(q) == 0)
    state = np.zeros((runs, n))
    state[:, :3] = [0.75, -0.872, 0.349] + rng.normal(size=(runs, 3)) * [0.05, 0.1, 0.1]
    state[:, 3 + q :] = stored[:, list(kind.model.estimated)]
    given: dict[str, object] = {
        "pose": [0.75 * np.cos(-0.872), 0.75 * np.sin(-0.872), 0.349],
        "landmarks": distances * np.stack([np.cos(angles), np.sin(angles)], axis=-1),
        "stored": stored,
        "state": state,
        "covariance": np.diag([0.05**2, 0.1**2, 0.1**2, *np.ones(q), *np.full(n - 3 - q, 0.04)]),
        "speed": 0.125,
        "dt": 0.05,
        "input_covariance": np.diag([0.01**2, 0.02**2]),
        "variance": 0.02**2,
        "bearing_sigma": 0.02,
        "visibility": 0.7,
        "stop_radius": 0.05,
    }
    if kind.integral:
        given |= {"proportional": 1e-3 * np.eye(n), "integral_gain": np.full((n, q), 0.01)}
    return given


def run(kind: ExtendedKalmanFilter, runs: int, **how: object) -> tuple[HomingResult, float]:
    given, begin = scene(kind, runs), time.perf_counter()
    result = run_homing(kind, given, runs=runs, steps=STEPS, seed=SEED, **how)
    return result, time.perf_counter() - begin


def agreement(quick: bool) -> None:
    """Print the differences between doubles on the GPU and the native engine."""
    print("\ndoubles, GPU against processor: runs of another length; difference at the end")
    kinds = {"ekf, q = 7": (ExtendedKalmanFilter(PolarModel(7)), 20_000)}
    kinds["a-ekf, q = 7"] = augmented_ekf(7), 5_000
    kinds["pi-ekf, q = 7"] = ProportionalIntegralFilter(PolarModel(7)), 5_000
    if not quick:
        kinds["ekf, q = 20"] = ExtendedKalmanFilter(PolarModel(20)), 500
        kinds["ekf, q = 50"] = ExtendedKalmanFilter(PolarModel(50)), 100
    for name, (kind, runs) in kinds.items():
        ours, _ = run(kind, runs, engine="cuda")
        theirs, _ = run(kind, runs, engine="native")
        same = (ours.samples == theirs.samples) & ~ours.diverged & ~theirs.diverged
        off = np.where(same, np.abs(ours.state - theirs.state).max(axis=1), np.inf)
        print(
            f"  {name:14} {np.count_nonzero(~same)} of {runs}; median {np.median(off):.0e}, "
            f"99 % {np.quantile(off, 0.99):.0e}, within 1e-9: {np.mean(off < 1e-9):.2%}"
        )


def floats(runs: int) -> None:
    """Print the differences of the distributions between floats and doubles."""
    kind = ExtendedKalmanFilter(PolarModel(7))
    doubles, _ = run(kind, runs, engine="cuda")
    singles, _ = run(kind, runs, engine="cuda", precision="single")
    print(f"\nfloats and doubles, q = 7, {runs:,} runs")
    print(
        f"  repeated in doubles {singles.again}, diverged {np.sum(singles.diverged)}"
        f" (doubles {np.sum(doubles.diverged)})"
    )
    for name, a, b in (
        *(
            (f"RMSE of {k}", singles.rmse[:, i], doubles.rmse[:, i])
            for i, k in enumerate(("R", "theta", "alpha"))
        ),
        ("NEES", singles.nees, doubles.nees),
    ):
        quantiles = [0.5, 0.95, 0.99]
        x, y = np.quantile(a, quantiles), np.quantile(b, quantiles)
        print(
            f"  {name:13} 50, 95, 99 %: "
            + "  ".join(f"{p:.5g} {q:.5g}" for p, q in zip(x, y, strict=True))
        )


def speed(quick: bool) -> dict[str, float]:
    """Print steps per second; return those of q = 7 by precision."""
    found = {}
    print("\nmillion steps/s: GPU's clock, wall time; homings/s")
    sizes = {7: 4_000_000, 20: 200_000, 50: 20_000}
    for q, runs in sizes.items():
        kind, runs = ExtendedKalmanFilter(PolarModel(q)), runs // (10 if quick else 1)
        for precision in ("double", "single"):
            how = {"engine": "cuda", "precision": precision}
            run(kind, 1000, **how)
            best, wall = min((run(kind, runs, **how) for _ in range(3)), key=lambda x: x[0].seconds)
            steps = best.samples.sum() - runs
            rate = steps / best.seconds
            print(
                f"  q = {q:2} {precision:6} {rate / 1e6:8.1f} {steps / wall / 1e6:8.1f} "
                f"{runs / best.seconds:12,.0f}"
            )
            if q == 7:
                found[precision] = rate
    kind, runs = ExtendedKalmanFilter(PolarModel(7)), 20_000
    run(kind, 100, engine="native", threads=1)
    best, wall = run(kind, runs, engine="native", threads=1)
    print(f"  q =  7 one core of this processor {(best.samples.sum() - runs) / wall / 1e6:8.2f}")
    return found


def jax_peer(ours: dict[str, float], runs: int) -> None:
    """Print the speed of the same loop in JAX on the same GPU."""
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    try:
        import jax

        from benchmarks.peers.jax_homing import homing
    except ImportError:
        print("\nJAX is not installed")
        return
    jax.config.update("jax_enable_x64", True)
    print(f"\nJAX {jax.__version__} on {jax.devices()[0].device_kind}, {runs:,} runs of 120 steps")
    given = scene(ExtendedKalmanFilter(PolarModel(7)), 1)
    one = {k: np.asarray(v)[0] if k in ("landmarks", "stored") else v for k, v in given.items()}
    for precision, kind in (("double", np.float64), ("single", np.float32)):
        typed = {k: np.asarray(v, kind) for k, v in one.items()}
        start = np.repeat(np.asarray(given["state"], kind), runs, axis=0)
        keys = jax.random.split(jax.random.key(0), runs)
        loop: Callable = homing(typed, 120, 0.01)
        states = jax.device_put(start)
        jax.block_until_ready(loop(keys, states))
        times = []
        for _ in range(3):
            begin = time.perf_counter()
            jax.block_until_ready(loop(keys, states))
            times.append(time.perf_counter() - begin)
        rate = runs * 120 / min(times)
        print(
            f"  {precision} {rate / 1e6:.1f} million steps/s: "
            f"homeward is {ours[precision] / rate:.0f} times as fast"
        )


def main() -> None:
    quick = monte_carlo.parsed(__doc__, quick=False).quick
    try:
        print(gpu().name)
    except CudaError as error:
        raise SystemExit(f"no GPU: {error}") from None
    agreement(quick)
    floats(100_000 if quick else 1_000_000)
    jax_peer(speed(quick), 20_000 if quick else 200_000)


if __name__ == "__main__":
    main()
