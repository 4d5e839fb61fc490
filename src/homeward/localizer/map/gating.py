"""Innovation gate and data snooping (Baarda, 1968): which bearings fit the map's prediction.

The gate allows for the noise of odometry, which makes innovations large, and which inflates the
noise of bearings that are seen between keyframes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from statistics import median

import numpy as np
from scipy.linalg import lapack
from scipy.special import chdtri

from homeward.estimator import Innovation
from homeward.localizer.geometry import rotation
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.elimination import positive_inverse
from homeward.localizer.map.sightings import LANDMARK, SIGMA
from homeward.localizer.map.state import HEAD, Marginal, Prediction
from homeward.localizer.motion.preintegration import Motion
from homeward.localizer.tunables import BASELINE, FALSE_ALARM, INFLATION, MAJORITY, MINIMAL, VAGUE

MIN_SIGMA, ROUNDING = 1e-6, 1e-10
"""Smallest standard deviation of a bearing [rad]; smallest share of the largest variance [1]."""


@dataclass(frozen=True)
class Gated:
    """Frame of m landmarks after the gate."""

    frame: WeighedFrame
    """The bearings."""
    motion: Motion
    """Motion since the newest keyframe."""
    new_keyframe: bool
    """Whether the newest keyframe is at this frame."""
    rows: np.ndarray
    """(m, COLUMNS): rows of the table of sightings."""
    directions: np.ndarray
    """(m,): directions of the sight lines in the odometry frame [rad], not wrapped."""
    prediction: Prediction
    """Prediction of the bearings of mapped landmarks ..."""
    innovations: list[Innovation]
    """... and their innovations."""
    contradicts_motion: bool
    """Whether the accepted bearings contradict the motion since the newest keyframe."""

    @cached_property
    def fits(self) -> dict[str, bool]:
        """Whether the bearing of each mapped landmark was accepted."""
        return {i.landmark: i.accepted for i in self.innovations}


def gate_bearings(
    prediction: Prediction, motion: Motion, new_keyframe: bool, heading: float, gate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Gate the innovations: which bearings fit the prediction.

    Parameters
    ----------
    prediction : Prediction
        Of m mapped landmarks.
    motion : Motion
        The motion that led to the frame.
    new_keyframe : bool
        Whether the newest keyframe is at the end of `motion`, not at its start.
    heading : float
        Heading at the start of `motion` [rad].
    gate : float
        Largest innovation [standard deviations].

    Returns
    -------
    accepted : ndarray, shape (m,), bool
    sigmas : ndarray, shape (m,)
        Standard deviations of the innovations [rad].
    """
    (along, _, _), (_, across, _), (_, _, turn) = motion.covariance.tolist()
    drift = turn + (along + across) * (prediction.jacobian[:, HEAD:] ** 2).sum(axis=1)
    variance = prediction.innovation_covariance.diagonal() + (0.0 if new_keyframe else drift)
    widened = np.sqrt(variance + (INFLATION**2 - 1.0) * drift)
    accepted = np.abs(prediction.residual) <= gate * widened
    if np.count_nonzero(accepted) >= MINIMAL:
        among = prediction.only(accepted)
        by_motion = (INFLATION**2 - new_keyframe) * _motion_covariance(motion, heading, among)
        likely = np.abs(among.residual) <= gate * np.sqrt(variance[accepted])
        accepted[accepted] = consistent_subset(
            among.residual, among.innovation_covariance + by_motion, gate, likely
        )
    return accepted, np.sqrt(variance)


def contradicts_motion(prediction: Prediction, motion: Motion, heading: float) -> bool:
    """Test accepted bearings jointly against the motion (chi-square); return whether it fails.

    Each may pass the gate although the motion is wrong: wheels slip, or stand while it moves.

    Parameters
    ----------
    prediction : Prediction
        Of the accepted bearings, from the newest keyframe.
    motion : Motion
        Since then.
    heading : float
        At the start of it [rad].
    """
    count = prediction.residual.size
    if count < MINIMAL:
        return False
    covariance = prediction.innovation_covariance + _motion_covariance(motion, heading, prediction)
    _, weighted, vague = lapack.dposv(covariance, prediction.residual)
    return not vague and bool(prediction.residual @ weighted > chdtri(count, FALSE_ALARM))


def inflate_by_odometry(
    rows: np.ndarray, motion: Motion, stamp: int, prediction: Prediction, marginal: Marginal
) -> np.ndarray | None:
    """Inflate standard deviations of bearings by the odometry noise since the newest keyframe.

    The smoother takes the motion from the keyframe to a frame as exact and bearings as independent,
    while the error of the motion is common to all bearings of a frame, and to later frames. So the
    k-th frame bears its variance k + 1 times for each of its bearings. As the variance grows with
    k, and sum(1 / k / (k + 1)) = 1, all frames together then have the information on the keyframe
    that the first alone would have. Otherwise noisy odometry makes the map too large and the pose
    overconfident.

    Parameters
    ----------
    rows : ndarray, shape (m, COLUMNS)
        Of the table of sightings, with the standard deviations of the bearings alone. Landmarks
        that are not mapped are taken to be at the median distance of the mapped ones.
    motion : Motion
        From the newest keyframe to the stamp.
    stamp : int
        Number k of the frame since then, from 1.
    prediction : Prediction
        Of those of mapped landmarks.
    marginal : Marginal
        The state.

    Returns
    -------
    ndarray, shape (m,)
        [rad]; None where the motion is so uncertain that the bearings are useless.
    """
    sigmas, known = rows[:, SIGMA], rows[:, LANDMARK] >= 0
    if not known.size:
        return sigmas
    across = 0.5 * (motion.covariance[0, 0] + motion.covariance[1, 1])
    distances = marginal.distances
    if not distances.size and across > (motion.path / BASELINE) ** 2:
        return None
    by_shift = np.full(known.size, marginal.scale**-2.0)
    by_shift[known] = (prediction.jacobian[:, HEAD:] ** 2).sum(axis=1)
    if across * median(by_shift.tolist()) > (VAGUE * median(sigmas.tolist())) ** 2:
        return None
    shared = (stamp + 1) * known.size * across * by_shift
    return np.asarray(np.sqrt(sigmas**2 + motion.covariance[2, 2] + shared))


def consistent_subset(
    residual: np.ndarray, innovation_covariance: np.ndarray, gate: float, likely: np.ndarray
) -> np.ndarray:
    """Return the largest consistent subset of residuals, by data snooping.

    The residual farthest from its prediction by the others is removed, one after the other (Baarda,
    "A testing procedure for use in geodetic networks", 1968).

    Parameters
    ----------
    residual : ndarray, shape (m,)
        [rad]
    innovation_covariance : ndarray, shape (m, m)
        Their covariance.
    gate : float
        Largest distance from that prediction [standard deviations].
    likely : ndarray, shape (m,), bool
        Which ones the gate would accept without its inflation of odometry noise.

    Returns
    -------
    ndarray, shape (m,), bool
        Where too many would be removed: the likely ones, or all if these are too few.
    """
    m, kept = residual.size, np.ones(residual.size, bool)
    innovation_covariance = innovation_covariance.copy()
    variances = innovation_covariance.reshape(-1)[:: m + 1]
    variances += MIN_SIGMA**2 + ROUNDING * variances.max(initial=0.0)
    _data_snooping(kept, residual, innovation_covariance, gate)
    if np.count_nonzero(kept) >= MAJORITY * m:
        return kept
    enough = np.count_nonzero(likely) >= max(MINIMAL, 0.5 * m)
    return likely if enough else np.ones(m, bool)


def _data_snooping(
    kept: np.ndarray, residual: np.ndarray, innovation_covariance: np.ndarray, gate: float
) -> None:
    """Remove from `kept` those that do not agree with the others."""
    try:
        information = positive_inverse(innovation_covariance)
    except np.linalg.LinAlgError:  # no test is possible
        return
    while np.count_nonzero(kept) >= MINIMAL:
        squares = np.square(information @ residual) / np.where(kept, information.diagonal(), np.inf)
        worst = int(squares.argmax())
        if not squares[worst] > gate**2:
            return
        kept[worst] = False
        row = information[worst].copy()
        information -= np.outer(row, row) / row[worst]


def _motion_covariance(motion: Motion, heading: float, prediction: Prediction) -> np.ndarray:
    """Return the covariance of residuals (m, m) by a motion's noise."""
    off = prediction.jacobian[:, HEAD:]
    by_motion = off @ rotation(heading)[:2]  # the sign does not matter
    by_motion[:, 2] = 1.0
    return np.asarray(by_motion @ motion.covariance @ by_motion.T)
