"""The runs of the leaderboard: any estimator on any drive."""

import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from benchmarks.consistency.scenarios import SCENARIOS
from benchmarks.consistency.trial import SurveyedTrial
from benchmarks.leaderboard.families import real
from benchmarks.measures import Figures, figures
from benchmarks.monte_carlo import Run, run_all
from benchmarks.peers.extrinsics import is_offset, of_camera, of_robot
from homeward.drives.landmarks import KnownLandmarks
from homeward.lab.studies.study.trial import Trial
from homeward.plugins import ESTIMATORS, load
from homeward.registry import NEED_START, estimator_names, make_estimator, needs_start
from homeward.runs.scoring import errors
from homeward.runs.single_run import with_start
from homeward.track import Track
from homeward.track import run as follow

TEMPLATE = Path(__file__).parents[2] / "docs" / "do" / "estimator"
BASELINE = "dead_reckoning:make"  # the template of the documentation: odometry alone
BASELINES = {
    "benchmarks.peers.graph:lag": "GTSAM",
    "benchmarks.peers.slam:ekf": "EKF-SLAM",
    "benchmarks.peers.surveyed:multi_tag": "multi-tag PnP",
    "benchmarks.peers.surveyed:ekf": "iterated EKF",
}
"""Labels of the baselines from outside the package."""
LABELS = {**BASELINES, BASELINE: "dead reckoning"}


def everybody() -> list[str]:
    """Return the names of `robust` and its peers; those of GTSAM if it is installed."""
    graphs = find_spec("gtsam") is not None
    if not graphs:
        print("without GTSAM, which is not installed: pip install -e '.[bench]'", file=sys.stderr)
    baselines = [name for name in BASELINES if graphs or ".graph:" not in name]
    return [estimator_names()[0], *baselines, BASELINE]


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
    return (SCENARIOS | real())[family].drive(number)


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


def one(run: Run) -> Figures:
    """Return the figures of one run and its errors by time (n,), or the error."""
    begin()
    trial = _trial(run.scenario, run.seed)
    began = time.process_time()
    try:
        track = follow_one(trial, run.estimator)
    except Exception as error:  # the other runs continue
        return {"error": f"{type(error).__name__}: {error}"}
    seconds = time.process_time() - began
    off = errors(track, trial.drive.truth)
    use = np.isfinite(off.position)
    tested = any(m.moved is not None for m in track.landmarks)
    return {
        **figures(track, trial.drive.truth, trial.moved if tested else None),
        "seconds": seconds,
        "t": off.t[use],
        "weight": off.weight[use],
        "position": off.position[use],
    }


def every(
    drives: Iterable[tuple[str, int]],
    estimators: Sequence[str],
    jobs: int | None = None,
    keep: Path | None = None,
) -> list[Figures]:
    """Run every estimator on every drive (family, number); arguments as for `run_all`."""
    runs = [Run(family, name, k) for family, k in drives for name in estimators]
    return [
        {"family": run.scenario, "number": run.seed, "estimator": run.estimator} | row
        for run, row in run_all(one, runs, jobs, keep).items()
    ]
