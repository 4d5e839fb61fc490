"""Homing laws against landmarks moved, visibility and noise: `python -m benchmarks.laws`.

The paper's scene (seven landmarks 1 to 2 m from home, start 0.75 m away), from headings and
directions drawn anew in each run. Laws by bearings have an exact compass, and no memory; laws on a
pose have that of the robust localiser, which is told a start prior of 5 cm and 0.1 rad.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks import monte_carlo
from benchmarks.monte_carlo import Run
from homeward.control.laws import LAWS, STOP_RADIUS
from homeward.lab.simulation.simulate import load_scenario, prepare, simulate
from homeward.registry import make_estimator
from homeward.runs.report.files import markdown

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


def measured(run: Run) -> dict[str, float]:
    """Return the true distance from home at the end [m], and path length over the straight one."""
    condition, law, seed = run
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
    straight = float(np.hypot(truth.x[0], truth.y[0]))
    return {"end": simulation.final_distance, "path": path / straight}


def main() -> None:
    parser = monte_carlo.parser(__doc__, keep=True)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--laws", nargs="+", choices=LAWS, default=list(LAWS))
    given = parser.parse_args()
    runs = monte_carlo.grid(list(CONDITIONS), given.laws, range(given.runs))
    found = monte_carlo.run_all(measured, runs, given.jobs, given.keep)
    print(
        f"{given.runs} runs each; home: share that truly ends within {HOME_M:g} m of it; median "
        "and 95 % of the\ndistance there; median path over the straight line, of those at home\n"
    )
    table = [["", *given.laws]]
    for condition in CONDITIONS:
        table.append([condition])
        for law in given.laws:
            each = [one for run, one in found.items() if run[:2] == (condition, law)]
            ended, path = (monte_carlo.column(each, name) for name in ("end", "path"))
            home = ended < HOME_M
            far = np.quantile(ended, [0.5, 0.95])
            ratio = f"{np.median(path[home]):.2f}" if home.any() else "-"
            table[-1].append(f"{home.mean():.0%}, {far[0]:.2f} and {far[1]:.2f} m, {ratio}")
    print(markdown(table, left=len(table[0])))


if __name__ == "__main__":
    main()
