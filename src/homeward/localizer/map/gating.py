"""Predicted bearings, innovation gate and data snooping (Baarda, 1968): which bearings fit.

The gate allows for the noise of odometry, which makes innovations large, and which inflates the
noise of bearings that are seen between keyframes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median

import numpy as np
from scipy.linalg import lapack
from scipy.special import chdtri

from homeward.estimator import Innovation
from homeward.localizer.inputs.bearing_noise import WeighedFrame
from homeward.localizer.map.sightings import LANDMARK, SIGMA
from homeward.localizer.map.state import Marginal
from homeward.localizer.motions import HEAD, Motion
from homeward.localizer.reference.factors import bearing_residuals
from homeward.localizer.reference.window import positive_inverse
from homeward.localizer.tunables import (
    BASELINE,
    FALSE_ALARM,
    INFLATION,
    LINEAR,
    MAJORITY,
    MIN_BEARING_SIGMA,
    MINIMAL,
    VAGUE,
    VARIANCE_ROUNDING,
)


@dataclass(frozen=True)
class Prediction:
    """Predicted bearings from the newest pose: innovations and their covariance."""

    residual: np.ndarray
    """(m,): innovations, measured minus expected [rad]."""
    jacobian: np.ndarray
    """(m, 14): Jacobian of the expected bearings; see `bearing_residuals`."""
    correlated: np.ndarray
    """(m, 3 + 9 + 2 n): cross-covariance of the expected bearings with the state."""
    innovation_covariance: np.ndarray
    """(m, m): innovation covariance."""

    def only(self, keep: np.ndarray) -> Prediction:
        """Return a subset, given by a mask (m,)."""
        (kept,) = keep.nonzero()
        if kept.size == keep.size:
            return self
        return Prediction(
            self.residual[kept],
            self.jacobian[kept],
            self.correlated[kept],
            self.innovation_covariance.take(kept, axis=0).take(kept, axis=1),
        )

    def widened(self, variances: np.ndarray) -> Prediction:
        """Return it with variances (m,) [rad^2] added."""
        covariance = self.innovation_covariance.copy()
        covariance.flat[:: len(covariance) + 1] += variances
        return Prediction(self.residual, self.jacobian, self.correlated, covariance)


def predict_bearings(
    state: Marginal,
    bearings: np.ndarray,
    sigmas: np.ndarray,
    cameras: tuple[np.ndarray, np.ndarray],
    index: np.ndarray,
) -> Prediction:
    """Predict bearings from the newest pose: innovations and their covariance.

    `bearings` and `sigmas` (m,) are from the camera's axis [rad], `cameras` its poses and Jacobians
    as in `bearing_residuals` (`pose_after`), and `index` (m,) that of each landmark.
    """
    at = HEAD + 2 * index
    residual, jacobian = bearing_residuals(bearings, *cameras, state.positions[index])
    head, gx, gy = jacobian[:, :HEAD], jacobian[:, HEAD, None], jacobian[:, HEAD + 1, None]
    p = state.covariance
    by_x, by_y = p.take(at, axis=0), p.take(at + 1, axis=0)
    correlated = head @ p[:HEAD] + gx * by_x + gy * by_y
    innovation_covariance = correlated[:, :HEAD] @ head.T
    innovation_covariance += correlated.take(at, axis=1) * gx.T
    innovation_covariance += correlated.take(at + 1, axis=1) * gy.T
    # What the map predicts is no better than exact: rounding must not cancel the noise.
    by_map = np.maximum(innovation_covariance.diagonal(), 0.0)
    innovation_covariance.flat[:: len(bearings) + 1] = by_map + sigmas**2
    return Prediction(residual, jacobian, correlated, innovation_covariance)


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
    camera: np.ndarray
    """(3,): pose of the camera in the odometry frame [m, m, rad]."""
    prediction: Prediction
    """Prediction of the bearings of mapped landmarks ..."""
    innovations: list[Innovation]
    """... and their innovations."""
    fits: dict[str, bool]
    """Whether the bearing of each mapped landmark was accepted."""
    contradicts_motion: bool
    """Whether the accepted bearings contradict the motion since the newest keyframe."""


def gate_bearings(
    prediction: Prediction, motion: Motion, new_keyframe: bool, heading: float, gate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return which of m bearings fit the prediction, and the sigmas of their innovations [rad].

    The motion led to the frame; with `new_keyframe`, the newest keyframe is at its end, not at its
    start, where the robot has a `heading` [rad]. `gate` is the largest innovation in standard
    deviations.
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


def contradicts_motion(
    prediction: Prediction, accepted: np.ndarray, motion: Motion, heading: float
) -> bool:
    """Test accepted bearings (m,) jointly against the motion (chi-square); return whether it fails.

    Each may pass the gate although the motion is wrong: wheels slip, or stand while it moves. Two
    landmarks fit any motion, so they must be the only ones in view, with residuals of the same
    angle: a turn that odometry missed. Prediction and motion are from the newest keyframe, where
    the robot has a `heading` [rad].
    """
    prediction = prediction.only(accepted)
    count = prediction.residual.size
    if count < MINIMAL and not (count == accepted.size == 2 and _shows_turn(prediction)):
        return False
    covariance = prediction.innovation_covariance + _motion_covariance(motion, heading, prediction)
    _, weighted, vague = lapack.dposv(covariance, prediction.residual)
    return not vague and bool(prediction.residual @ weighted > chdtri(count, FALSE_ALARM))


def _shows_turn(prediction: Prediction) -> bool:
    """Return whether two landmarks in different directions have the same residual.

    In similar directions, both may be on a body that was moved.
    """
    (ax, ay), (bx, by) = prediction.jacobian[:, HEAD:].tolist()
    between = abs(math.atan2(ax * by - ay * bx, ax * bx + ay * by))
    (first, common), (_, second) = prediction.innovation_covariance.tolist()
    off, variance = np.diff(prediction.residual)[0], first + second - 2.0 * common
    return between > LINEAR and bool(off**2 <= chdtri(1, FALSE_ALARM) * variance)


def inflate_by_odometry(
    rows: np.ndarray,
    motion: Motion,
    stamps: tuple[int, int],
    prediction: Prediction,
    marginal: Marginal,
) -> tuple[np.ndarray, bool] | None:
    """Inflate standard deviations of bearings by the odometry noise since the newest keyframe.

    The smoother takes the motion from the keyframe to a frame as exact and bearings as independent,
    while the error of the motion is common to all bearings of a frame, and to later frames. So the
    k-th frame bears its variance k + 1 times for each of its bearings. As the variance grows with
    k, and sum(1 / k / (k + 1)) = 1, all frames together then have the information on the keyframe
    that the first alone would have. Otherwise noisy odometry makes the map too large and the pose
    overconfident.

    `rows` (m, COLUMNS) are of the table of sightings; landmarks that are not mapped are taken to be
    at the median distance of the mapped ones, which `prediction` has. `stamps` are k, from 1,
    without and with vague frames. Return the standard deviations (m,) [rad], and whether the frame
    is vague: its motion is so uncertain that it adds nothing to the pose. None where nothing is
    mapped and the bearings are useless.
    """
    sigmas, known = rows[:, SIGMA], rows[:, LANDMARK] >= 0
    if not known.size:
        return sigmas, False
    across = 0.5 * (motion.covariance[0, 0] + motion.covariance[1, 1])
    distances = marginal.distances
    if not distances.size and across > (motion.path / BASELINE) ** 2:
        return None
    by_shift = np.full(known.size, marginal.scale**-2.0)
    by_shift[known] = (prediction.jacobian[:, HEAD:] ** 2).sum(axis=1)
    is_vague = bool(across * median(by_shift.tolist()) > (VAGUE * median(sigmas.tolist())) ** 2)
    shared = (stamps[is_vague] + 1) * known.size * across * by_shift
    return np.sqrt(sigmas**2 + motion.covariance[2, 2] + shared), is_vague


def consistent_subset(
    residual: np.ndarray, innovation_covariance: np.ndarray, gate: float, likely: np.ndarray
) -> np.ndarray:
    """Return the largest consistent subset of residuals (m,) [rad] by data snooping, (m,) bool.

    The residual farthest from its prediction by the others, in standard deviations, is removed
    while beyond the gate, one after the other (Baarda, "A testing procedure for use in geodetic
    networks", 1968). Where too many would be removed, return those `likely` (which the gate accepts
    without its inflation of odometry noise), or all if these are too few.
    """
    m, kept = residual.size, np.ones(residual.size, bool)
    innovation_covariance = innovation_covariance.copy()
    variances = innovation_covariance.reshape(-1)[:: m + 1]
    variances += MIN_BEARING_SIGMA**2 + VARIANCE_ROUNDING * variances.max(initial=0.0)
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
    off, c, s = prediction.jacobian[:, HEAD:], math.cos(heading), math.sin(heading)
    by_motion = off @ np.array([[c, -s, 0.0], [s, c, 0.0]])  # the sign does not matter
    by_motion[:, 2] = 1.0
    return np.asarray(by_motion @ motion.covariance @ by_motion.T)
