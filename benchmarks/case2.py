"""The paper's Case 2 with the specified noise: errors at the end of a drive against the bound.

`python -m benchmarks.case2 [--seeds 200] [--part "0 moved" ...]` runs all estimators on the same
drives, which ground truth steers. rho = sqrt(mean(e' B^-1 e) / 2) over the runs with an exact
detection, with B the posterior bound of each run. `--limits` runs parts beyond the paper: small
faults, random layouts, three moved landmarks, each with the detection rate by |fault| over the
standard deviation of the predicted home bearing; and homing on the estimator's own poses.
"""

from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks import monte_carlo
from benchmarks.monte_carlo import Figures, Run, column
from homeward.drives.drive import Drive
from homeward.estimator import Estimator
from homeward.geometry.angles import wrap
from homeward.lab.simulation.course import Ending
from homeward.lab.simulation.scenario import Moved, Ring, Scenario
from homeward.lab.simulation.simulate import PAPER_HOMING, Simulation, prepare, simulate
from homeward.lab.studies.study.trial import simulated_trial
from homeward.localizer.localizer import Localizer
from homeward.registry import make_estimator
from homeward.track import run as follow

HOMING = "homing, 1 moved"
PARTS: dict[str, dict[str, Any]] = {f"{n} moved": {"moved": Moved(count=n)} for n in range(3)}
LIMITS: dict[str, dict[str, Any]] = {
    "2 faults of 0.05 to 0.2 rad": {"moved": Moved(count=2, fault=(0.05, 0.2))},
    "random layout, 2 moved": {"moved": Moved(count=2), "landmarks": Ring(jitter=np.pi)},
    "3 moved": {"moved": Moved(count=3)},
    HOMING: {"moved": Moved(count=1)},
}
ESTIMATORS = ("robust", "ekf", "a-ekf", "pi-ekf")
EDGES = (0.0, 1.0, 2.0, 4.0, 8.0, np.inf)
MAX_SIGMAS = 4.0  # A pose with a larger error is wrong


def scenario(seed: int, moved: int) -> Scenario:
    return PAPER_HOMING.model_copy(update={"seed": seed, "moved": Moved(count=moved)})


def bound(simulation: Simulation) -> np.ndarray:
    """Return the bound at the last bearing stamp of a run, shape (3, 3)."""
    return simulated_trial(simulation).bound[-1]


def final_error(drive: Drive, estimator: Estimator) -> tuple[np.ndarray, np.ndarray]:
    """Replay a drive; return error (3,) and covariance (3, 3) at the last bearing stamp."""
    track, t = follow(drive, estimator), drive.sightings.t[-1]
    k = int(np.searchsorted(track.t, t))
    error = np.array([track.x[k], track.y[k], track.heading[k]]) - np.array(drive.truth.at(t))
    error[2] = wrap(error[2])
    return error, track.covariance[k]


@lru_cache(maxsize=2)
def _drive(part: str, seed: int) -> tuple[Simulation, np.ndarray]:
    made = simulate(PAPER_HOMING.model_copy(update={**(PARTS | LIMITS)[part], "seed": seed}))
    return made, bound(made)


def measured(run: Run) -> Figures:
    part, name, seed = run
    if part == HOMING:
        case = scenario(seed, 1).model_copy(update={"estimator": name})
        made = simulate(case, make_estimator(name, prepare(case)))
        return {"distance": 100.0 * made.final_distance, "done": made.ending is Ending.DONE}
    made, limit = _drive(part, seed)
    estimator = make_estimator(name, made.drive)
    error, covariance = final_error(made.drive, estimator)
    named, moved = {m.landmark for m in estimator.landmarks() if m.moved}, made.world.moved
    home = estimator.chart.home if isinstance(estimator, Localizer) else None
    sigmas = {}
    if home is not None and home.hypotheses is not None:
        variances = home.hypotheses.best.innovations[1]
        sigmas = dict(zip(home.names, np.sqrt(variances).tolist(), strict=True))
    faults = [(abs(fault) / sigmas[i], i in named) for i, fault in moved.items() if i in sigmas]
    return {
        "right": named == set(moved),
        "square": error[:2] @ np.linalg.solve(limit[:2, :2], error[:2]) / 2,
        "error": error[:2] @ error[:2],
        "nees": error @ np.linalg.solve(covariance, error),
        "limit": np.trace(limit[:2, :2]),
        "faults": np.array(faults).reshape(-1, 2),
    }


def row(name: str, runs: list[Figures]) -> str:
    names = ("right", "square", "error", "nees")
    right, square, error, nees = (column(runs, key) for key in names)
    text = f"  {name:8} RMSE of all {_root_mean(error):.4f} m, "
    text += f"ratio to the bound {_root_mean(square):7.3f}"
    if name != "robust":
        return text
    low, high = nees_interval(len(runs))
    good = right == 1.0
    return text + (
        f"; exact detection rate {right.mean():.3f}: rho {_root_mean(square[good]):.3f} (goal "
        f"1.15), RMSE {_root_mean(error[good]):.4f} m; NEES "
        f"{np.nanmean(nees):.2f} (95 %: {low:.2f} "
        f"to {high:.2f}), beyond {MAX_SIGMAS:g} sigma {np.mean(nees > MAX_SIGMAS**2):.3f}; "
        f"without a pose {np.isnan(error).sum()}"
    )


def _root_mean(squares: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(squares)))


def nees_interval(runs: int) -> tuple[float, float]:
    """Return the 95 % interval of the mean of `runs` chi-square(3) values (normal)."""
    half = 1.96 * np.sqrt(6.0 / runs)
    return 3.0 - half, 3.0 + half


def named_by_size(runs: list[Figures]) -> None:
    """Print the detection rate of moved landmarks, by the size of their fault."""
    size, named = np.concatenate([run["faults"] for run in runs]).T
    bins = np.digitize(size, EDGES) - 1
    for i, (low, high) in enumerate(pairwise(EDGES)):
        if (mine := named[bins == i]).size:
            rate = f"{mine.mean():.2f} of {mine.size}"
            print(f"    |fault| / sigma {low:g} to {high:g}: detection rate {rate}")


def homing_row(name: str, runs: list[Figures]) -> str:
    """Return a line about the final distance when the robot's own estimates steer it."""
    off, done = column(runs, "distance"), column(runs, "done")
    return (
        f"  {name:8} distance from home: median {np.median(off):.1f} cm, 90 % "
        f"{np.quantile(off, 0.9):.1f} cm, worst {off.max():.1f} cm; within 5 cm "
        f"{np.mean(off < 5.0):.2f}; home reported {done.sum():.0f}"
    )


def main() -> None:
    parser = monte_carlo.parser(__doc__, seeds=200, limits=False, **monte_carlo.HARNESS)
    parser.add_argument("--part", nargs="*", choices=[*PARTS, *LIMITS])
    options = parser.parse_args()
    parts = options.part or list(LIMITS if options.limits else PARTS)
    seeds = range(options.seeds)
    runs = monte_carlo.grid(parts, ESTIMATORS, seeds)
    found = monte_carlo.run_all(measured, runs, options.jobs, options.keep)
    for part in parts:
        limit = [one["limit"] for run, one in found.items() if run[0] == part and "limit" in one]
        words = f", bound {np.sqrt(np.mean(limit)):.4f} m" if limit else ""
        print(f"{part}, {len(seeds)} seeds{words}")
        for name in ESTIMATORS:
            some = [one for run, one in found.items() if run[:2] == (part, name)]
            print(homing_row(name, some) if part == HOMING else row(name, some))
            if name == "robust" and part in LIMITS and part != HOMING:
                named_by_size(some)


if __name__ == "__main__":
    main()
