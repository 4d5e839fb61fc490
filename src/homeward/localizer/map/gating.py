"""Innovation gate and data snooping (Baarda, 1968): which sightings fit what the map predicts.

And what of odometry's noise is in them: it makes innovations large, and bearings that were taken on
the way from a keyframe vague.
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
from homeward.localizer.tunables import (
    BASELINE_RATIO,
    FALSE_ALARM,
    GATE_INFLATION,
    MAJORITY,
    MAX_MOTION_SIGMA,
    MIN_BEARINGS,
)

FINEST, ROUNDING = 1e-6, 1e-10
"""No bearing is taken for better than this [rad], nor than such a share of the largest variance."""


@dataclass(frozen=True)
class Gated:
    """Gated frame: which of its bearings fit the map."""

    frame: WeighedFrame
    """Of m landmarks."""
    motion: Motion
    """Since the newest keyframe."""
    new_keyframe: bool
    """Whether that is at this frame."""
    rows: np.ndarray
    """(m, COLUMNS): of the table of sightings."""
    directions: np.ndarray
    """(m,): of the sight lines in the odometry frame [rad], not wrapped."""
    prediction: Prediction
    """Of the landmarks that are mapped ..."""
    innovations: list[Innovation]
    """... and whether they fit that."""
    denies_motion: bool
    """Whether those that fit deny the motion since the newest keyframe."""

    @cached_property
    def fits(self) -> dict[str, bool]:
        """Whether the bearing of each mapped landmark fits."""
        return {i.landmark: i.accepted for i in self.innovations}


def gate_bearings(
    prediction: Prediction, motion: Motion, new_keyframe: bool, heading: float, gate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Gate the innovations: which sightings fit what the map predicts.

    Parameters
    ----------
    prediction : Prediction
        Of m mapped landmarks.
    motion : Motion
        The last one before the sightings.
    new_keyframe : bool
        Whether the newest keyframe is after `motion`, not before.
    heading : float
        Where `motion` begins [rad].
    gate : float
        Sightings whose innovation is larger do not fit [standard deviations].

    Returns
    -------
    accepted : ndarray, shape (m,), bool
    sigmas : ndarray, shape (m,)
        Standard deviations of the innovations [rad].
    """
    (along, _, _), (_, across, _), (_, _, turn) = motion.covariance.tolist()
    drift = turn + (along + across) * (prediction.jacobian[:, HEAD:] ** 2).sum(axis=1)
    variance = prediction.innovation_covariance.diagonal() + (0.0 if new_keyframe else drift)
    widened = np.sqrt(variance + (GATE_INFLATION**2 - 1.0) * drift)
    accepted = np.abs(prediction.residual) <= gate * widened
    if np.count_nonzero(accepted) >= MIN_BEARINGS:
        among = prediction.only(accepted)
        by_motion = (GATE_INFLATION**2 - new_keyframe) * _from_motion(motion, heading, among)
        likely = np.abs(among.residual) <= gate * np.sqrt(variance[accepted])
        accepted[accepted] = consistent_subset(
            among.residual, among.innovation_covariance + by_motion, gate, likely
        )
    return accepted, np.sqrt(variance)


def denies_motion(prediction: Prediction, motion: Motion, heading: float) -> bool:
    """Return whether bearings that fit are all the same too far off for a motion to be right.

    Wheels slip, or stand while the robot goes on: a chi-square test of all innovations together.

    Parameters
    ----------
    prediction : Prediction
        Of those that fit, from the newest keyframe.
    motion : Motion
        Since then.
    heading : float
        Where it begins [rad].
    """
    count = prediction.residual.size
    if count < MIN_BEARINGS:
        return False
    covariance = prediction.innovation_covariance + _from_motion(motion, heading, prediction)
    _, weighted, vague = lapack.dposv(covariance, prediction.residual)
    return not vague and bool(prediction.residual @ weighted > chdtri(count, FALSE_ALARM))


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
    if not distances.size and across > (motion.path / BASELINE_RATIO) ** 2:
        return None
    by_shift = np.full(known.size, marginal.scale**-2.0)
    by_shift[known] = (prediction.jacobian[:, HEAD:] ** 2).sum(axis=1)
    if across * median(by_shift.tolist()) > (MAX_MOTION_SIGMA * median(sigmas.tolist())) ** 2:
        return None
    shared = (stamp + 1) * known.size * across * by_shift
    return np.asarray(np.sqrt(sigmas**2 + motion.covariance[2, 2] + shared))


def consistent_subset(
    residual: np.ndarray, innovation_covariance: np.ndarray, gate: float, likely: np.ndarray
) -> np.ndarray:
    """Return the largest consistent subset of residuals, by data snooping.

    One after the other, the one is left out that is farthest from what the others let expect
    (data snooping: Baarda, "A testing procedure for use in geodetic networks", 1968).

    Parameters
    ----------
    residual : ndarray, shape (m,)
        [rad]
    innovation_covariance : ndarray, shape (m, m)
        Their covariance.
    gate : float
        The farthest may be so far off [standard deviations].
    likely : ndarray, shape (m,), bool
        Which are where odometry has them, its noise being what it says.

    Returns
    -------
    ndarray, shape (m,), bool
        Where too many would have to be left out, the likely ones; all, where these are too few.
    """
    m, kept = residual.size, np.ones(residual.size, bool)
    innovation_covariance = innovation_covariance.copy()
    variances = innovation_covariance.reshape(-1)[:: m + 1]
    variances += FINEST**2 + ROUNDING * variances.max(initial=0.0)
    _data_snooping(kept, residual, innovation_covariance, gate)
    if np.count_nonzero(kept) >= MAJORITY * m:
        return kept
    enough = np.count_nonzero(likely) >= max(MIN_BEARINGS, 0.5 * m)
    return likely if enough else np.ones(m, bool)


def _data_snooping(
    kept: np.ndarray, residual: np.ndarray, innovation_covariance: np.ndarray, gate: float
) -> None:
    """Leave out those that do not agree with the others, in `kept`."""
    try:
        information = positive_inverse(innovation_covariance)
    except np.linalg.LinAlgError:  # nothing can be told
        return
    while np.count_nonzero(kept) >= MIN_BEARINGS:
        squares = np.square(information @ residual) / np.where(kept, information.diagonal(), np.inf)
        worst = int(squares.argmax())
        if not squares[worst] > gate**2:
            return
        kept[worst] = False
        row = information[worst].copy()
        information -= np.outer(row, row) / row[worst]


def _from_motion(motion: Motion, heading: float, prediction: Prediction) -> np.ndarray:
    """Return the covariance of residuals (m, m) that comes from a motion's noise."""
    off = prediction.jacobian[:, HEAD:]
    by_motion = off @ rotation(heading)[:2]  # less the sign, which does not matter
    by_motion[:, 2] = 1.0
    return np.asarray(by_motion @ motion.covariance @ by_motion.T)
