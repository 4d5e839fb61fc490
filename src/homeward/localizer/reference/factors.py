"""Factors of the window: motions between poses, and sightings, as normal equations.

The Hessian is block tridiagonal in the poses and dense in the shared unknowns: the calibration (9)
and the landmarks (2 n).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.se2 import between, composition, lever, rotation, sight
from homeward.localizer.motions import (
    DELAY,
    HEAD,
    NC,
    SIDEWAYS_SCALE,
    SPEED_SCALE,
    TIME_CONSTANT,
)
from homeward.localizer.tunables import GATE, MAX_PADDING

FREE, INFORMATION, BY_CALIBRATION = slice(0, 3), slice(3, 12), slice(12, 12 + 3 * NC)
PER_S = 12 + 3 * NC
STEP = 13 + 3 * NC
"""Columns of the table of motions between keyframes: the motion for a calibration of zero, the
inverse of its covariance (3, 3), its Jacobian by the calibration (3, 10), and one over its duration
[1/s], that of the mean twist at its end at least, if it is from twists alone, otherwise 0."""


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations: Hessian and negative gradient of w poses and a shared unknowns."""

    own: np.ndarray
    """(w, 3, 3): diagonal blocks of the poses."""
    next: np.ndarray
    """(w - 1, 3, 3): blocks of each pose (rows) with the next one (columns)."""
    shared: np.ndarray
    """(w, 3, a): blocks of each pose with the shared unknowns."""
    common: np.ndarray
    """(a, a): block of the shared unknowns."""
    slope: np.ndarray
    """(w, 3): negative gradient by the poses ..."""
    common_slope: np.ndarray
    """(a,): ... and by the shared unknowns."""

    @staticmethod
    def zeros(w: int, a: int) -> NormalEquations:
        """Return empty normal equations."""
        return NormalEquations(
            np.zeros((w, 3, 3)),
            np.zeros((max(w - 1, 0), 3, 3)),
            np.zeros((w, 3, a)),
            np.zeros((a, a)),
            np.zeros((w, 3)),
            np.zeros(a),
        )


class OdometryErrors(NamedTuple):
    """Odometry factors between k + 1 poses, linearised."""

    error: np.ndarray
    """(k, 3): residual, measured minus expected motion [m, m, rad]."""
    jacobian: np.ndarray
    """(k, 3, 16): Jacobian of the expected motion by both poses and the calibration."""
    information: np.ndarray
    """(k, 3, 3): inverse of the covariance of the residual."""
    weight: np.ndarray
    """(k,): robust weights, see `cauchy_weights`: wheels slip, robots are pushed."""


def cauchy_weights(squares: np.ndarray) -> np.ndarray:
    """Return the weights of a Cauchy M-estimator by squared Mahalanobis distances, 1 at most.

    For the Cauchy distribution in three dimensions: the t distribution of one degree of freedom in
    Lange, Little and Taylor, "Robust statistical modeling using the t distribution", 1989. A motion
    in which wheels slip then has hardly any influence; none has more than by its covariance.
    """
    return np.asarray(4.0 / np.maximum(1.0 + squares, 4.0))


def odometry_errors(
    poses: np.ndarray, calibration: np.ndarray, steps: np.ndarray
) -> OdometryErrors:
    """Linearise the odometry factors (w - 1, STEP) between `poses` (w, 3) at a calibration (10,).

    Residuals are measured in the odometry's own metres, to the left those of the speed to the left.
    Otherwise all of them would shrink with the scale of its speed, which may be otherwise
    undetermined, and the map with it (errors in variables). The Jacobian by delay and time
    constant has the noise of the twist at the end of the motion, which is correlated with the
    residual. Its expectation, given the residual, is taken out where the robot strafes: the lag is
    found by changes of translation there, and would come out too large by about 0.03 s. In turns it
    is found by their rate, whose noise is small.
    """
    a, b = poses[:-1], poses[1:]
    by_calibration = steps[:, BY_CALIBRATION].reshape(-1, 3, NC)
    strafes = by_calibration[:, 1, SIDEWAYS_SCALE] != 0.0
    aside, speed = 1.0 + strafes * calibration[SIDEWAYS_SCALE], 1.0 + calibration[SPEED_SCALE]
    size = np.stack([np.full(len(a), speed), speed * aside, np.ones(len(a))], axis=1)
    error = (steps[:, FREE] + by_calibration @ calibration - between(a, b)) / size
    back = rotation(a[:, 2]).transpose(0, 2, 1)
    jacobian = np.empty((len(a), 3, 6 + NC))  # of expected minus measured motion
    jacobian[:, :, :3], jacobian[:, :, 3:6] = -back @ lever(b - a), back
    jacobian[:, :, 6:] = -by_calibration
    jacobian[:, 0, 6 + SPEED_SCALE] += error[:, 0]
    jacobian[:, 1, 6 + SPEED_SCALE] += aside * error[:, 1]
    jacobian[:, 1, 6 + SIDEWAYS_SCALE] += strafes * speed * error[:, 1]
    jacobian /= size[:, :, None]
    lag = [6 + DELAY, 6 + TIME_CONSTANT]
    jacobian[:, :, lag] -= (strafes * steps[:, PER_S])[:, None, None] * error[:, :, None]
    information = steps[:, INFORMATION].reshape(-1, 3, 3)
    square = ((information @ error[:, :, None])[:, :, 0] * error).sum(axis=1)
    return OdometryErrors(error, jacobian, information, cauchy_weights(square))


def add_odometry(e: NormalEquations, motions: OdometryErrors) -> None:
    """Add odometry factors to the normal equations."""
    error, jacobian, information, weight = motions
    both = np.concatenate([jacobian, error[:, :, None]], axis=2)
    weighted = weight[:, None, None] * information @ both
    blocks = jacobian[:, :, :6].transpose(0, 2, 1) @ weighted
    e.own[:-1] += blocks[:, :3, :3]
    e.own[1:] += blocks[:, 3:, 3:6]
    e.next[:] += blocks[:, :3, 3:6]
    e.shared[:-1, :, :NC] += blocks[:, :3, 6:-1]
    e.shared[1:, :, :NC] += blocks[:, 3:, 6:-1]
    e.slope[:-1] += blocks[:, :3, -1]
    e.slope[1:] += blocks[:, 3:, -1]
    common = jacobian[:, :, 6:].reshape(-1, NC).T @ weighted[:, :, 6:].reshape(-1, NC + 1)
    e.common[:NC, :NC] += common[:, :-1]
    e.common_slope[:NC] += common[:, -1]


class WeighedSightings(NamedTuple):
    """Bearing factors, linearised and normalised by effective standard deviations."""

    residual: np.ndarray
    """(m,): normalised residual, measured minus expected bearing [1]."""
    jacobian: np.ndarray
    """(m, 15): normalised Jacobian of the expected one by pose, calibration and landmark."""
    pose: np.ndarray
    """(m,), int: the pose from which each was made ..."""
    landmark: np.ndarray
    """(m,), int: ... and its landmark."""


def bearing_residuals(
    bearings: np.ndarray, eyes: np.ndarray, by_head: np.ndarray, positions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return residuals of bearings (m,), and the Jacobian of the expected ones (m, 15).

    Bearings are from the camera's axis [rad], `eyes` (m, 3) the camera's poses and `by_head` (m, 3,
    12) their Jacobians (`Frames.eyes`), or one of each for all, `positions` (m, 2) those of the
    landmarks [m]. Residuals are measured minus expected [rad], wrapped; the Jacobian is by
    keyframe's pose, calibration and landmark.
    """
    seen = sight(eyes, positions)
    by_eye = np.empty((len(bearings), 1, 3))
    np.negative(seen.by_place, out=by_eye[:, 0, :2])
    by_eye[:, 0, 2] = -1.0
    jacobian = np.empty((len(bearings), 5 + NC))
    jacobian[:, : 3 + NC] = (by_eye @ by_head)[:, 0]
    jacobian[:, 3 + NC :] = seen.by_place
    return np.asarray(wrap(bearings - seen.bearing)), jacobian


def weigh_sightings(
    residual: np.ndarray,
    jacobian: np.ndarray,
    sigma: np.ndarray,
    effective: np.ndarray,
    pose: np.ndarray,
    landmark: np.ndarray,
) -> WeighedSightings:
    """Normalise bearing factors, with a redescending M-estimator against large residuals.

    `residual` (m,) and `jacobian` (m, 15) are of `bearing_residuals`, `sigma` and `effective` (m,)
    the standard deviations, and those given earlier sightings [rad], `pose` and `landmark` (m,) the
    indices of each.
    """
    scale = 1.0 / (effective * np.maximum(np.abs(residual) / (GATE * sigma), 1.0))
    return WeighedSightings(scale * residual, scale[:, None] * jacobian, pose, landmark)


def add_sightings(e: NormalEquations, seen: WeighedSightings) -> None:
    """Add bearing factors to the normal equations of w poses, calibration and n landmarks."""
    if not seen.residual.size:
        return
    jacobian, w, n = seen.jacobian, len(e.own), (len(e.common) - NC) // 2
    columns = np.concatenate([jacobian[:, :HEAD], seen.residual[:, None], jacobian[:, HEAD:]], 1)
    by_pose, by_common, by_landmark = columns[:, :3], columns[:, 3:HEAD], columns[:, HEAD + 1 :]

    of_pose = sum_by(seen.pose, by_pose, columns[:, : HEAD + 1], w)
    e.own[:] += of_pose[:, :, :3]
    e.shared[:, :, :NC] += of_pose[:, :, 3:-1]
    e.slope[:] += of_pose[:, :, -1]
    e.common[:NC, :NC] += by_common.T @ by_common
    e.common_slope[:NC] += by_common.T @ columns[:, HEAD]

    of_landmark = sum_by(seen.landmark, by_landmark, columns[:, 3:], n)
    cross = of_landmark[:, :, :NC].reshape(2 * n, NC)
    e.common[NC:, :NC] += cross
    e.common[:NC, NC:] += cross.T
    at = np.arange(n)
    landmarks = e.common[NC:, NC:].reshape(n, 2, n, 2)
    landmarks[at, :, at] += of_landmark[:, :, NC + 1 :]
    e.common_slope[NC:] += of_landmark[:, :, NC].ravel()

    e.shared[:, :, NC:] += sum_by_pair(seen.pose, seen.landmark, by_pose, by_landmark, w, n)


def sum_by(group: np.ndarray, left: np.ndarray, right: np.ndarray, groups: int) -> np.ndarray:
    """Return the sums of outer products of rows (m, i), (m, j) by group, (groups, i, j).

    Groups are padded to equal size and multiplied as a batch, unless most of that would be empty.
    """
    counts = np.bincount(group, minlength=groups)
    most = int(counts.max(initial=0))
    if groups * most > MAX_PADDING * len(group):
        return _sum_one_by_one(group, left, right, groups)
    order = np.argsort(group, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(group)) - np.repeat(np.cumsum(counts) - counts, counts)
    a = np.zeros((groups, most, left.shape[1]))
    b = np.zeros((groups, most, right.shape[1]))
    a[group, place], b[group, place] = left, right
    return np.asarray(a.transpose(0, 2, 1) @ b)


def sum_by_pair(
    first: np.ndarray, second: np.ndarray, left: np.ndarray, right: np.ndarray, w: int, n: int
) -> np.ndarray:
    """Return such sums by pairs of groups, (w, i, j n), where each pair has few rows."""
    sums = _sum_one_by_one(first * n + second, left, right, w * n)
    i, j = sums.shape[1:]
    return sums.reshape(w, n, i, j).transpose(0, 2, 1, 3).reshape(w, i, n * j)


def _sum_one_by_one(
    group: np.ndarray, left: np.ndarray, right: np.ndarray, groups: int
) -> np.ndarray:
    """Return what `sum_by` does, in memory proportional to rows and groups."""
    blocks = left[:, :, None] * right[:, None, :]
    size = left.shape[1] * right.shape[1]
    at = size * group[:, None] + np.arange(size)
    sums = np.bincount(at.ravel(), blocks.ravel(), size * groups)
    return np.asarray(sums.reshape(groups, *blocks.shape[1:]), float)  # empty ones are integers


class SightedFrom(NamedTuple):
    """Bearings of m sightings, and the frames from which they were made."""

    bearings: np.ndarray
    """(m,): from the camera's axis [rad]."""
    sigmas: np.ndarray
    """(m,): their standard deviations [rad] ..."""
    effective: np.ndarray
    """(m,): ... and the effective ones, larger for correlated errors."""
    frame: np.ndarray
    """(m,), int: the frame of each ..."""
    landmark: np.ndarray
    """(m,), int: ... and its landmark."""
    pose: np.ndarray
    """(f,), int: of each frame the pose that it belongs to, ..."""
    free: np.ndarray
    """(f, 3): ... the camera's pose in its keyframe's frame for a calibration of zero ..."""
    jacobians: np.ndarray
    """(f, 3, 10): ... and the Jacobian of that by the calibration."""


def weighed(seen: SightedFrom, poses: np.ndarray, shared: np.ndarray) -> WeighedSightings:
    """Return bearings as factors, at poses (w, 3) and shared unknowns (9 + 2 n,)."""
    first = int(seen.frame.min(initial=len(seen.pose)))
    used, each = slice(first, int(seen.frame.max(initial=0)) + 1), seen.frame - first
    of_frame = poses[seen.pose[used]]
    eyes, by_head = cameras(seen.free[used], seen.jacobians[used], of_frame, shared[:NC])
    places = shared[NC:].reshape(-1, 2)[seen.landmark]
    found, pose = bearing_residuals(seen.bearings, eyes[each], by_head[each], places), seen.pose
    return weigh_sightings(*found, seen.sigmas, seen.effective, pose[seen.frame], seen.landmark)


def cameras(
    free: np.ndarray, jacobians: np.ndarray, poses: np.ndarray, calibration: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the camera's poses in the odometry frame (f, 3), and their Jacobians (f, 3, 13).

    From keyframe poses (f, 3) or (3,) and the present calibration (10,); Jacobians are by both.
    `free` and `jacobians` are as in `SightedFrom`.
    """
    eyes, by_pose, by_camera = composition(poses, free + jacobians @ calibration)
    return eyes, np.concatenate([by_pose, by_camera @ jacobians], axis=-1)
