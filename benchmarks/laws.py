"""Homing laws against landmarks moved, visibility and noise: `python -m benchmarks.laws`.

The paper's scene (seven landmarks 1 to 2 m from home, start 0.75 m away), from headings and
directions drawn anew in each run. Laws by bearings have an exact compass, and no memory; laws on a
pose have that of the robust localiser, which is told a start prior of 5 cm and 0.1 rad.
"""

from __future__ import annotations

import argparse
import math
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np

from homeward.control.laws import LAWS, STOP_RADIUS
from homeward.registry import make_estimator
from homeward.simulation.files import load_scenario
from homeward.simulation.simulate import prepare, simulate

HOME_M = 2 * STOP_RADIUS
"""Truly nearer than this is home."""
CONDITIONS: dict[str, dict[str, Any]] = {
    "nothing moved": {},
    "one of seven moved": {"moved.count": 1},
    "two moved": {"moved.count": 2},
    "three moved": {"moved.count": 3},
    "seen with 40 %": {"visibility.probability": 0.4},
    "field of view 120 deg": {"visibility.field_of_view": math.radians(120)},
    "noise 0.1 rad": {"noise.bearing_sigma": 0.1},
    "start 3 m away": {"start.R": 3.0},
    "turn rate at most 0.3 rad/s": {"trajectory.max_turn_rate": 0.3},
}
BASE = {"moved.count": 0, "noise.bearing_sigma": 0.02, "trajectory.duration": 90}


def one(law: str, condition: str, seed: int) -> tuple[float, float]:
    """Return the true distance from home at the end [m], and path length over the straight one."""
    rng = np.random.default_rng([seed, 7])
    theta, alpha = rng.uniform(-math.pi, math.pi, 2).tolist()
    start = {"start.theta": theta, "start.alpha": alpha}
    changes = BASE | start | CONDITIONS[condition] | {"seed": seed, "trajectory.law": law}
    if LAWS[law] is None:
        changes["estimator"] = "robust"
    scenario = load_scenario("paper-homing", changes)
    steering = None if LAWS[law] else make_estimator("robust", prepare(scenario))
    simulation = simulate(scenario, steering)
    truth = simulation.drive.truth
    assert truth is not None
    path = float(np.hypot(np.diff(truth.x), np.diff(truth.y)).sum())
    return simulation.final_distance, path / float(np.hypot(truth.x[0], truth.y[0]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--laws", nargs="+", choices=LAWS, default=list(LAWS))
    arguments = parser.parse_args()
    laws = arguments.laws
    print(
        f"{arguments.runs} runs each; home: share that truly ends within {HOME_M:g} m of it; median"
    )
    print("and 95 % of the distance there; median path over the straight line, of those at home\n")
    print("| | " + " | ".join(laws) + " |\n|---|" + "---|" * len(laws))
    with ProcessPoolExecutor(arguments.workers) as pool:
        for condition in CONDITIONS:
            cells = []
            for law in laws:
                jobs = [pool.submit(one, law, condition, seed) for seed in range(arguments.runs)]
                ended, path = np.array([job.result() for job in jobs]).T
                home = ended < HOME_M
                far = np.quantile(ended, [0.5, 0.95])
                ratio = f"{np.median(path[home]):.2f}" if home.any() else "-"
                cells.append(f"{home.mean():.0%}, {far[0]:.2f} and {far[1]:.2f} m, {ratio}")
            print(f"| {condition} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
