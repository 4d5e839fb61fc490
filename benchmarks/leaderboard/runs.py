"""The runs of the leaderboard: any estimator on any drive."""

import math
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from benchmarks.consistency.measures import figures
from benchmarks.consistency.trial import SurveyedTrial
from benchmarks.leaderboard.families import real, simulated
from benchmarks.monte_carlo import Run, run_all
from benchmarks.peers.extrinsics import is_offset, of_camera, of_robot
from homeward.drives.landmarks import KnownLandmarks
from homeward.lab.studies.study.trial import Trial
from homeward.plugins import ESTIMATORS, load
from homeward.registry import NEED_START, estimator_names, make_estimator, needs_start
from homeward.runs.scoring import errors, score
from homeward.runs.single_run import with_start
from homeward.track import Track
from homeward.track import run as follow

TEMPLATE = Path(__file__).parents[2] / "docs" / "do" / "estimator"
BASELINE = "dead_reckoning:make"  # the template of the documentation: odometry alone
WRONG_SIGMAS = 4.0
BASELINES = {
    "benchmarks.peers.online:robust_started": "robust, with start",
    "benchmarks.peers.graph:lag": "GTSAM",
    "benchmarks.peers.graph:lag_started": "GTSAM, with start",
    "benchmarks.peers.slam:ekf": "EKF-SLAM",
    "benchmarks.peers.surveyed:ekf": "EKF in the map",
    "benchmarks.peers.surveyed:ekf_no_gate": "EKF in the map, no gate",
    "benchmarks.peers.surveyed:ransac": "RANSAC in the map",
}
"""Labels of the baselines from outside the package."""
LABELS = {**BASELINES, BASELINE: "dead reckoning"}
Row = dict[str, Any]  # one estimator on one drive; None if a figure is unknown


def everybody() -> list[str]:
    """Return the names of all estimators; those of GTSAM if it is installed."""
    graphs = find_spec("gtsam") is not None
    if not graphs:
        print("without GTSAM, which is not installed: pip install -e '.[bench]'", file=sys.stderr)
    baselines = [name for name in BASELINES if graphs or ".graph:" not in name]
    return [estimator_names()[0], *baselines, *estimator_names()[1:], BASELINE]


def given(name: str) -> str:
    """Return what an estimator is given in addition to odometry, bearings and home bearings."""
    make = load(ESTIMATORS, name, estimator_names()) if ":" in name else None
    parts = ["map"] if getattr(make, "needs_survey", False) else []
    return ", ".join([*parts, *["start"] * needs_start(name)]) or "nothing"


def begin() -> None:
    if str(TEMPLATE) not in sys.path:
        sys.path.append(str(TEMPLATE))


@lru_cache(maxsize=2)
def _trial(family: str, number: int) -> Trial:
    return (simulated() | real())[family].make(number)


def follow_one(trial: Trial, name: str) -> Track:
    """Run an estimator; filters that assume the camera at the centre get the camera's drive."""
    needs = load(ESTIMATORS, name, estimator_names()) if ":" in name else None
    drive = trial.drive
    if getattr(needs, "needs_survey", False):
        assert isinstance(trial, SurveyedTrial)
        places = {n: {"x": x, "y": y} for n, (x, y) in trial.survey.items()}
        drive = replace(drive, known=KnownLandmarks(frame="home", landmarks=places))
    _, drive = with_start(drive, name)
    if name in NEED_START and is_offset(drive):
        moved = of_camera(drive)
        return of_robot(follow(moved, make_estimator(name, moved)), drive)
    return follow(drive, make_estimator(name, drive))


def one(run: Run) -> Row:
    """Return the figures of one run, or the error."""
    begin()
    trial = _trial(run.scenario, run.seed)
    began = time.process_time()
    try:
        track = follow_one(trial, run.estimator)
    except Exception as error:  # the other runs continue
        return {"error": f"{type(error).__name__}: {error}"}
    seconds = time.process_time() - began
    metrics, off = score(track, trial.drive.truth), errors(track, trial.drive.truth)
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
