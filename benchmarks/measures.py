"""Figures of one track on a drive with ground truth.

Older versions of homeward run this code, too (benchmarks.against), so it uses only functions that
all versions have.
"""

import math
from collections.abc import Set as AbstractSet
from typing import Any

import numpy as np

from homeward.drives.drive import Truth
from homeward.estimator import Status
from homeward.runs.scoring import errors, score
from homeward.track import Track

SURE = (Status.LOCALISED, Status.COASTING)  # status of a reliable pose
WRONG = 4.0  # A reliable pose with a larger error is wrong [sigmas]
MAX_NEES = 30.0
"""Limit of NEES: wrong poses have a figure of their own, and one wrong run would dominate the mean.
By chance it is exceeded once in a million rows."""
Figures = dict[str, Any]  # by name; None or missing if undefined


def figures(
    track: Track, truth: Truth, moved: AbstractSet[str] | None = None, after_s: float = 0.0
) -> Figures:
    """Return the figures of a track; those of errors from `after_s` on [s].

    `moved` are the landmarks that moved, if known. Shares and means are weighted by time.
    """
    metrics, off = score(track, truth), errors(track, truth)
    shares = metrics.status_shares
    found: Figures = {
        "pose": metrics.pose_share,
        "sure": sum(shares.get(s, 0.0) for s in SURE),
        "first": metrics.first_pose_after_s,
        "ms": 1e3 * float(np.median(track.update_seconds)) if track.t.size else None,
    }
    found |= of_moved(track, moved)
    use = off.t >= track.t[0] + after_s
    weight = off.weight[use]
    if weight.sum() == 0.0:
        return found

    def mean(values: np.ndarray) -> float:
        return float(np.average(values[use], weights=weight))

    sure = np.array([s in SURE for s in track.status])[np.searchsorted(track.t, off.t)]
    square = off.nees_position
    return found | {
        "rmse": math.sqrt(mean(off.position**2)),
        "final": float(off.position[-1]),
        "heading": math.sqrt(mean(off.heading**2)),
        "nees": mean(np.minimum(off.nees, MAX_NEES)),
        "nees_position": mean(square),
        **{f"inside{k}": mean(square < k**2) for k in (1, 2, 3)},
        "beyond3": mean(square > 3.0**2),
        "beyond4": mean(square > WRONG**2),
        "wrong": mean((square > WRONG**2) & sure),
    }


def of_moved(track: Track, moved: AbstractSet[str] | None) -> Figures:
    """Return the figures of the landmarks reported as moved; none if those that did are unknown."""
    if moved is None:
        return {}
    named = {m.landmark for m in track.landmarks if m.moved}
    right = len(named & moved)
    return {
        "precision": right / len(named) if named else None if moved else 1.0,
        "recall": right / len(moved) if moved else None,
        "exact": float(named == moved),
    }


def scale_of(track: Track, places: dict[str, np.ndarray]) -> float:
    """Return the scale of the map of a track, from true positions [m]; NaN without three of them.

    Landmarks that are reported as moved do not count.
    """
    found = [
        m for m in track.landmarks if np.isfinite(m.x) and m.landmark in places and not m.moved
    ]
    if len(found) < 3:
        return math.nan
    p = np.array([complex(m.x, m.y) for m in found])
    q = np.array([complex(*places[m.landmark]) for m in found])
    p, q = p - p.mean(), q - q.mean()
    return float(abs(np.vdot(q, p)) / np.vdot(q, q).real)
