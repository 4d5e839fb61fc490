"""Homing laws with moved landmarks, limited visibility and noise: `python -m benchmarks.laws`.

The paper's scene (seven landmarks 1 to 2 m from home, start 0.75 m away), with random headings and
directions in each of `--runs`. Laws that use bearings have an exact compass and no memory; laws
that use a pose have that of the robust localiser, with a start prior of 5 cm and 0.1 rad.
"""

import math
from typing import Any

import numpy as np

from benchmarks import monte_carlo
from benchmarks.monte_carlo import Run
from homeward.control.laws import LAWS, STOP_RADIUS
from homeward.lab.simulation.simulate import load_scenario, prepare, simulate
from homeward.registry import make_estimator
from homeward.runs.report.files import markdown

HOME_M = 2 * STOP_RADIUS  # maximum true distance at home [m]
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
    given = monte_carlo.parsed(__doc__, runs=100, laws=dict(LAWS), **monte_carlo.HARNESS)
    runs = monte_carlo.grid(list(CONDITIONS), given.laws, range(given.runs))
    found = monte_carlo.run_all(measured, runs, given.jobs, given.keep)
    print(
        f"{given.runs} runs each: share that ends within {HOME_M:g} m of home; median and 95 % of "
        "the final\ndistance; median of path over straight line, of those at home\n"
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
