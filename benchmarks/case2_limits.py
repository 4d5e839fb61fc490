"""Case 2 beyond its goals: small faults, random layouts, three moved, homing on own estimates.

`python -m benchmarks.case2_limits [--seeds 100] [--part small random three homing]`. Which moved
landmarks are named is told against how far their fault stands out: |fault| over the standard
deviation of the home bearing as predicted from everything else.
"""

from __future__ import annotations

import argparse
from itertools import pairwise

import numpy as np

from benchmarks.case2 import bound, final_error, scenario
from homeward.localizer.localizer import Localizer
from homeward.registry import make_estimator
from homeward.simulation.course import Ending
from homeward.simulation.scenario import Moved, Ring, Scenario
from homeward.simulation.simulate import prepare, simulate

PARTS = {
    "small": ("2 faults of 0.05 to 0.2 rad", {"moved": Moved(count=2, fault=(0.05, 0.2))}),
    "random": (
        "landmarks at random round home, 2 moved",
        {"moved": Moved(count=2), "landmarks": Ring(jitter=np.pi)},
    ),
    "three": ("3 moved", {"moved": Moved(count=3)}),
}
EDGES = (0.0, 1.0, 2.0, 4.0, 8.0, np.inf)
FAILURE = 4.0
"""A pose farther off than so many standard deviations, its status said to be localised."""


def changed(seed: int, changes: dict[str, object]) -> Scenario:
    """Return Case 2 with changes."""
    return scenario(seed, 0).model_copy(update=changes)


def limits(title: str, changes: dict[str, object], seeds: int) -> None:
    """Print how far the localiser gets with a change of Case 2."""
    right, squares, errors, prominence, named = [], [], [], [], []
    failures = 0
    for seed in range(seeds):
        run = simulate(changed(seed, changes))
        localizer = Localizer(run.drive.home, **run.drive.settings.robot)
        error, covariance = final_error(run.drive, localizer)
        moved = {m.landmark for m in localizer.landmarks() if m.moved}
        right.append(moved == set(run.world.moved))
        squares.append(error[:2] @ np.linalg.solve(bound(run)[:2, :2], error[:2]) / 2)
        errors.append(error[:2] @ error[:2])
        failures += bool(error @ np.linalg.solve(covariance, error) > FAILURE**2)
        sigmas = localizer.chart.home.bearing_sigmas()
        for name in run.world.moved:
            if name in sigmas:
                fault = run.world.fault[run.world.ids.index(name)]
                prominence.append(abs(fault) / sigmas[name])
                named.append(name in moved)
    set_right = np.array(right)
    squared = np.array(squares)
    of_right = np.sqrt(np.nanmean(squared[set_right]))
    print(
        f"{title}, {seeds} seeds: right set {set_right.mean():.3f}, "
        f"RMSE of all {np.sqrt(np.nanmean(errors)):.4f} m, "
        f"ratio to the bound {np.sqrt(np.nanmean(squared)):.2f}, "
        f"with the right set {of_right:.2f}; "
        f"beyond {FAILURE:g} sigma {failures / seeds:.3f}"
    )
    bins = np.digitize(prominence, EDGES) - 1
    for i, (low, high) in enumerate(pairwise(EDGES)):
        mine = np.array(named)[bins == i]
        if mine.size:
            print(f"  |fault| / sigma {low:g} to {high:g}: {mine.mean():.2f} of {mine.size} named")


def homing(seeds: int) -> None:
    """Print where the robot ends when its own estimates steer it; 1 moved."""
    print(f"homing on their own estimates, 1 moved, {seeds} seeds: distance from home at the end")
    for name in ("robust", "ekf", "a-ekf", "pi-ekf"):
        distances, ended = [], 0
        for seed in range(seeds):
            case = scenario(seed, 1).model_copy(update={"estimator": name})
            run = simulate(case, make_estimator(name, prepare(case)))
            distances.append(100.0 * run.final_distance)
            ended += run.ending is Ending.DONE
        off = np.array(distances)
        print(
            f"  {name:7} median {np.median(off):.1f} cm, 90 % {np.quantile(off, 0.9):.1f} cm, "
            f"worst {off.max():.1f} cm; within 5 cm {np.mean(off < 5.0):.2f}; "
            f"said to be home {ended}",
            flush=True,
        )


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--part", nargs="*", default=[*PARTS, "homing"])
    options = parser.parse_args()
    for part in options.part:
        if part == "homing":
            homing(options.seeds)
        else:
            limits(*PARTS[part], options.seeds)


if __name__ == "__main__":
    main()
