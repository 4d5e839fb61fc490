"""The paper's Case 2 with honest noise: errors of all estimators at its end against the bound.

`python -m benchmarks.case2 [--seeds 200] [--moved 0 1 2]`. Truth steers, so that every estimator
gets the same drives. rho = sqrt(mean(e' B^-1 e) / 2) over the runs with the right set, B the
posterior bound of each run's own visibility, noise, moved set and start prior.
"""

from __future__ import annotations

import argparse

import numpy as np

from homeward.angles import wrap
from homeward.drives.drive import Drive
from homeward.estimator import Estimator
from homeward.registry import make_estimator
from homeward.simulation.files import PAPER_HOMING
from homeward.simulation.scenario import Moved, Scenario
from homeward.simulation.simulate import Simulation, simulate
from homeward.studies.study.trial import simulated_trial


def scenario(seed: int, moved: int) -> Scenario:
    """Return the scenario of one run."""
    return PAPER_HOMING.model_copy(update={"seed": seed, "moved": Moved(count=moved)})


def bound(simulation: Simulation) -> np.ndarray:
    """Return the bound at the last bearing stamp of a run, shape (3, 3)."""
    return simulated_trial(simulation).bound[-1]


def final_error(drive: Drive, estimator: Estimator) -> tuple[np.ndarray, np.ndarray]:
    """Replay a drive; return error (3,) and covariance (3, 3) at the last bearing stamp."""
    odometry = iter(zip(drive.odometry.t, drive.odometry.v, drive.odometry.omega, strict=True))
    twist = next(odometry, None)
    for t, seen, sigmas in drive.sightings.stamps():
        while twist is not None and twist[0] <= t:
            estimator.odometry(*map(float, twist))
            twist = next(odometry, None)
        estimate = estimator.bearings(t, seen, sigmas)
    if estimate.pose is None:
        return np.full(3, np.nan), np.full((3, 3), np.nan)
    error = np.array(estimate.pose) - np.array(drive.truth.at(np.array(t)))
    error[2] = wrap(error[2])
    return error, estimate.covariance


def figures(name: str, runs: list[Simulation]) -> str:
    """Return a line of figures of one estimator over all runs."""
    right, squares, errors, nees = [], [], [], []
    for run in runs:
        estimator = make_estimator(name, run.drive)
        error, covariance = final_error(run.drive, estimator)
        limit = bound(run)[:2, :2]
        named = {m.landmark for m in estimator.landmarks() if m.moved}
        right.append(named == set(run.world.moved))
        squares.append(error[:2] @ np.linalg.solve(limit, error[:2]) / 2)
        errors.append(error[:2] @ error[:2])
        nees.append(error @ np.linalg.solve(covariance, error))
    squares, errors, nees = (np.array(a) for a in (squares, errors, nees))
    text = f"{name:8} RMSE of all {np.sqrt(np.nanmean(errors)):.4f} m"
    text += f", ratio to the bound {np.sqrt(np.nanmean(squares)):7.3f}"
    if name == "robust":
        set_right = np.array(right)
        rho = np.sqrt(np.nanmean(squares[set_right]))
        rmse = np.sqrt(np.nanmean(errors[set_right]))
        low, high = nees_interval(len(runs))
        text += (
            f"; right set {np.mean(set_right):.3f}: "
            f"rho {rho:.3f} (goal 1.15), RMSE {rmse:.4f} m"
            f"; NEES of three {np.nanmean(nees):.2f} (95 %: {low:.2f} to {high:.2f})"
            f"; without a pose {np.isnan(errors).sum()}"
        )
    return text


def nees_interval(runs: int) -> tuple[float, float]:
    """Return between what the mean of `runs` chi-square(3) lies with 95 % (normal, for many)."""
    half = 1.96 * np.sqrt(6.0 / runs)
    return 3.0 - half, 3.0 + half


def main() -> None:
    """Print the figures for each number of moved landmarks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--moved", type=int, nargs="*", default=[0, 1, 2])
    parser.add_argument("--estimators", nargs="*", default=["robust", "ekf", "a-ekf", "pi-ekf"])
    options = parser.parse_args()
    for moved in options.moved:
        runs = [simulate(scenario(seed, moved)) for seed in range(options.seeds)]
        limit = np.sqrt(np.mean([np.trace(bound(run)[:2, :2]) for run in runs]))
        print(f"{moved} moved, {len(runs)} seeds, bound {limit:.4f} m")
        for name in options.estimators:
            print("  " + figures(name, runs), flush=True)


if __name__ == "__main__":
    main()
