"""The compiled engine beside its peers: plain NumPy, FilterPy, Stone Soup, dynamax and C++ by hand.

`python -m benchmarks.engine [--quick] [--gate] [--update-baseline]` prints medians and ratios of
one run, in which peers and homeward take turns; each peer must first agree with homeward on the
same trajectory. Times are processor time, except where two threads or whole processes are timed.
`--gate` fails where a ratio has fallen below half of the one in engine_baseline.json.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from benchmarks.peers.libraries import FilterPyFilter, StoneSoupFilter, dynamax_batch
from benchmarks.peers.limit import Limit
from benchmarks.peers.plain import PlainFilter, process_noise
from benchmarks.peers.scene import (
    GUARD,
    Scene,
    every_parameter,
    given,
    make_scene,
    series,
)
from benchmarks.timing import (
    busy,
    clock,
    gate,
    goal,
    in_turns,
    longest_thread,
    per_sample,
    ratio,
    start_up,
    wall,
)
from homeward.lab.engine.batch.execution import run_recorded
from homeward.lab.engine.batch.homing import run_homing
from homeward.lab.engine.native.source import NativeProgram
from homeward.lab.engine.program.stages import filter_program
from homeward.lab.filters.ekf import ExtendedKalmanFilter
from homeward.lab.model import PolarModel

BASELINE = Path(__file__).with_name("engine_baseline.json")
AGREE, AGREE_DYNAMAX = 1e-6, 1e-5
STEPS = 2400
REST_S = 0.05
"""Between bursts on two cores, so that others are not crowded out, nor they us."""
EKF = ExtendedKalmanFilter(PolarModel(7, guard=GUARD))


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="under a minute")
    parser.add_argument("--gate", action="store_true", help="fail below the baseline")
    parser.add_argument("--update-baseline", action="store_true")
    options = parser.parse_args()
    ratios = measure(5 if options.quick else 15, options.quick)
    if options.update_baseline:
        BASELINE.write_text(json.dumps(ratios, indent=2) + "\n", encoding="utf-8")
    if options.gate:
        sys.exit(gate(ratios, json.loads(BASELINE.read_text(encoding="utf-8"))))


def measure(rounds: int, quick: bool) -> dict[str, float]:
    """Measure everything, print it, and return the ratios by name."""
    scene, limit = make_scene(STEPS), Limit()
    process = agreement(make_scene(600) if quick else scene, limit)
    ratios = one_run(scene, limit, rounds)
    ratios |= many_runs(scene, process, rounds, quick)
    ratios |= large(rounds)
    threads(rounds)
    closed_loops(rounds)
    start_up(3)
    return ratios


def native(scene: Scene, kind: ExtendedKalmanFilter = EKF) -> np.ndarray:
    """Return homeward's estimates over a recorded run, in one call."""
    result = run_recorded(
        kind, given(scene, kind), series(scene), runs=1, steps=scene.steps, engine="native"
    )
    assert result.engine == "native", result.notes
    return np.asarray(result.history["state"][0, 1:])


def agreement(scene: Scene, limit: Limit) -> np.ndarray:
    """Print how far peers are from homeward on one trajectory; return Gu Q Gu' along it."""
    ours = native(scene)
    slow = run_recorded(
        EKF, given(scene, EKF), series(scene), runs=1, steps=scene.steps, engine="interpreter"
    ).history["state"][0, 1:]
    off = {"interpreter": slow, "C++ limit": limit.run(scene)}
    for name, peer in one_by_one(scene).items():
        off[name] = np.array([stepped(peer, scene, k) for k in range(scene.steps)])
    process = process_noise(scene, ours)
    off["dynamax"] = dynamax_batch(scene, process)(scene.bearings[None])[0]
    print(f"largest difference from homeward over {scene.steps} samples:")
    for name, track in off.items():
        worst = float(np.abs(track - ours).max())
        print(f"  {name:12} {worst:.1e}")
        if not worst < (AGREE_DYNAMAX if name == "dynamax" else AGREE):
            sys.exit(f"{name} does not agree")
    print(
        "  (dynamax is given Gu Q Gu' along the way, which it cannot compute from the state, and\n"
        "  adds 1e-9 to the innovations' covariance: it cannot agree better than to 1e-5)"
    )
    return process


def one_by_one(scene: Scene) -> dict[str, object]:
    """Return the peers that take one sample a call."""
    return {
        "NumPy": PlainFilter(scene),
        "FilterPy": FilterPyFilter(scene),
        "Stone Soup": StoneSoupFilter(scene),
    }


def stepped(peer, scene: Scene, k: int) -> np.ndarray:
    """Give a peer sample k and return its estimate."""
    peer.step(scene.control[k], scene.bearings[k], scene.mask[k])
    return peer.x


def one_run(scene: Scene, limit: Limit, rounds: int) -> dict[str, float]:
    """Time single runs: a call a sample, and a whole run in a call."""
    program = NativeProgram(filter_program(EKF))
    values = program.variables
    for name, value in given(scene, EKF).items():
        values[name][...] = value
    control, bearings, mask, state = (values[k] for k in ("control", "bearings", "mask", "state"))

    def online(k: int) -> np.ndarray:
        control[:], bearings[:], mask[:] = scene.control[k], scene.bearings[k], scene.mask[k]
        program.do()
        return state.copy()

    peers = one_by_one(scene)
    timed = {name: per_sample(lambda k, p=p: stepped(p, scene, k), 60) for name, p in peers.items()}
    timed["online"] = per_sample(online, 120)
    timed["recorded"] = lambda: clock(lambda: native(scene)) / scene.steps
    timed["C++ limit"] = lambda: clock(lambda: limit.run(scene)) / scene.steps
    taken = in_turns(timed, rounds)
    print("\none run, microseconds a sample (median of rounds), and times FilterPy (median ratio):")
    for name, seconds in taken.items():
        print(f"  {name:12} {1e6 * np.median(seconds):8.2f} {ratio(taken, 'FilterPy', name):8.1f}")
    found = {
        "online / FilterPy": ratio(taken, "FilterPy", "online"),
        "recorded / FilterPy": ratio(taken, "FilterPy", "recorded"),
        "recorded / C++ limit": ratio(taken, "C++ limit", "recorded"),
    }
    goal("online, a call a sample: times FilterPy", found["online / FilterPy"], 60)
    goal("recorded run in one call: times FilterPy", found["recorded / FilterPy"], 150)
    goal("recorded run in one call: share of the C++ limit", found["recorded / C++ limit"], 0.5)
    return found


def many_runs(scene: Scene, process: np.ndarray, rounds: int, quick: bool) -> dict[str, float]:
    """Time many runs at once on one core, against FilterPy and dynamax."""
    short = make_scene(100 if quick else 400)
    runs = 512
    bearings = many(short, runs)
    batch = dynamax_batch(short, process[: short.steps])
    small = bearings[:64]
    batch(small)
    peer = FilterPyFilter(scene)
    taken = in_turns(
        {
            "FilterPy": per_sample(lambda k: stepped(peer, scene, k), 60),
            "dynamax": lambda: clock(lambda: batch(small)) / (len(small) * short.steps),
            "batch": lambda: clock(lambda: ours(short, bearings, 1)) / (runs * short.steps),
        },
        rounds,
    )
    print("\nmany runs, filter steps a second and core (median of rounds):")
    for name, seconds in taken.items():
        print(f"  {name:12} {1 / np.median(seconds):12,.0f}")
    found = {
        "batch / FilterPy": ratio(taken, "FilterPy", "batch"),
        "batch / dynamax": ratio(taken, "dynamax", "batch"),
    }
    flags = Path("/proc/cpuinfo")
    wide = flags.exists() and "avx512dq" in flags.read_text(encoding="utf-8")
    goal("many runs: times FilterPy", found["batch / FilterPy"], 800 if wide else 400)
    goal("many runs: times dynamax", found["batch / dynamax"], 30)
    return found


def threads(rounds: int) -> None:
    """Time the same batch on one core and on two, by the wall, in short bursts."""
    short = make_scene(100)
    bearings = many(short, 1024)
    taken = in_turns(
        {
            "one": lambda: wall(lambda: ours(short, bearings, 1)),
            "two": lambda: wall(lambda: ours(short, bearings, 2)),
        },
        4 * rounds,
        rest=REST_S,
    )
    best = min(taken["one"]) / min(taken["two"])
    print(f"\ntwo cores against one, by the wall (best of {4 * rounds} bursts; {busy()}):")
    goal("two cores: times one", best, 1.8)
    alone = min(clock(lambda: ours(short, bearings, 1)) for _ in range(rounds))
    shared = min(longest_thread(lambda: ours(short, bearings, 2)) for _ in range(rounds))
    print(f"  by processor time, two cores to themselves: {alone / shared:.2f}")


def many(scene: Scene, runs: int) -> np.ndarray:
    """Return the bearings of a scene with other noise for every run, (runs, steps, q)."""
    noise = np.random.default_rng(5).normal(size=(runs, *scene.bearings.shape))
    return scene.bearings + 0.01 * noise


def ours(scene: Scene, bearings: np.ndarray, count: int) -> np.ndarray:
    """Return homeward's last estimates of many runs."""
    result = run_recorded(
        EKF,
        given(scene, EKF),
        {**series(scene), "bearings": bearings},
        runs=len(bearings),
        steps=scene.steps,
        history=(),
        engine="native",
        threads=count,
    )
    return result.final["state"]


def closed_loops(rounds: int) -> None:
    """Time complete homing runs with all noise drawn, layouts and first guesses of their own."""
    runs, steps, q = 1024, 120, 7
    rng = np.random.default_rng(3)
    angles = 2 * np.pi * np.arange(q) / q + rng.uniform(-0.3, 0.3, (runs, q))
    distance = rng.uniform(1, 2, (runs, q, 1))
    state = np.zeros((runs, 10))
    state[:, :3] = [0.75, -0.872, 0.349] + rng.normal(size=(runs, 3)) * [0.05, 0.1, 0.1]
    values = given(make_scene(1), EKF) | {
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

    taken = in_turns({"home": lambda: wall(home)}, 4 * rounds, rest=REST_S)["home"]
    used = min(clock(home) for _ in range(rounds))
    print("\nclosed loops of 120 samples that never stop early, by the wall, two threads:")
    print(f"  median {runs / np.median(taken):,.0f} a second, best {runs / taken.min():,.0f}")
    print(f"  by processor time, two cores to themselves: {2 * runs / used:,.0f} a second")
    goal("complete homing runs a second (best)", runs / float(taken.min()), 10_000)


def large(rounds: int) -> dict[str, float]:
    """Time larger filters against plain NumPy: an A-EKF with all parameters, and 50 landmarks."""
    found = {}
    for name, q, parameters in (("A-EKF, n = 17", 7, True), ("EKF, q = 50", 50, False)):
        scene = make_scene(500, q, q * 5 // 7)
        kind = every_parameter(q) if parameters else ExtendedKalmanFilter(PolarModel(q, (), GUARD))
        peer = PlainFilter(scene, parameters)
        track = native(scene, kind)
        off = np.abs(np.array([stepped(peer, scene, k) for k in range(200)]) - track[:200]).max()
        if not off < AGREE:
            sys.exit(f"{name}: NumPy does not agree: {off:.1e}")
        taken = in_turns(
            {
                "NumPy": per_sample(lambda k, p=peer, s=scene: stepped(p, s, 200 + k), 15),
                "ours": lambda s=scene, kind=kind: clock(lambda: native(s, kind)) / s.steps,
            },
            rounds,
        )
        found[f"{name} / NumPy"] = ratio(taken, "NumPy", "ours")
        a, b = (1e6 * np.median(taken[k]) for k in ("NumPy", "ours"))
        print(f"\n{name}: NumPy {a:.0f} us a sample, homeward {b:.2f} us, agreeing to {off:.0e}")
        goal(f"{name}: times NumPy", found[f"{name} / NumPy"], 10)
    return found


if __name__ == "__main__":
    main()
