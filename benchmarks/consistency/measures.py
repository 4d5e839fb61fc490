"""The figures of one run, and of several runs of one scenario."""

import math
from collections.abc import Sequence

import numpy as np

from benchmarks.consistency.trial import Trial
from benchmarks.measures import MAX_NEES, SURE, WRONG, of_moved
from homeward.runs.scoring import errors, score
from homeward.track import Track

FIGURES = {
    "pose": "availability: share of the time with a pose",
    "sure": "share of the time localised or coasting",
    "error": "RMSE ratio to the posterior Cramer-Rao bound",
    "nees": "normalised estimation error squared of x, y and heading; 3 if consistent",
    "nis": "normalised innovation squared of the accepted sightings; 1 if consistent",
    "wrong": "share of the time localised or coasting with an error beyond 4 sigma",
    "far": "share of the time with a pose with an error beyond 4 sigma",
    "precision": "share of the landmarks reported as moved that did; 1 if there are none",
    "recall": "share of the moved landmarks that are reported",
    "rmse": "RMSE of the position [m], for information",
}

Figures = dict[str, float | None]  # of one run, by name; None if undefined


def figures(track: Track, trial: Trial) -> Figures:
    """Return the figures of one run, at the bearing stamps, where the bound is finite."""
    metrics, off = score(track, trial.drive.truth), errors(track, trial.drive.truth)
    index = np.searchsorted(trial.stamps, off.t)
    at_stamp = trial.stamps[np.minimum(index, trial.stamps.size - 1)] == off.t
    e = np.column_stack([off.x, off.y])[at_stamp]
    bound = trial.bound[index[at_stamp], :2, :2]
    known = np.isfinite(bound[:, 0, 0])
    ratio = np.einsum("ki,kij,kj->k", e[known], np.linalg.inv(bound[known]), e[known]) / 2
    status = np.array([s in SURE for s in track.status])[np.searchsorted(track.t, off.t)]
    far = off.nees_position > WRONG**2
    moved = of_moved(track, trial.moved)
    return {
        "pose": metrics.pose_share,
        "sure": sum(metrics.status_shares.get(s, 0.0) for s in SURE),
        "error": math.sqrt(ratio.mean()) if ratio.size else None,
        "nees": float(np.minimum(off.nees[at_stamp], MAX_NEES).mean()) if len(e) else None,
        "nis": metrics.innovation_nis_mean,
        "wrong": float(far[status].mean()) if status.any() else None,
        "far": float(far.mean()) if far.size else None,
        "precision": moved["precision"],
        "recall": moved["recall"],
        "rmse": float(np.sqrt((e**2).sum(axis=1).mean())) if len(e) else None,
    }


def together(name: str, values: Sequence[float | None]) -> tuple[float, float, int]:
    """Return centre, spread between runs, and number of the runs that have a figure.

    Errors have the geometric mean, so that a single diverged run does not dominate; their spread is
    that of the logarithm.
    """
    there = np.array([v for v in values if v is not None], float)
    if not there.size:
        return math.nan, math.nan, 0
    logarithmic = name in ("error", "rmse")
    there = np.log(np.maximum(there, 1e-12)) if logarithmic else there
    spread = float(there.std(ddof=1)) if there.size > 1 else math.nan
    centre = float(there.mean())
    return math.exp(centre) if logarithmic else centre, spread, int(there.size)
