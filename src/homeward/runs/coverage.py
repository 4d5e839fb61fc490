"""Coverage of pose covariances, and their scale by split conformal prediction.

The covariance of a robot whose errors no model contains is too small or too large by some factor.
Conformal prediction (Vovk, Gammerman and Shafer 2005) takes it from the NEES on drives that were
not used for anything else: the ellipsoid then contains the pose of a further drive with at least
the probability `LEVEL`, if that drive is like them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from homeward.runs.scoring import Errors

LEVELS = 0.5, 0.9, 0.99
"""Probabilities at which coverage is reported [1]."""
LEVEL = 0.9
"""Probability at which the scale is fitted: the largest that ten independent poses determine [1].
"""


def coverage(nees: np.ndarray, weight: np.ndarray) -> tuple[float, ...]:
    """Return the shares of the weight inside the ellipsoids of `LEVELS`, of a NEES (m,) of poses.

    NaN without weight.
    """
    limits = chdtri(3, 1.0 - np.array(LEVELS))
    total = weight.sum()
    return tuple(float(weight[nees <= x].sum() / total) if total else math.nan for x in limits)


def covariance_scale(drives: Sequence[Errors]) -> float | None:
    """Return the factor of the covariance with a coverage of `LEVEL` on further drives.

    It is at least 1, since drives differ by more than the times of one drive: a factor below 1 of
    three drives is no evidence for the fourth. None if they have fewer than 9 independent poses.
    """
    number = sum(independent(drive.nees) for drive in drives)
    level = LEVEL * (number + 1.0) / number if number > 0.0 else math.inf
    if level > 1.0:
        return None
    nees = np.concatenate([drive.nees for drive in drives])
    weight = np.concatenate([drive.weight for drive in drives])
    order = np.argsort(nees)
    share = np.cumsum(weight[order]) / weight.sum()
    at = min(int(np.searchsorted(share, level - 1e-9)), nees.size - 1)
    return max(1.0, float(nees[order[at]] / chdtri(3, 1.0 - LEVEL)))


def independent(nees: np.ndarray) -> float:
    """Return how many independent values have a mean as certain as that of a NEES (m,).

    By the autocorrelation, up to where the sum of a pair is negative (Geyer 1992), of the indicator
    of a NEES above its median: a few large values would hide the correlation.
    """
    above = (nees > np.median(nees)) - 0.5 if nees.size else np.zeros(1)
    above = above - above.mean()
    spectrum = np.fft.rfft(above, 2 * above.size)  # padded: without wrap-around
    products = np.fft.irfft(np.abs(spectrum) ** 2)[: above.size]
    if products[0] <= 0.0:
        return 0.0
    pairs = products[: above.size // 2 * 2].reshape(-1, 2).sum(axis=1) / products[0]
    positive = pairs[np.logical_and.accumulate(pairs > 0.0)]
    return float(above.size / max(2.0 * positive.sum() - 1.0, 1.0))
