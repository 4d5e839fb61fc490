"""One frame: predicted bearings, innovation gate and data snooping (Baarda, 1968).

The gate allows for the noise of odometry, which makes innovations large, and which inflates the
noise of bearings that are seen between keyframes.
"""

from __future__ import annotations

import math
from statistics import median
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack
from scipy.special import chdtri

from homeward.geometry.se2 import rotation
from homeward.localizer.motions import HEAD, Motion, camera_after
from homeward.localizer.reference.factors import bearing_residuals, cameras
from homeward.localizer.reference.window import positive_inverse
from homeward.localizer.tunables import (
    FALSE_ALARM,
    INFLATION,
    LINEAR,
    MAJORITY,
    MIN_BEARING_SIGMA,
    MINIMAL,
    VAGUE,
    VARIANCE_ROUNDING,
)


class GateInput(NamedTuple):
    """A frame of m bearings, k of them of mapped landmarks, and the state that predicts them."""

    mean: np.ndarray
    """(13 + 2 n,): newest pose, calibration and n landmarks: mean ..."""
    covariance: np.ndarray
    """(13 + 2 n, 13 + 2 n): ... and covariance."""
    p_static: np.ndarray
    """(n,): probability of each landmark to be static."""
    scale: float
    """Median distance of the landmarks [m]; infinite if none, not used at a new keyframe."""
    motion: Motion
    """Motion to the frame, from the newest keyframe or, at a new one, from the one before."""
    is_keyframe: bool
    """Whether the newest keyframe is at the end of the motion, not at its start."""
    mount: np.ndarray
    """(3,): given pose of the first camera on the robot [m, m, rad]."""
    offset: np.ndarray | None
    """(3,): pose of this camera in the frame of the first one; None for the first."""
    bearings: np.ndarray
    """(m,): from the camera's axis [rad], ..."""
    sigmas: np.ndarray
    """(m,): ... their standard deviations [rad] ..."""
    landmark: np.ndarray
    """(m,), int: ... and indices of their landmarks in the state, -1 if not mapped."""
    gate: float
    """Largest innovation [standard deviations]."""
    stamps: tuple[int, int]
    """Number of this frame since the keyframe, from 1, without and with vague frames."""


class GateResult(NamedTuple):
    """Innovations of k bearings, and which of them are accepted."""

    residual: np.ndarray
    """(k,): innovations, measured minus expected [rad] ..."""
    deviation: np.ndarray
    """(k,): ... and their standard deviations [rad]."""
    accepted: np.ndarray
    """(k,), bool: whether each is accepted."""
    square: float
    """Squared Mahalanobis distance of the accepted ones from the motion; see `joint_square`."""
    inflated: np.ndarray
    """(m,): standard deviations of the bearings with odometry noise [rad]; see `_inflated`."""
    is_vague: bool
    """Whether the motion is so uncertain that the frame adds nothing to the pose."""
    free: np.ndarray
    """(3,): the camera's pose in its keyframe's frame for a calibration of zero, ..."""
    jacobian: np.ndarray
    """(3, 10): ... its Jacobian by the calibration ..."""
    eye: np.ndarray
    """(3,): ... and its pose in the odometry frame [m, m, rad]."""


class Prediction(NamedTuple):
    """Innovations of k bearings."""

    residual: np.ndarray
    """(k,): measured minus expected [rad]."""
    by_place: np.ndarray
    """(k, 2): Jacobian of each expected bearing by its landmark [rad/m]."""
    covariance: np.ndarray
    """(k, k): covariance of the residuals."""


def gate_frame(given: GateInput) -> GateResult:
    """Predict the bearings of a frame, and test them: each, against the others, and all jointly."""
    motion, mean, calibration = given.motion, given.mean, given.mean[3:HEAD]
    since = Motion.identity() if given.is_keyframe else motion
    camera = camera_after(since, given.mount, calibration, given.offset)
    free, jacobian = camera.uncalibrated, camera.jacobian
    eye = cameras(free, jacobian, mean[:3], calibration)
    (known,) = (given.landmark >= 0).nonzero()
    index, mapped = given.landmark[known], (given.bearings[known], given.sigmas[known])
    seen = predict_bearings(mean, given.covariance, *mapped, eye, index)
    by_motion = motion_covariance(seen, motion, mean[2] - given.is_keyframe * motion.delta[2])
    accepted, deviation = _accepted(given, seen, by_motion)
    accepted &= given.p_static[index] > FALSE_ALARM  # a walking landmark has no position
    square = 0.0 if given.is_keyframe else joint_square(seen, by_motion, accepted)
    by_shift = np.full(len(given.landmark), given.scale**-2.0)
    by_shift[known] = (seen.by_place**2).sum(axis=1)
    tested = seen.residual, deviation, accepted, square
    return GateResult(*tested, *_inflated(given, by_shift), free, jacobian, eye[0])


def predict_bearings(
    mean: np.ndarray,
    covariance: np.ndarray,
    bearings: np.ndarray,
    sigmas: np.ndarray,
    camera: tuple[np.ndarray, np.ndarray],
    index: np.ndarray,
) -> Prediction:
    """Predict bearings from a state: innovations and their covariance.

    `bearings` and `sigmas` (k,) are from the camera's axis [rad], `camera` its pose (3,) in the
    odometry frame and the Jacobian (3, 13), and `index` (k,) that of each landmark.
    """
    count = len(index)
    residual, by_own = bearing_residuals(bearings, *camera, mean[HEAD:].reshape(-1, 2)[index])
    jacobian, row = np.zeros((count, HEAD + 2 * count)), np.arange(count)
    jacobian[:, :HEAD] = by_own[:, :HEAD]
    jacobian[row, HEAD + 2 * row], jacobian[row, HEAD + 2 * row + 1] = by_own[:, HEAD:].T
    of_landmarks = HEAD + 2 * index[:, None] + np.arange(2)
    columns = np.concatenate([np.arange(HEAD), of_landmarks.ravel()])
    innovation_covariance = jacobian @ covariance[np.ix_(columns, columns)] @ jacobian.T
    # What the map predicts is no better than exact: rounding must not cancel the noise.
    by_map = np.maximum(innovation_covariance.diagonal(), 0.0)
    innovation_covariance[row, row] = by_map + sigmas**2
    return Prediction(residual, by_own[:, HEAD:], innovation_covariance)


def propagate(
    mean: np.ndarray, covariance: np.ndarray, motion: Motion
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and covariance of the state with the newest pose propagated by a motion."""
    free, by_calibration = motion.uncalibrated, motion.jacobian
    there, by_head = cameras(free, by_calibration, mean[:3], mean[3:HEAD])
    turn, covariance = rotation(mean[2]), covariance.copy()
    covariance[:3] = by_head @ covariance[:HEAD]
    covariance[:, :3] = covariance[:, :HEAD] @ by_head.T
    covariance[:3, :3] += turn @ motion.covariance @ turn.T
    return np.concatenate([there, mean[3:]]), covariance


def motion_covariance(seen: Prediction, motion: Motion, heading: float) -> np.ndarray:
    """Return the covariance of residuals (k, k) by the noise of a motion that begins at a heading.

    The heading is that of the robot [rad].
    """
    c, s = math.cos(heading), math.sin(heading)
    by_motion = seen.by_place @ np.array([[c, -s, 0.0], [s, c, 0.0]])  # the sign does not matter
    by_motion[:, 2] = 1.0
    return np.asarray(by_motion @ motion.covariance @ by_motion.T)


def _accepted(
    given: GateInput, seen: Prediction, by_motion: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return which of k bearings fit the prediction, and the sigmas of their innovations [rad]."""
    (along, _, _), (_, across, _), (_, _, turn) = given.motion.covariance.tolist()
    drift = turn + (along + across) * (seen.by_place**2).sum(axis=1)
    variance = seen.covariance.diagonal() + (0.0 if given.is_keyframe else drift)
    widened = np.sqrt(variance + (INFLATION**2 - 1.0) * drift)
    off, deviation = np.abs(seen.residual), np.sqrt(variance)
    accepted = off <= given.gate * widened
    if np.count_nonzero(accepted) >= MINIMAL:
        joint = seen.covariance + (INFLATION**2 - given.is_keyframe) * by_motion
        among, likely = joint[np.ix_(accepted, accepted)], (off <= given.gate * deviation)[accepted]
        accepted[accepted] = consistent_subset(seen.residual[accepted], among, given.gate, likely)
    return accepted, deviation


def consistent_subset(
    residual: np.ndarray, covariance: np.ndarray, gate: float, likely: np.ndarray
) -> np.ndarray:
    """Return the largest consistent subset of residuals (m,) [rad] by data snooping, (m,) bool.

    The residual farthest from its prediction by the others, in standard deviations, is removed
    while beyond the gate, one after the other (Baarda, "A testing procedure for use in geodetic
    networks", 1968). Where too many would be removed, return those `likely` (which the gate accepts
    without its inflation of odometry noise), or all if these are too few.
    """
    m, kept, covariance = residual.size, np.ones(residual.size, bool), covariance.copy()
    variances = covariance.reshape(-1)[:: m + 1]
    variances += MIN_BEARING_SIGMA**2 + VARIANCE_ROUNDING * variances.max(initial=0.0)
    _data_snooping(kept, residual, covariance, gate)
    if np.count_nonzero(kept) >= MAJORITY * m:
        return kept
    enough = np.count_nonzero(likely) >= max(MINIMAL, 0.5 * m)
    return likely if enough else np.ones(m, bool)


def _data_snooping(
    kept: np.ndarray, residual: np.ndarray, covariance: np.ndarray, gate: float
) -> None:
    """Remove from `kept` those that do not agree with the others."""
    try:
        information = positive_inverse(covariance)
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


def joint_square(seen: Prediction, by_motion: np.ndarray, accepted: np.ndarray) -> float:
    """Return the squared Mahalanobis distance of accepted bearings (k,) from a motion.

    Each may pass the gate although the motion is wrong: wheels slip, or stand while it moves. Two
    landmarks fit any motion, so they must be the only ones in view, with residuals of the same
    angle: a turn that odometry missed. Zero where the bearings cannot contradict the motion.
    `by_motion` (k, k) is the covariance from its noise; see `motion_covariance`.
    """
    count = np.count_nonzero(accepted)
    if count < MINIMAL and not (count == accepted.size == 2 and _shows_turn(seen)):
        return 0.0
    covariance = (seen.covariance + by_motion)[np.ix_(accepted, accepted)]
    _, weighted, failed = lapack.dposv(covariance, seen.residual[accepted])
    return 0.0 if failed else float(seen.residual[accepted] @ weighted)


def _shows_turn(seen: Prediction) -> bool:
    """Return whether two landmarks in different directions have the same residual.

    In similar directions, both may be on a body that was moved.
    """
    (ax, ay), (bx, by) = seen.by_place.tolist()
    apart = abs(math.atan2(ax * by - ay * bx, ax * bx + ay * by))
    (first, common), (_, second) = seen.covariance.tolist()
    off, variance = seen.residual[1] - seen.residual[0], first + second - 2.0 * common
    return apart > LINEAR and bool(off**2 <= chdtri(1, FALSE_ALARM) * variance)


def _inflated(given: GateInput, by_shift: np.ndarray) -> tuple[np.ndarray, bool]:
    """Inflate standard deviations of bearings by the odometry noise since the newest keyframe.

    The smoother takes the motion from the keyframe to a frame as exact and bearings as independent,
    while the error of the motion is common to all bearings of a frame, and to later frames. So the
    k-th frame bears its variance k + 1 times for each of its bearings. As the variance grows with
    k, and sum(1 / k / (k + 1)) = 1, all frames together then have the information on the keyframe
    that the first alone would have. Otherwise noisy odometry makes the map too large and the pose
    overconfident.

    `by_shift` (m,) has the variances of the bearings by that of a shift across [rad^2/m^2];
    landmarks that are not mapped are taken to be at the median distance of the mapped ones. Return
    the standard deviations (m,) [rad], and whether the frame is vague.
    """
    m, sigmas, covariance = len(by_shift), given.sigmas, given.motion.covariance
    if given.is_keyframe or not m:
        return sigmas, False
    across = 0.5 * (covariance[0, 0] + covariance[1, 1])
    is_vague = bool(across * median(by_shift.tolist()) > (VAGUE * median(sigmas.tolist())) ** 2)
    shared = (given.stamps[is_vague] + 1) * m * across * by_shift
    return np.sqrt(sigmas**2 + covariance[2, 2] + shared), is_vague
