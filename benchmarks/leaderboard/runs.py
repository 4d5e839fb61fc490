"""Every estimator on one drive after the other; what is finished is kept."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from benchmarks.consistency.measures import figures
from benchmarks.consistency.trial import Trial
from benchmarks.leaderboard.families import real, simulated
from homeward.registry import estimator_names, make_estimator
from homeward.scoring import errors, score
from homeward.studies.single_run import with_start
from homeward.track import run

TEMPLATE = Path(__file__).parents[2] / "docs" / "do" / "estimator"
BASELINE = "dead_reckoning:make"
"""The template of the documentation: what odometry alone comes to."""
WRONG_SIGMAS = 4.0
Row = dict[str, Any]
"""One estimator on one drive; None where a figure is not known."""


def everybody() -> list[str]:
    """Return the estimators of homeward and of installed packages, and the baseline."""
    return [*estimator_names(), BASELINE]


def begin() -> None:
    """Let a process find the baseline."""
    if str(TEMPLATE) not in sys.path:
        sys.path.append(str(TEMPLATE))


def one(family: str, number: int, estimators: Sequence[str]) -> list[Row]:
    """Run estimators over one drive."""
    trial = (simulated() | real())[family].make(number)
    where = {"family": family, "number": number}
    return [where | {"estimator": name} | _measured(trial, name) for name in estimators]


def _measured(trial: Trial, name: str) -> Row:
    """Return the figures of one run, or why there are none."""
    began = time.process_time()
    try:
        _, drive = with_start(trial.drive, name)
        track = run(drive, make_estimator(name, drive))
    except Exception as error:  # of one in a thousand runs; the others go on
        return {"error": f"{type(error).__name__}: {error}"}
    seconds = time.process_time() - began
    metrics, off = score(track, drive.truth), errors(track, drive.truth)
    total = off.weight.sum()
    far = off.nees_position > WRONG_SIGMAS**2
    judged = any(m.moved is not None for m in track.landmarks)
    named = {m.landmark for m in track.landmarks if m.moved}
    accuracy = metrics.accuracy
    row = {
        "pose": metrics.pose_share,
        "rmse": None if accuracy is None else accuracy.position.rmse,
        "wrong": float(off.weight[far].sum() / total) if total > 0 else None,
        "nees": None if accuracy is None else accuracy.nees_mean,
        "to_bound": figures(track, trial)["error"],
        "named": named == trial.moved if judged else None,
        "seconds": seconds,
    }
    # JSON has no infinity; what has diverged so far is known by its share of wrong poses.
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}


def every(
    work: Sequence[tuple[str, int]],
    estimators: Sequence[str],
    jobs: int,
    kept: Path | None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> list[Row]:
    """Run every estimator on every drive (family, number).

    Parameters
    ----------
    work : sequence of (str, int)
        The drives.
    estimators : sequence of str
        As `make_estimator` takes them.
    jobs : int
        Processes.
    kept : Path, optional
        JSON lines: what is in it is not done again, what is done is added.
    progress : callable
        Told how many drives are done, and of how many.
    """
    rows = list(_read(kept))
    known = {(row["family"], row["number"], row["estimator"]) for row in rows}
    missing = {
        drive: left
        for drive in work
        if (left := [name for name in estimators if (*drive, name) not in known])
    }
    with ProcessPoolExecutor(jobs, initializer=begin) as pool:
        running = [pool.submit(one, *drive, left) for drive, left in missing.items()]
        for done, future in enumerate(as_completed(running), start=1):
            rows += future.result()
            if kept is not None:
                with kept.open("a") as file:
                    file.writelines(json.dumps(row) + "\n" for row in future.result())
            progress(done, len(running))
    wanted = {(*drive, name) for drive in work for name in estimators}
    return [row for row in rows if (row["family"], row["number"], row["estimator"]) in wanted]


def _read(kept: Path | None) -> Iterator[Row]:
    if kept is not None and kept.exists():
        yield from map(json.loads, kept.read_text().splitlines())
