"""The runs of a block: simulated, estimated, measured; what fails is told and ends nothing."""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np

from homeward.angles import wrap
from homeward.estimator import Estimator
from homeward.registry import make_estimator
from homeward.scoring import Errors, accuracy, errors, score
from homeward.simulation.scenario import Scenario
from homeward.simulation.simulate import prepare, simulate
from homeward.studies.blocks.store import Arrays
from homeward.studies.single_run import with_start
from homeward.studies.study.plan import Contender, StudyBlock
from homeward.studies.study.recordings import Recording, recorded_trial
from homeward.studies.study.trial import Trial, simulated_trial
from homeward.track import Track, track_of
from homeward.track import run as follow


class Quantity(NamedTuple):
    """One number of a run, or one number of a run at each time."""

    unit: str
    """As netCDF conventions write it; 1 for a number without one."""
    meaning: str


RUN: dict[str, Quantity] = {
    "position_rmse": Quantity("m", "RMSE of the position over the run, weighted by time"),
    "R_rmse": Quantity("m", "RMSE of the distance from home"),
    "theta_rmse": Quantity("rad", "RMSE of the direction seen from home"),
    "heading_rmse": Quantity("rad", "RMSE of the heading"),
    "position_max": Quantity("m", "largest error of the position"),
    "position_bias": Quantity("m", "size of the mean position error, second half of the run"),
    "position_oscillation": Quantity("m", "RMS of what is left of it, second half of the run"),
    "position_bound": Quantity("m", "Cramer-Rao bound on position_rmse, at the true path"),
    "heading_bound": Quantity("rad", "Cramer-Rao bound on heading_rmse, at the true path"),
    "nees": Quantity("1", "mean NEES of (x, y, heading): 3 when consistent"),
    "nees_inside_95": Quantity("1", "share of the run inside the 95 % region: 0.95"),
    "nis": Quantity("1", "mean NIS of accepted sightings: 1 when consistent"),
    "pose_share": Quantity("1", "share of the run with a pose"),
    "first_pose": Quantity("s", "time of the first pose"),
    "duration": Quantity("s", "length of the drive"),
    "final_distance": Quantity("m", "true distance from home at the end"),
    "reached_home": Quantity("1", "1 where the run truly ended at home, else 0"),
    "moved_right": Quantity("1", "1 where exactly the moved landmarks were named, else 0"),
    "moved_bearing_error": Quantity("rad", "RMS of the moved landmarks' estimated home bearings"),
    "moved_bearing_stored": Quantity("rad", "the same of what home stored"),
    "seconds": Quantity("s", "processor time; the one number that does not repeat"),
}
"""Each has a value for every scenario, estimator and run; NaN where it cannot be told."""

SERIES: dict[str, Quantity] = {
    "position_error": Quantity("m", "error of the position"),
    "heading_error": Quantity("rad", "error of the heading"),
    "nees_over_time": Quantity("1", "NEES of (x, y, heading)"),
    "position_bound_over_time": Quantity("m", "Cramer-Rao bound on the position's error"),
    "heading_bound_over_time": Quantity("rad", "Cramer-Rao bound on the heading's error"),
}
"""The same at each time."""

FAILURE = "failure"
"""Why a run failed, in words; empty where it did not."""


LONGEST_REASON = 200
"""Letters of the reason of a failure that are kept."""


def run_seed(seed: int, run: int) -> int:
    """Return the seed of the scenario of run number `run` in a study with a seed."""
    state = np.random.SeedSequence([seed, run]).generate_state(1, np.uint64)
    return int(state[0] >> np.uint64(1))  # so that it fits a signed integer of netCDF


def run_block(block: StudyBlock) -> Arrays:
    """Run a block: every estimator through every run.

    Returns
    -------
    dict of ndarray
        The quantities of `RUN`, (estimators, runs); of `SERIES`, (estimators, runs, times); and
        `FAILURE`, (estimators, runs), the reason where a run failed.
    """
    shape = len(block.contenders), block.last - block.first
    kept: Arrays = {name: np.full(shape, np.nan) for name in RUN}
    kept |= {name: np.full((*shape, block.times.size), np.nan, np.float32) for name in SERIES}
    failures = [[""] * shape[1] for _ in range(shape[0])]
    for i, run in enumerate(range(block.first, block.last)):
        seed, case = run_seed(block.study.seed, run), block.case.scenario
        shared = None
        for j, contender in enumerate(block.contenders):
            try:
                if block.study.loop == "open" and shared is None:
                    shared = _open_loop(case, seed)
                found = _run(case, seed, contender, block, shared)
            except Exception as error:
                # Whatever goes wrong in one of a million runs must not end the others.
                failures[j][i] = _reason(error)
            else:
                for name, value in found.items():
                    kept[name][j, i] = value
    return {**kept, FAILURE: np.array(failures, dtype=np.str_)}


def _reason(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:LONGEST_REASON]


def _open_loop(case: Scenario | Recording, seed: int) -> Trial:
    if isinstance(case, Recording):
        return recorded_trial(case, seed)
    return simulated_trial(simulate(case.model_copy(update={"seed": seed, "estimator": "truth"})))


def _run(
    case: Scenario | Recording,
    seed: int,
    contender: Contender,
    block: StudyBlock,
    shared: Trial | None,
) -> dict[str, float | np.ndarray]:
    """Run one estimator once; over the shared drive, or over one that it steers itself."""
    began = time.process_time()
    if shared is not None:
        trial, drive = shared, shared.drive
        if isinstance(case, Recording):
            _, drive = with_start(drive, contender.estimator)
        estimator = make_estimator(contender.estimator, drive, contender.settings)
        track = follow(drive, estimator)
        seconds = time.process_time() - began
    else:
        assert isinstance(case, Scenario)  # who steers cannot do so in a log
        own = case.model_copy(update={"seed": seed, "estimator": contender.estimator})
        estimator = make_estimator(contender.estimator, prepare(own), contender.settings)
        simulation = simulate(own, estimator)
        track = track_of(estimator, simulation.estimates)
        seconds = time.process_time() - began
        trial = simulated_trial(simulation)
    return _measure(trial, estimator, track, block) | {"seconds": seconds}


def _measure(
    trial: Trial, estimator: Estimator, track: Track, block: StudyBlock
) -> dict[str, float | np.ndarray]:
    """Return every quantity of one run that is known."""
    begin, end = trial.drive.span
    found: dict[str, float | np.ndarray] = {
        "duration": end - begin,
        "final_distance": trial.final_distance,
        "pose_share": 0.0,
        **_landmarks(trial, estimator),
    }
    if block.study.loop == "closed":
        found["reached_home"] = float(trial.final_distance <= block.study.home_radius)
    if not track.t.size:
        return found
    assert trial.drive.truth is not None  # every trial has it
    e = errors(track, trial.drive.truth)
    metrics = score(track, trial.drive.truth)
    found["pose_share"] = _known(metrics.pose_share)
    found["first_pose"] = _known(metrics.first_pose_after_s)
    found["nis"] = _known(metrics.innovation_nis_mean)
    times, longest = begin + block.times, 1.5 * block.study.interval
    found |= {
        "position_error": _latest(times, e.t, e.position, longest),
        "heading_error": _latest(times, e.t, e.heading, longest),
        "nees_over_time": _latest(times, e.t, e.nees, longest),
    }
    if trial.bound is not None:
        found |= _bounds(times, trial.bound, longest)
    return found | _errors(e)


def _known(value: float | None) -> float:
    return math.nan if value is None else value


def _errors(e: Errors) -> dict[str, float | np.ndarray]:
    """Return errors over the whole run, and how they split into bias and oscillation."""
    total = accuracy(e)
    if total is None:
        return {}
    late = e.t >= (e.t[0] + e.t[-1]) / 2
    mean_x, mean_y = float(e.x[late].mean()), float(e.y[late].mean())
    left = (e.x[late] - mean_x) ** 2 + (e.y[late] - mean_y) ** 2
    return {
        "position_rmse": total.position.rmse,
        "R_rmse": total.R.rmse,
        "theta_rmse": total.theta.rmse,
        "heading_rmse": total.heading.rmse,
        "position_max": total.position.max,
        "position_bias": math.hypot(mean_x, mean_y),
        "position_oscillation": float(np.sqrt(left.mean())),
        "nees": total.nees_mean,
        "nees_inside_95": total.nees_inside_95_share,
    }


def _bounds(
    times: np.ndarray, bound: tuple[np.ndarray, np.ndarray], longest: float
) -> dict[str, float | np.ndarray]:
    stamps, covariances = bound
    position = covariances[:, 0, 0] + covariances[:, 1, 1]
    heading = covariances[:, 2, 2]
    finite = np.isfinite(position)
    if not finite.any():
        return {}
    return {
        "position_bound": float(np.sqrt(position[finite].mean())),
        "heading_bound": float(np.sqrt(heading[finite].mean())),
        "position_bound_over_time": _latest(times, stamps, np.sqrt(position), longest),
        "heading_bound_over_time": _latest(times, stamps, np.sqrt(heading), longest),
    }


def _latest(
    times: np.ndarray, stamps: np.ndarray, values: np.ndarray, longest: float
) -> np.ndarray:
    """Return the latest value at each time, NaN where there is none as young as `longest` [s]."""
    if not stamps.size:
        return np.full(times.shape, np.nan)
    row = np.searchsorted(stamps, times + 1e-9, side="right") - 1
    age = times - stamps[np.maximum(row, 0)]
    return np.asarray(np.where((row >= 0) & (age < longest), values[np.maximum(row, 0)], np.nan))


def _landmarks(trial: Trial, estimator: Estimator) -> dict[str, float | np.ndarray]:
    """Return what became of the moved landmarks, as far as the estimator says."""
    known, home, true = estimator.landmarks(), trial.drive.home_bearings(), trial.true_home
    found: dict[str, float | np.ndarray] = {}
    judged = {m.landmark: m.moved for m in known if m.moved is not None}
    if judged and trial.none_else:
        named = {landmark for landmark, moved in judged.items() if moved}
        found["moved_right"] = float(named == trial.moved)
    # The stored bearing holds the fault and the noise of home; the truth is where it stands.
    moved = [m for m in known if m.landmark in trial.moved]
    if moved:
        stored = np.array([wrap(home[m.landmark] - true[m.landmark]) for m in moved])
        now = [wrap(m.home_bearing_estimated - true[m.landmark]) for m in moved]
        found["moved_bearing_stored"] = float(np.sqrt(np.mean(stored**2)))
        found["moved_bearing_error"] = float(np.sqrt(np.mean(np.square(now))))
    return found
