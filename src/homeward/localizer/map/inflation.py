"""Covariance inflation: what the odometry's noise since the keyframe adds to bearing noise."""

from __future__ import annotations

import numpy as np

from homeward.localizer.map.sightings import LANDMARK, SIGMA
from homeward.localizer.map.state import HEAD, Marginal, Prediction
from homeward.localizer.motion.preintegration import Motion
from homeward.localizer.tunables import BASE, LOST


def inflate_by_odometry(
    rows: np.ndarray, motion: Motion, stamp: int, prediction: Prediction, marginal: Marginal
) -> np.ndarray | None:
    """Inflate the deviations of bearings by the odometry's noise since the newest keyframe.

    The table of sightings takes that way for exact and the sightings for independent, while the
    error of the way is in all sightings of a stamp, and goes on in the later stamps'. So the k-th
    stamp bears its variance k + 1 times for each of its sightings: as the variance grows with k,
    and sum(1 / k / (k + 1)) = 1, all stamps then tell of the keyframe what the first one alone
    would. Else noisy odometry makes the map too large, and the pose too sure.

    Parameters
    ----------
    rows : ndarray, shape (m, COLUMNS)
        Of the table of sightings, with the deviations of the bearings alone. Those of landmarks
        that are not mapped are taken to be as far as the mapped ones mostly are.
    motion : Motion
        From the newest keyframe to the stamp.
    stamp : int
        Its number k since then, from 1.
    prediction : Prediction
        Of those that are mapped.
    marginal : Marginal
        What is known of the newest keyframe and the map.

    Returns
    -------
    ndarray, shape (m,)
        [rad]; None where the way is so uncertain that the bearings are of no use.
    """
    sigmas, known = rows[:, SIGMA], rows[:, LANDMARK] >= 0
    if not known.size:
        return sigmas
    across = 0.5 * (motion.covariance[0, 0] + motion.covariance[1, 1])
    distances = marginal.distances
    if not distances.size and across > (motion.path / BASE) ** 2:
        return None
    by_shift = np.full(known.size, marginal.scale**-2.0)
    by_shift[known] = (prediction.jacobian[:, HEAD:] ** 2).sum(axis=1)
    if across * np.median(by_shift) > (LOST * np.median(sigmas)) ** 2:
        return None
    shared = (stamp + 1) * known.size * across * by_shift
    return np.asarray(np.sqrt(sigmas**2 + motion.covariance[2, 2] + shared))
