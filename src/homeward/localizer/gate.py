"""The gate: which sightings of a stamp fit what the map predicts."""

from __future__ import annotations

import numpy as np

from homeward.estimator import Innovation
from homeward.localizer.marginal import HEAD, Marginal, Prediction
from homeward.localizer.preintegration import Motion
from homeward.localizer.sightings import LANDMARK

HEAVY_TAIL = 3.0
"""Wheels slip and robots bump: the gate takes odometry for so much worse than its noise says."""


def judge(
    marginal: Marginal,
    motion: Motion,
    fresh: bool,
    names: list[str],
    rows: np.ndarray,
    gate: float,
) -> tuple[list[Innovation], Prediction]:
    """Compare the sightings of mapped landmarks with what the map predicts after a motion.

    Parameters
    ----------
    marginal : Marginal
        What is known.
    motion : Motion
        The last one before the sightings.
    fresh : bool
        Whether the newest pose of `marginal` is the one after `motion`, not the one before.
    names : list of str
        Of the m sighted landmarks, mapped or not.
    rows : ndarray, shape (m, COLUMNS)
        Of the table of sightings, from the newest pose.
    gate : float
        Sightings whose innovation is larger do not fit [standard deviations].

    Returns
    -------
    innovations : list of Innovation
    prediction : Prediction
        Both of the mapped landmarks alone.
    """
    known = rows[:, LANDMARK] >= 0
    prediction = marginal.predict(rows[known])
    shift = motion.covariance[0, 0] + motion.covariance[1, 1]
    drift = motion.covariance[2, 2] + shift * (prediction.jacobian[:, HEAD:] ** 2).sum(axis=1)
    variance = prediction.spread.diagonal() + (0.0 if fresh else drift)
    widened = np.sqrt(variance + (HEAVY_TAIL**2 - 1.0) * drift)
    accepted = np.abs(prediction.residual) <= gate * widened
    told = zip(
        [n for n, k in zip(names, known.tolist(), strict=True) if k],
        prediction.residual.tolist(),
        np.sqrt(variance).tolist(),
        accepted.tolist(),
        strict=True,
    )
    return [Innovation(*each) for each in told], prediction
