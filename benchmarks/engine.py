"""The compiled engine and FilterPy.

`python -m benchmarks.engine [--quick] [--gate] [--update-baseline]` prints medians and ratios of
one run, in which FilterPy and homeward alternate; both must first agree on the same trajectory.
Times are processor time, except for two threads and whole processes. `--gate` fails if a ratio is
below half of that in engine_baseline.json.
"""

import json
import sys
from pathlib import Path

import numpy as np

from benchmarks import monte_carlo, timing
from benchmarks.peers.filterpy_ekf import FilterPyFilter
from benchmarks.peers.scene import GUARD, Scene, given, make_scene, series
from homeward.lab.engine.batch.execution import run_recorded
from homeward.lab.engine.batch.homing import run_homing
from homeward.lab.engine.native.source import NativeProgram
from homeward.lab.engine.program import filter_program
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.filters.settings import Engine
from homeward.lab.model import PolarModel

BASELINE = Path(__file__).with_name("engine_baseline.json")
AGREE = 1e-6
STEPS = 2400
REST_S = 0.05  # pause between bursts on two cores, to reduce the effect of other processes
EKF = ExtendedKalmanFilter(PolarModel(7, guard=GUARD))


def main() -> None:
    options = monte_carlo.parsed(__doc__, quick=False, gate=False, update_baseline=False)
    ratios = measure(5 if options.quick else 15, options.quick)
    if options.update_baseline:
        BASELINE.write_text(json.dumps(ratios, indent=2) + "\n", encoding="utf-8")
    if options.gate:
        sys.exit(timing.gate(ratios, json.loads(BASELINE.read_text(encoding="utf-8"))))


def measure(rounds: int, quick: bool) -> dict[str, float]:
    scene = make_scene(STEPS)
    agreement(make_scene(600) if quick else scene)
    ratios = one_run(scene, rounds)
    ratios |= many_runs(scene, rounds, quick)
    threads(rounds)
    closed_loops(rounds)
    timing.start_up(3)
    return ratios


def recorded(scene: Scene, engine: Engine = "native") -> np.ndarray:
    """Return homeward's estimates over a recorded run, in one call."""
    values = given(scene)
    result = run_recorded(EKF, values, series(scene), runs=1, steps=scene.steps, engine=engine)
    assert result.engine == engine, result.notes
    return np.asarray(result.history["state"][0, 1:])


def agreement(scene: Scene) -> None:
    """Print the differences from the compiled filter on one trajectory."""
    ours, peer = recorded(scene), FilterPyFilter(scene)
    others = {"interpreter": recorded(scene, "interpreter")}
    others["FilterPy"] = np.array([peer.step(k).copy() for k in range(scene.steps)])
    print(f"largest difference from homeward over {scene.steps} samples:")
    for name, track in others.items():
        worst = float(np.abs(track - ours).max())
        print(f"  {name:12} {worst:.1e}")
        if not worst < AGREE:
            sys.exit(f"{name} does not agree")


def one_run(scene: Scene, rounds: int) -> dict[str, float]:
    """Time single runs: one call per sample, and one call per run."""
    program = NativeProgram(filter_program(EKF))
    values = program.variables
    for name, value in given(scene).items():
        values[name][...] = value
    control, bearings, mask, state = (values[k] for k in ("control", "bearings", "mask", "state"))

    def online(k: int) -> np.ndarray:
        control[:], bearings[:], mask[:] = scene.control[k], scene.bearings[k], scene.mask[k]
        program.do()
        return state.copy()

    timed = {
        "recorded": lambda: timing.clock(lambda: recorded(scene)) / scene.steps,
        "online": timing.per_sample(online, 120),
        "FilterPy": timing.per_sample(FilterPyFilter(scene).step, 60),
    }
    taken = timing.in_turns(timed, rounds)
    print("\none run, microseconds per sample (median), and speed relative to FilterPy (median):")
    for name, times in taken.items():
        relative = timing.ratio(taken, "FilterPy", name)
        print(f"  {name:12} {1e6 * np.median(times):8.2f} {relative:8.1f}")
    found = {f"{k} / FilterPy": timing.ratio(taken, "FilterPy", k) for k in ("online", "recorded")}
    timing.goal("online, speed over FilterPy", found["online / FilterPy"], 60)
    timing.goal("recorded run, speed over FilterPy", found["recorded / FilterPy"], 150)
    return found


def many_runs(scene: Scene, rounds: int, quick: bool) -> dict[str, float]:
    """Time many simultaneous runs on one core."""
    short, runs = make_scene(100 if quick else 400), 512
    bearings, peer = many(short, runs), FilterPyFilter(scene)
    taken = timing.in_turns(
        {
            "FilterPy": timing.per_sample(peer.step, 60),
            "batch": lambda: timing.clock(lambda: ours(short, bearings, 1)) / (runs * short.steps),
        },
        rounds,
    )
    print("\nmany runs, filter steps per second and core (median of rounds):")
    for name in ("batch", "FilterPy"):
        print(f"  {name:12} {1 / np.median(taken[name]):12,.0f}")
    found = {"batch / FilterPy": timing.ratio(taken, "FilterPy", "batch")}
    flags = Path("/proc/cpuinfo")
    wide = flags.exists() and "avx512dq" in flags.read_text(encoding="utf-8")
    timing.goal("many runs, speed over FilterPy", found["batch / FilterPy"], 800 if wide else 400)
    return found


def threads(rounds: int) -> None:
    short = make_scene(100)
    bearings = many(short, 1024)
    taken = timing.in_turns(
        {
            "one": lambda: timing.wall(lambda: ours(short, bearings, 1)),
            "two": lambda: timing.wall(lambda: ours(short, bearings, 2)),
        },
        4 * rounds,
        rest=REST_S,
    )
    best = min(taken["one"]) / min(taken["two"])
    print(f"\ntwo cores against one, wall time (best of {4 * rounds} bursts; {timing.busy()}):")
    timing.goal("speed of two cores over one", best, 1.8)
    alone = min(timing.clock(lambda: ours(short, bearings, 1)) for _ in range(rounds))
    shared = min(timing.longest_thread(lambda: ours(short, bearings, 2)) for _ in range(rounds))
    print(f"  by processor time, on two idle cores: {alone / shared:.2f}")


def many(scene: Scene, runs: int) -> np.ndarray:
    """Return the bearings of a scene with new noise for every run, (runs, steps, q)."""
    noise = np.random.default_rng(5).normal(size=(runs, *scene.bearings.shape))
    return scene.bearings + 0.01 * noise


def ours(scene: Scene, bearings: np.ndarray, count: int) -> np.ndarray:
    result = run_recorded(
        EKF,
        given(scene),
        {**series(scene), "bearings": bearings},
        runs=len(bearings),
        steps=scene.steps,
        history=(),
        engine="native",
        threads=count,
    )
    return result.final["state"]


def closed_loops(rounds: int) -> None:
    """Time complete homing runs, each with its own noise, layout and initial estimate."""
    runs, steps, q = 1024, 120, 7
    rng = np.random.default_rng(3)
    angles = 2 * np.pi * np.arange(q) / q + rng.uniform(-0.3, 0.3, (runs, q))
    distance = rng.uniform(1, 2, (runs, q, 1))
    state = np.zeros((runs, 10))
    state[:, :3] = [0.75, -0.872, 0.349] + rng.normal(size=(runs, 3)) * [0.05, 0.1, 0.1]
    values = given(make_scene(1)) | {
        "landmarks": distance * np.stack([np.cos(angles), np.sin(angles)], axis=-1),
        "stored": angles + (np.arange(q) < 2) * rng.uniform(-0.3, 0.3, (runs, q)),
        "pose": [0.75 * np.cos(-0.872), 0.75 * np.sin(-0.872), 0.349],
        "state": state,
        "active": 0.0,
        "speed": 0.125,
        "stop_radius": 0.0,
        "bearing_sigma": 0.02,
        "disturbance_sigma": [0.01, 0.02],
        "visibility": 5 / 7,
    }

    def home() -> None:
        run_homing(EKF, values, runs=runs, steps=steps, engine="native", threads=2)

    taken = timing.in_turns({"home": lambda: timing.wall(home)}, 4 * rounds, rest=REST_S)["home"]
    used = min(timing.clock(home) for _ in range(rounds))
    print("\nclosed loops of 120 samples without an early stop, wall time, two threads:")
    print(f"  median {runs / np.median(taken):,.0f} per second, best {runs / taken.min():,.0f}")
    print(f"  by processor time, on two idle cores: {2 * runs / used:,.0f} per second")
    timing.goal("complete homing runs per second (best)", runs / float(taken.min()), 10_000)


if __name__ == "__main__":
    main()
