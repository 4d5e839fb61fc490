"""Comparison of two runs of a drive: consistency and accuracy where both have answers.

The settings of one run may come from the first part of the drive: only the rest, held out, counts.

A run that has a pose sooner includes more of the time in which poses are worst, and must not score
worse for that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from homeward.drives.drive import Drive
from homeward.estimator import Estimator
from homeward.geometry.statistics import ROUNDING
from homeward.localizer.tunables import GATE
from homeward.runs.scoring import Errors, accuracy, errors
from homeward.track import Innovations, run

CONSISTENT = {"NIS": 1.0, "NEES": 3.0}
"""Means of a consistent estimator."""


@dataclass(frozen=True)
class Check:
    """Scores of one run of a drive, in the time held out, where both runs have answers."""

    nis: float
    """Mean normalised innovation squared; 1 when consistent."""
    log_likelihood: float
    """Mean over the innovations."""
    pose_share: float
    """Share of rows with a pose, in this run."""
    rmse_m: float
    """RMSE of the position; NaN without ground truth."""
    nees: float
    """Mean NEES; 3 when consistent; NaN without ground truth."""

    @property
    def log_inconsistency(self) -> dict[str, float]:
        """Absolute logarithm of NIS and of NEES over their consistent values."""
        values = {"NIS": self.nis, "NEES": self.nees}
        # Data without noise may have no errors at all.
        shares = {name: value / CONSISTENT[name] for name, value in values.items()}
        return {name: abs(math.log(share or ROUNDING)) for name, share in shares.items()}


class EvaluatedRun(NamedTuple):
    """Scores of one run of a drive, in the time held out."""

    pose_share: float
    errors: Errors | None
    innovations: Innovations


def evaluated(drive: Drive, estimator: Estimator, since: float) -> EvaluatedRun:
    """Run an estimator on a whole drive and return its scores from a time on [s]."""
    track, truth = run(drive, estimator), drive.truth
    off = None if truth is None else errors(track, truth)
    off = off and off.rows(off.t >= since)
    seen = track.innovations
    share = float(track.has_pose[track.t >= since].mean())
    return EvaluatedRun(share, off, seen.rows(seen.t >= since))


def checks(before: EvaluatedRun, after: EvaluatedRun) -> tuple[Check, Check]:
    """Return the scores of two runs at the times and innovations that both have."""
    return _check(before, after), _check(after, before)


def _check(one: EvaluatedRun, other: EvaluatedRun) -> Check:
    """Return the scores of `one` run where the `other` run of the drive has answers, too."""
    off = None
    if one.errors is not None and other.errors is not None:
        off = accuracy(one.errors.rows(np.isin(one.errors.t, other.errors.t)))
    others = set(stamps(other.innovations))
    both = [stamp in others for stamp in stamps(one.innovations)]
    square, likelihood = (values[both] for values in log_likelihoods(one.innovations))
    return Check(
        nis=float(square.mean()) if square.size else math.nan,
        log_likelihood=float(likelihood.mean()) if square.size else math.nan,
        pose_share=one.pose_share,
        rmse_m=math.nan if off is None else off.position.rmse,
        nees=math.nan if off is None else off.nees_mean,
    )


def stamps(i: Innovations) -> list[tuple[float, str]]:
    """Return the time and the landmark of each innovation."""
    return list(zip(i.t.tolist(), i.landmark.tolist(), strict=True))


def log_likelihoods(i: Innovations) -> tuple[np.ndarray, np.ndarray]:
    """Return squares of innovations over their variances, and log-likelihoods, (m,) each.

    Squares are at most the gate's: an outlier is as likely as an innovation at the gate.
    """
    square = np.minimum((i.value / i.sigma) ** 2, GATE**2)
    return square, -0.5 * square - np.log(i.sigma) - 0.5 * math.log(math.tau)
