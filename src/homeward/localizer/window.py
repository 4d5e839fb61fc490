"""The map: the last keyframes, the calibration and the landmarks, in the odometry frame.

A fixed-lag smoother. The poses of the last keyframes stay open to correction; when one leaves, what
it says is kept as a Gaussian on the pose after it, the calibration and the landmarks (a Schur
complement). Calibration and landmarks are shared by all poses; see `chain` for the algebra.

Home is not in here: a home bearing may turn out to be wrong, and nothing that may have to be taken
back is marginalised.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from homeward.angles import wrap
from homeward.localizer import chain
from homeward.localizer.odometry import CALIBRATION, CAMERA_YAW, Motion

NC = len(CALIBRATION)
KEYFRAME, LANDMARK, BEARING, SIGMA, OFFSET = 0, 1, 2, 3, slice(4, 7)
OFFSET_JACOBIAN = slice(7, 7 + 3 * NC)
COLUMNS = 7 + 3 * NC
"""Columns of the table of sightings: numbers of keyframe and landmark, bearing [rad], its standard
deviation [rad], the camera's pose in the keyframe's, and its derivative by the calibration."""
TRUSTED = 4.0
"""Residuals beyond this many standard deviations lose weight, by the square."""
FAR_M = 1e3
"""A landmark that was just entered is this uncertain a priori [m]."""
LONGEST_TURN, LONGEST_SHARE, NEAR_M = 0.2, 0.3, 0.3
"""A step turns no keyframe further [rad], and moves no landmark by more of its distance [1]."""
STEPS = 5
"""Gauss-Newton steps at most."""
SETTLED = 2e-3
"""Steps smaller than this end the iteration [m or rad]."""


@dataclass(frozen=True)
class Marginal:
    """The Gaussian on the newest pose, the calibration and the landmarks."""

    mean: np.ndarray
    """(3 + 5 + 2 n,)"""
    covariance: np.ndarray
    """(3 + 5 + 2 n, 3 + 5 + 2 n)"""


def landmark_columns(number: int) -> slice:
    """Return where landmark `number` stands in a `Marginal`."""
    return slice(3 + NC + 2 * number, 5 + NC + 2 * number)


class Window:
    """Keyframes, calibration and landmarks, and what ties them together.

    Parameters
    ----------
    calibration_sigmas : ndarray, shape (5,)
        A priori, around zero.
    drift : ndarray, shape (5,)
        Variances by which the calibration drifts, per second.
    """

    def __init__(self, calibration_sigmas: np.ndarray, drift: np.ndarray) -> None:
        self.first = 0
        """Number of the oldest keyframe that is still open."""
        self.poses = np.zeros((1, 3))
        """(w, 3), of the open keyframes in the odometry frame."""
        self.stamps = [0.0]
        """Times of the open keyframes [s]."""
        self.calibration = np.zeros(NC)
        self.positions = np.zeros((0, 2))
        """(n, 2), of the landmarks in the odometry frame [m]."""
        self.sightings = np.zeros((0, COLUMNS))
        self.turn_variances: list[float] = []
        """Of the motion into each open keyframe but the oldest [rad^2]."""
        self.shift_variances: list[float] = []
        """The same of its length [m^2]."""
        self._motions: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self._closed: list[tuple[np.ndarray, float, np.ndarray]] | None = None
        self._closed_motions: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self._drift = drift
        information = np.concatenate(
            [np.full(3, 1e10), 1.0 / np.maximum(calibration_sigmas, 1e-6) ** 2]
        )
        self._prior_information = np.diag(information)
        self._prior_gradient = np.zeros(3 + NC)
        self._prior_at = np.zeros(3 + NC)
        self._first_information = self._prior_information

    def keep_closed(self) -> None:
        """Keep closed keyframes too, for `whole`; memory then grows with the drive."""
        self._closed = []

    def whole(self) -> Window:
        """Return a window in which every keyframe since `keep_closed` is open, not yet solved."""
        closed = self._closed or []
        whole = Window(np.ones(NC), self._drift)
        whole.first = self.first - len(closed)
        whole.poses = (
            np.concatenate([[p for p, _, _ in closed], self.poses]) if closed else self.poses
        )
        whole.stamps = [t for _, t, _ in closed] + self.stamps
        whole.calibration, whole.positions = self.calibration, self.positions
        whole.sightings = np.concatenate([*(rows for _, _, rows in closed), self.sightings])
        whole._motions = self._closed_motions + self._motions
        size = 3 + NC + self.positions.size
        whole._prior_information = np.eye(size) * FAR_M**-2
        whole._prior_information[: 3 + NC, : 3 + NC] = self._first_information
        whole._prior_gradient, whole._prior_at = np.zeros(size), np.zeros(size)
        return whole

    @property
    def newest(self) -> int:
        """Number of the newest keyframe."""
        return self.first + len(self.poses) - 1

    def add_keyframe(self, t: float, motion: Motion) -> int:
        """Add a keyframe at `t` [s], reached from the last one by `motion`; return its number."""
        x, y, psi = self.poses[-1]
        c, s = math.cos(psi), math.sin(psi)
        dx, dy, turn = motion.delta
        pose = np.array([[x + c * dx - s * dy, y + s * dx + c * dy, psi + turn]])
        information = np.linalg.inv(motion.covariance + np.diag([1e-8, 1e-8, 1e-8]))
        free = motion.delta - motion.jacobian @ self.calibration
        self.poses = np.concatenate([self.poses, pose])
        self.stamps.append(t)
        self.turn_variances.append(float(motion.covariance[2, 2]))
        self.shift_variances.append(float(motion.covariance[0, 0] + motion.covariance[1, 1]))
        self._motions.append((free, information, motion.jacobian))
        return self.newest

    def add_landmark(self, position: np.ndarray) -> int:
        """Add a landmark at `position` [m], shape (2,), so far without sightings."""
        number = len(self.positions)
        self.positions = np.concatenate([self.positions, position[None, :]])
        size = 3 + NC + 2 * number
        grown = np.zeros((size + 2, size + 2))
        grown[:size, :size] = self._prior_information
        grown[size, size] = grown[size + 1, size + 1] = FAR_M**-2
        self._prior_information = grown
        self._prior_gradient = np.append(self._prior_gradient, [0.0, 0.0])
        self._prior_at = np.append(self._prior_at, position)
        return number

    def add_sightings(self, rows: np.ndarray) -> None:
        """Add rows of the table of sightings, shape (m, COLUMNS), of open keyframes."""
        self.sightings = np.concatenate([self.sightings, rows])

    def drop_sightings(self, drop: np.ndarray) -> None:
        """Drop the sightings that are marked in `drop`, shape (m,), bool."""
        self.sightings = self.sightings[~drop]

    def drop_landmark(self, number: int) -> None:
        """Take a landmark out; those after it move up by one number."""
        size = len(self._prior_gradient)
        at = 3 + NC + 2 * number
        out, keep = np.array([at, at + 1]), np.delete(np.arange(size), [at, at + 1])
        information = self._prior_information
        gain = np.linalg.solve(information[np.ix_(out, out)], information[np.ix_(out, keep)]).T
        now = np.concatenate([self.poses[0], self.calibration, self.positions.ravel()])
        gradient = self._prior_gradient - information @ (now - self._prior_at)
        self._prior_information = (
            information[np.ix_(keep, keep)] - gain @ information[np.ix_(out, keep)]
        )
        self._prior_gradient = gradient[keep] - gain @ gradient[out]
        self._prior_at = now[keep]
        self.positions = np.delete(self.positions, number, axis=0)
        self.sightings = _without_landmark(self.sightings, number)
        if self._closed is not None:
            self._closed = [(p, t, _without_landmark(r, number)) for p, t, r in self._closed]

    def solve(self) -> Marginal:
        """Correct everything that is open, and return what is now known of the newest pose.

        Raises
        ------
        numpy.linalg.LinAlgError
            When the normal equations are singular.
        """
        for _ in range(STEPS):
            poses, common, covariance = chain.solve(
                self._normal_equations(len(self.poses), self.sightings)
            )
            if not (np.isfinite(poses).all() and np.isfinite(covariance).all()):
                raise np.linalg.LinAlgError("a step is not finite")
            size = self._move(poses, common)
            if size < SETTLED:
                break
        mean = np.concatenate([self.poses[-1], self.calibration, self.positions.ravel()])
        return Marginal(mean, covariance)

    def marginals(self) -> list[Marginal]:
        """Return what is known of each open pose, as `solve` does of the newest, after it."""
        own, by_common, common = chain.marginals(
            self._normal_equations(len(self.poses), self.sightings)
        )
        shared = np.concatenate([self.calibration, self.positions.ravel()])
        found = []
        for pose, covariance, lever in zip(self.poses, own, by_common, strict=True):
            cross = -lever @ common
            joint = np.block([[covariance, cross], [cross.T, common]])
            found.append(Marginal(np.concatenate([pose, shared]), joint))
        return found

    def forget_oldest(self) -> None:
        """Close the oldest pose, keeping what it says about everything else."""
        of_oldest = self.sightings[:, KEYFRAME] == self.first
        equations = self._normal_equations(2, self.sightings[of_oldest])
        self._prior_information, self._prior_gradient = equations.without_first()
        self._let_drift(self.stamps[1] - self.stamps[0])
        if self._closed is not None:
            self._closed.append((self.poses[0], self.stamps[0], self.sightings[of_oldest]))
            self._closed_motions.append(self._motions[0])
        self.first += 1
        self.poses, self.stamps = self.poses[1:], self.stamps[1:]
        self._motions, self.turn_variances = self._motions[1:], self.turn_variances[1:]
        self.shift_variances = self.shift_variances[1:]
        self.drop_sightings(of_oldest)
        self._prior_at = np.concatenate([self.poses[0], self.calibration, self.positions.ravel()])

    def residuals(self) -> np.ndarray:
        """Return measured minus expected bearing of each sighting, shape (m,) [rad]."""
        return np.asarray(self._expected(self.sightings)[0])

    def _let_drift(self, seconds: float) -> None:
        """Let the calibration drift: the old one is marginalised, the new one takes its place."""
        c = slice(3, 3 + NC)
        inverse = np.diag(1.0 / (self._drift * max(seconds, 1e-3) + 1e-16))
        information, gradient = self._prior_information, self._prior_gradient
        gain = np.linalg.inv(information[c, c] + inverse)
        left = information[:, c] @ gain
        new = information - left @ information[c, :]
        new_gradient = gradient - left @ gradient[c]
        cross = left @ inverse
        new[:, c], new[c, :] = cross, cross.T
        new[c, c] = inverse - inverse @ gain @ inverse
        new_gradient[c] = inverse @ gain @ gradient[c]
        self._prior_information, self._prior_gradient = 0.5 * (new + new.T), new_gradient

    def _move(self, poses: np.ndarray, common: np.ndarray) -> float:
        """Apply a step, no longer than the linearisation can be trusted; return its size."""
        landmarks = common[NC:].reshape(-1, 2)
        turn = float(np.abs(poses[:, 2]).max()) / LONGEST_TURN
        distances = np.hypot(*(self.positions - self.poses[-1, :2]).T) + NEAR_M
        shares = np.hypot(*landmarks.T) / distances
        share = float(shares.max()) / LONGEST_SHARE if shares.size else 0.0
        scale = 1.0 / max(1.0, turn, share)
        self.poses = self.poses + scale * poses
        self.calibration = self.calibration + scale * common[:NC]
        self.positions = self.positions + scale * landmarks
        return float(max(np.abs(poses).max(), np.abs(common).max()))

    def _normal_equations(self, w: int, rows: np.ndarray) -> chain.NormalEquations:
        """Return prior, the odometry of the first `w` poses and `rows`, linearised."""
        equations = chain.NormalEquations.zeros(w, NC + 2 * len(self.positions))
        self._add_prior(equations)
        self._add_odometry(w, equations)
        if len(rows):
            self._add_sightings(w, rows, equations)
        return equations

    def _add_prior(self, e: chain.NormalEquations) -> None:
        """Add what closed poses said."""
        at = np.concatenate([self.poses[0], self.calibration, self.positions.ravel()])
        information = self._prior_information
        downhill = self._prior_gradient - information @ (at - self._prior_at)
        e.own[0] += information[:3, :3]
        e.shared[0] += information[:3, 3:]
        e.common[:] += information[3:, 3:]
        e.slope[0] += downhill[:3]
        e.common_slope[:] += downhill[3:]

    def _add_odometry(self, w: int, e: chain.NormalEquations) -> None:
        """Add the motions between the first `w` poses."""
        if w < 2:
            return
        free = np.array([m[0] for m in self._motions[: w - 1]])
        information = np.array([m[1] for m in self._motions[: w - 1]])
        by_calibration = np.array([m[2] for m in self._motions[: w - 1]])
        a, b = self.poses[: w - 1], self.poses[1:w]
        c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
        d = b - a
        local = np.stack([c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1], d[:, 2]], axis=1)
        error = free + by_calibration @ self.calibration - local
        jacobian = np.zeros((w - 1, 3, 6 + NC))  # of the expected motion, less the odometry's
        jacobian[:, 0, 0] = jacobian[:, 1, 1] = -c
        jacobian[:, 0, 1], jacobian[:, 1, 0] = -s, s
        jacobian[:, 0, 2], jacobian[:, 1, 2] = local[:, 1], -local[:, 0]
        jacobian[:, 2, 2], jacobian[:, 2, 5] = -1.0, 1.0
        jacobian[:, 0, 3] = jacobian[:, 1, 4] = c
        jacobian[:, 0, 4], jacobian[:, 1, 3] = s, -s
        jacobian[:, :, 6:] = -by_calibration
        weighted = jacobian.transpose(0, 2, 1) @ information
        blocks = weighted @ jacobian
        slopes = (weighted @ error[:, :, None])[:, :, 0]
        e.own[:-1] += blocks[:, :3, :3]
        e.own[1:] += blocks[:, 3:6, 3:6]
        e.next[:] += blocks[:, :3, 3:6]
        e.shared[:-1, :, :NC] += blocks[:, :3, 6:]
        e.shared[1:, :, :NC] += blocks[:, 3:6, 6:]
        e.common[:NC, :NC] += blocks[:, 6:, 6:].sum(axis=0)
        e.slope[:-1] += slopes[:, :3]
        e.slope[1:] += slopes[:, 3:6]
        e.common_slope[:NC] += slopes[:, 6:].sum(axis=0)

    def _add_sightings(self, w: int, rows: np.ndarray, e: chain.NormalEquations) -> None:
        """Add sightings, those with large residuals at less weight."""
        residual, jacobian = self._expected(rows)
        sigma = rows[:, SIGMA]
        scale = 1.0 / (sigma * np.maximum(np.abs(residual) / (TRUSTED * sigma), 1.0))
        jacobian, residual = jacobian * scale[:, None], residual * scale
        keyframe = rows[:, KEYFRAME].astype(int) - self.first
        landmark = rows[:, LANDMARK].astype(int)
        n = len(self.positions)
        by_pose, by_calibration = jacobian[:, :3], jacobian[:, 3 : 3 + NC]
        by_landmark = jacobian[:, 3 + NC :]
        head = np.concatenate([jacobian[:, : 3 + NC], residual[:, None]], axis=1)

        of_pose = _sum_by(keyframe, by_pose[:, :, None] * head[:, None, :], w)
        e.own[:] += of_pose[:, :, :3]
        e.shared[:, :, :NC] += of_pose[:, :, 3:-1]
        e.slope[:] += of_pose[:, :, -1]
        e.common[:NC, :NC] += by_calibration.T @ by_calibration
        e.common_slope[:NC] += by_calibration.T @ residual

        tail = np.concatenate([by_calibration, by_landmark, residual[:, None]], axis=1)
        of_landmark = _sum_by(landmark, by_landmark[:, :, None] * tail[:, None, :], n)
        cross = of_landmark[:, :, :NC].reshape(2 * n, NC)
        e.common[NC:, :NC] += cross
        e.common[:NC, NC:] += cross.T
        at = np.arange(n)
        landmarks = e.common[NC:, NC:].reshape(n, 2, n, 2)
        landmarks[at, :, at] += of_landmark[:, :, NC:-1]
        e.common_slope[NC:] += of_landmark[:, :, -1].ravel()

        both = _sum_by(
            keyframe * n + landmark, by_pose[:, :, None] * by_landmark[:, None, :], w * n
        )
        e.shared[:, :, NC:] += both.reshape(w, n, 3, 2).transpose(0, 2, 1, 3).reshape(w, 3, 2 * n)

    def _expected(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals (m,) and the Jacobian (m, 9) of expected bearings.

        Columns of the Jacobian: keyframe's pose, calibration, landmark.
        """
        pose = self.poses[rows[:, KEYFRAME].astype(int) - self.first]
        landmark = self.positions[rows[:, LANDMARK].astype(int)]
        return bearing_residuals(pose, self.calibration, landmark, rows)


def bearing_residuals(
    pose: np.ndarray, calibration: np.ndarray, landmark: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return measured minus expected bearings and the Jacobian of the expected ones.

    Parameters
    ----------
    pose : ndarray, shape (m, 3)
        Of the keyframes.
    calibration : ndarray, shape (5,)
        As it is believed to be.
    landmark : ndarray, shape (m, 2)
        Positions [m].
    rows : ndarray, shape (m, COLUMNS)
        Of the table of sightings.

    Returns
    -------
    residual : ndarray, shape (m,)
        [rad], wrapped.
    jacobian : ndarray, shape (m, 9)
        By keyframe's pose, calibration and landmark.
    """
    by_calibration = rows[:, OFFSET_JACOBIAN].reshape(-1, 3, NC)
    offset = rows[:, OFFSET] + by_calibration @ calibration
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    ox, oy = c * offset[:, 0] - s * offset[:, 1], s * offset[:, 0] + c * offset[:, 1]
    dx, dy = landmark[:, 0] - pose[:, 0] - ox, landmark[:, 1] - pose[:, 1] - oy
    square = np.maximum(dx * dx + dy * dy, 1e-6)
    expected = np.arctan2(dy, dx) - pose[:, 2] - offset[:, 2]
    gx, gy = -dy / square, dx / square
    jacobian = np.empty((len(rows), 5 + NC))
    jacobian[:, 0], jacobian[:, 1] = -gx, -gy
    jacobian[:, 2] = gx * oy - gy * ox - 1.0
    ux, uy = -(gx * c + gy * s), -(-gx * s + gy * c)
    jacobian[:, 3 : 3 + NC] = (
        ux[:, None] * by_calibration[:, 0]
        + uy[:, None] * by_calibration[:, 1]
        - by_calibration[:, 2]
    )
    jacobian[:, 3 + NC], jacobian[:, 4 + NC] = gx, gy
    return np.asarray(wrap(rows[:, BEARING] - expected)), jacobian


def sighting_row(
    keyframe: int,
    bearing: float,
    sigma: float,
    motion: Motion,
    mount: np.ndarray,
    calibration: np.ndarray,
) -> np.ndarray:
    """Return a row of the table of sightings, its landmark still open (-1).

    Parameters
    ----------
    keyframe : int
        Its number.
    bearing, sigma : float
        [rad]
    motion : Motion
        From the keyframe to the stamp.
    mount : ndarray, shape (3,)
        Pose of the camera on the robot.
    calibration : ndarray, shape (5,)
        Where `motion` was linearised.
    """
    c, s = math.cos(motion.delta[2]), math.sin(motion.delta[2])
    swung = np.array([c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]])
    jacobian = motion.jacobian.copy()
    jacobian[0] -= swung[1] * jacobian[2]
    jacobian[1] += swung[0] * jacobian[2]
    jacobian[2, CAMERA_YAW] += 1.0
    row = np.empty(COLUMNS)
    row[KEYFRAME], row[LANDMARK], row[BEARING], row[SIGMA] = keyframe, -1, bearing, sigma
    row[4], row[5] = motion.delta[0] + swung[0], motion.delta[1] + swung[1]
    row[6] = motion.delta[2] + mount[2]
    row[OFFSET] -= jacobian @ calibration
    row[6] += calibration[CAMERA_YAW]
    row[OFFSET_JACOBIAN] = jacobian.ravel()
    return row


def _without_landmark(rows: np.ndarray, number: int) -> np.ndarray:
    """Return the rows without those of a landmark; those after it move up by one number."""
    rows = rows[rows[:, LANDMARK] != number]
    rows[:, LANDMARK] -= rows[:, LANDMARK] > number
    return rows


def _sum_by(group: np.ndarray, blocks: np.ndarray, groups: int) -> np.ndarray:
    """Return the sums of blocks (m, i, j) with the same group, shape (groups, i, j)."""
    size = blocks.shape[1] * blocks.shape[2]
    flat = group[:, None] * size + np.arange(size)
    total = np.bincount(flat.ravel(), blocks.ravel(), groups * size)
    return np.asarray(total.reshape(groups, *blocks.shape[1:]))
