"""Quantities of a run, and the runs of a block.

A run that fails is recorded with its reason; the others continue.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np

from homeward.estimator import Estimator
from homeward.geometry.angles import wrap
from homeward.lab.simulation.scenario import Scenario
from homeward.lab.simulation.simulate import prepare, simulate
from homeward.lab.studies.blocks.store import Arrays
from homeward.lab.studies.study.plan import Contender, StudyBlock
from homeward.lab.studies.study.trial import Recording, Trial, recorded_trial, simulated_trial
from homeward.registry import make_estimator
from homeward.runs.scoring import Accuracy, Errors, errors, score
from homeward.runs.single_run import with_start
from homeward.track import Track, track_of
from homeward.track import run as follow


class Quantity(NamedTuple):
    """One number of a run, or one number of a run at each time."""

    unit: str
    """As in netCDF conventions; 1 for numbers without a unit."""
    meaning: str


RUN: dict[str, Quantity] = {
    "position_rmse": Quantity("m", "RMSE of the position over the run, weighted by time"),
    "R_rmse": Quantity("m", "RMSE of the distance from home"),
    "theta_rmse": Quantity("rad", "RMSE of the direction seen from home"),
    "heading_rmse": Quantity("rad", "RMSE of the heading"),
    "position_max": Quantity("m", "largest error of the position"),
    "position_bias": Quantity("m", "size of the mean position error, second half of the run"),
    "position_oscillation": Quantity("m", "RMS around that mean, second half of the run"),
    "position_bound": Quantity("m", "Cramer-Rao bound on position_rmse, at the true path"),
    "heading_bound": Quantity("rad", "Cramer-Rao bound on heading_rmse, at the true path"),
    "nees": Quantity("1", "mean NEES of (x, y, heading): 3 when consistent"),
    "nees_inside_95": Quantity("1", "share of the run inside the 95 % region: 0.95"),
    "nis": Quantity("1", "mean NIS of accepted sightings: 1 when consistent"),
    "pose_share": Quantity("1", "share of the run with a pose"),
    "first_pose": Quantity("s", "time of the first pose"),
    "duration": Quantity("s", "length of the drive"),
    "final_distance": Quantity("m", "true distance from home at the end"),
    "reached_home": Quantity("1", "1 where the true end of the run is at home, else 0"),
    "moved_right": Quantity(
        "1", "exact detection: 1 where exactly the moved landmarks were named, else 0"
    ),
    "moved_bearing_error": Quantity("rad", "RMS of the moved landmarks' estimated home bearings"),
    "moved_bearing_stored": Quantity("rad", "RMS of the errors of their stored home bearings"),
    "seconds": Quantity("s", "runtime (processor time); differs between repetitions"),
}
"""Quantities of every scenario, estimator and run; NaN where unknown."""

SERIES: dict[str, Quantity] = {
    "position_error": Quantity("m", "error of the position"),
    "heading_error": Quantity("rad", "error of the heading"),
    "nees_over_time": Quantity("1", "NEES of (x, y, heading)"),
    "position_bound_over_time": Quantity("m", "Cramer-Rao bound on the position's error"),
    "heading_bound_over_time": Quantity("rad", "Cramer-Rao bound on the heading's error"),
}
"""Quantities at each time."""

FAILURE = "failure"
"""Reason of a failed run; empty otherwise."""


MAX_REASON = 200
"""Maximum number of characters of a failure's reason."""


def run_seed(seed: int, run: int) -> int:
    """Return the seed of the scenario of run number `run` in a study with a seed."""
    state = np.random.SeedSequence([seed, run]).generate_state(1, np.uint64)
    return int(state[0] >> np.uint64(1))  # fits a signed integer of netCDF


def run_block(block: StudyBlock) -> Arrays:
    """Run a block: every estimator through every run.

    Return the quantities of `RUN`, (estimators, runs), of `SERIES`, (estimators, runs, times), and
    `FAILURE`, (estimators, runs).
    """
    shape = len(block.contenders), block.last - block.first
    kept: Arrays = {name: np.full(shape, np.nan) for name in RUN}
    kept |= {name: np.full((*shape, block.times.size), np.nan, np.float32) for name in SERIES}
    failures = [[""] * shape[1] for _ in range(shape[0])]
    each = _open_loop if block.study.loop == "open" else _closed_loop
    for j, run, found in each(block, range(block.first, block.last)):
        i = run - block.first
        if isinstance(found, Exception):
            reason = " ".join(f"{type(found).__name__}: {found}".split())
            failures[j][i] = reason[:MAX_REASON]
        else:
            for name, value in found.items():
                kept[name][j, i] = value
    return {**kept, FAILURE: np.array(failures, dtype=np.str_)}


Found = dict[str, float | np.ndarray]
"""Known quantities of one run, by the names of `RUN` and `SERIES`."""
T = TypeVar("T")


def _tried(function: Callable[[], T]) -> T | Exception:
    """Return the result or the exception of a function, so that one run does not end the others."""
    try:
        return function()
    except Exception as error:
        return error


def _closed_loop(block: StudyBlock, runs: range) -> Iterator[tuple[int, int, Found | Exception]]:
    """Yield estimator, run and result, where each estimator steers its own drives."""
    for run in runs:
        for j, contender in enumerate(block.contenders):
            yield j, run, _tried(partial(_steered, contender, block, run))


def _steered(contender: Contender, block: StudyBlock, run: int) -> Found:
    began, case = time.process_time(), block.case.scenario
    assert isinstance(case, Scenario)  # a recorded drive cannot be steered
    seed = run_seed(block.study.seed, run)
    own = case.model_copy(update={"seed": seed, "estimator": contender.estimator})
    estimator = make_estimator(contender.estimator, prepare(own), contender.settings)
    simulation = simulate(own, estimator)
    track = track_of(estimator, simulation.estimates)
    seconds = time.process_time() - began
    return _measure(simulated_trial(simulation), estimator, track, block) | {"seconds": seconds}


def _open_loop(block: StudyBlock, runs: range) -> Iterator[tuple[int, int, Found | Exception]]:
    """Yield the same for drives shared by all estimators."""
    for run in runs:
        trial = _tried(partial(_recorded, block.case.scenario, run_seed(block.study.seed, run)))
        for j, contender in enumerate(block.contenders):
            if isinstance(trial, Exception):
                yield j, run, trial
            else:
                yield j, run, _tried(partial(_followed, contender, trial, block))


def _recorded(case: Scenario | Recording, seed: int) -> Trial:
    if isinstance(case, Recording):
        return recorded_trial(case, seed)
    return simulated_trial(simulate(case.model_copy(update={"seed": seed, "estimator": "truth"})))


def _followed(contender: Contender, trial: Trial, block: StudyBlock) -> Found:
    drive = trial.drive
    if isinstance(block.case.scenario, Recording):
        _, drive = with_start(drive, contender.estimator)
    estimator = make_estimator(contender.estimator, drive, contender.settings)
    began = time.process_time()
    track = follow(drive, estimator)
    if track.failures:
        raise RuntimeError(str(track.failures[0]))
    seconds = time.process_time() - began
    return _measure(trial, estimator, track, block) | {"seconds": seconds}


def _measure(trial: Trial, estimator: Estimator, track: Track, block: StudyBlock) -> Found:
    """Return all known quantities of one run."""
    begin, end = trial.drive.span
    found: Found = {
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
    return found | _bounds(times, trial, longest) | _errors(e, metrics.accuracy)


def _known(value: float | None) -> float:
    return math.nan if value is None else value


def _errors(e: Errors, total: Accuracy | None) -> Found:
    """Return errors over the whole run, with their bias and oscillation."""
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


def _bounds(times: np.ndarray, trial: Trial, longest: float) -> Found:
    stamps, bound = trial.stamps, trial.bound
    position, heading = bound[:, 0, 0] + bound[:, 1, 1], bound[:, 2, 2]
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
    """Return the latest value at each time; NaN where it is older than `longest` [s]."""
    if not stamps.size:
        return np.full(times.shape, np.nan)
    row = np.searchsorted(stamps, times + 1e-9, side="right") - 1
    age = times - stamps[np.maximum(row, 0)]
    return np.asarray(np.where((row >= 0) & (age < longest), values[np.maximum(row, 0)], np.nan))


def _landmarks(trial: Trial, estimator: Estimator) -> Found:
    """Return the detection of moved landmarks, if the estimator reports it."""
    known, home, true = estimator.landmarks(), trial.drive.home_bearings(), trial.true_home
    found: Found = {}
    tested = {m.landmark: m.moved for m in known if m.moved is not None}
    if tested and trial.none_else:
        named = {landmark for landmark, moved in tested.items() if moved}
        found["moved_right"] = float(named == trial.moved)
    # The stored bearing contains the fault and the noise of home.
    moved = [m for m in known if m.landmark in trial.moved]
    if moved:
        stored = np.array([wrap(home[m.landmark] - true[m.landmark]) for m in moved])
        now = [wrap(m.home_bearing_estimated - true[m.landmark]) for m in moved]
        found["moved_bearing_stored"] = float(np.sqrt(np.mean(stored**2)))
        found["moved_bearing_error"] = float(np.sqrt(np.mean(np.square(now))))
    return found
