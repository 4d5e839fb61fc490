"""The runs of the leaderboard: any estimator on any drive."""

import math
import sys
import time
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from benchmarks.consistency.measures import figures
from benchmarks.leaderboard.families import real, simulated
from benchmarks.monte_carlo import Run, run_all
from homeward.lab.studies.study.trial import Trial
from homeward.registry import estimator_names, make_estimator
from homeward.runs.scoring import errors, score
from homeward.runs.single_run import with_start
from homeward.track import run as follow

TEMPLATE = Path(__file__).parents[2] / "docs" / "do" / "estimator"
BASELINE = "dead_reckoning:make"  # the template of the documentation: odometry alone
WRONG_SIGMAS = 4.0
Row = dict[str, Any]  # one estimator on one drive; None if a figure is unknown


def everybody() -> list[str]:
    return [*estimator_names(), BASELINE]


def begin() -> None:
    if str(TEMPLATE) not in sys.path:
        sys.path.append(str(TEMPLATE))


@lru_cache(maxsize=2)
def _trial(family: str, number: int) -> Trial:
    return (simulated() | real())[family].make(number)


def one(run: Run) -> Row:
    """Return the figures of one run, or the error."""
    begin()
    trial = _trial(run.scenario, run.seed)
    began = time.process_time()
    try:
        _, drive = with_start(trial.drive, run.estimator)
        track = follow(drive, make_estimator(run.estimator, drive))
    except Exception as error:  # the other runs continue
        return {"error": f"{type(error).__name__}: {error}"}
    seconds = time.process_time() - began
    metrics, off = score(track, drive.truth), errors(track, drive.truth)
    total = off.weight.sum()
    far = off.nees_position > WRONG_SIGMAS**2
    tested = any(m.moved is not None for m in track.landmarks)
    named = {m.landmark for m in track.landmarks if m.moved}
    accuracy = metrics.accuracy
    row = {
        "pose": metrics.pose_share,
        "rmse": None if accuracy is None else accuracy.position.rmse,
        "wrong": float(off.weight[far].sum() / total) if total > 0 else None,
        "nees": None if accuracy is None else accuracy.nees_mean,
        "to_bound": figures(track, trial)["error"],
        "named": named == trial.moved if tested else None,
        "seconds": seconds,
    }
    # A track that diverged to infinity counts by its share of wrong poses.
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}


def every(
    drives: Iterable[tuple[str, int]],
    estimators: Sequence[str],
    jobs: int | None = None,
    keep: Path | None = None,
) -> list[Row]:
    """Run every estimator on every drive (family, number); arguments as for `run_all`."""
    runs = [Run(family, name, k) for family, k in drives for name in estimators]
    return [
        {"family": run.scenario, "number": run.seed, "estimator": run.estimator} | row
        for run, row in run_all(one, runs, jobs, keep).items()
    ]
