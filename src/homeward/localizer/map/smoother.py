"""Fixed-lag smoother: the last keyframes, the calibration and the landmarks, in the odometry frame.

The poses of the last keyframes stay open to correction; when some leave, what
they say is kept as a Gaussian on the pose after them, the calibration and the landmarks (a Schur
complement). Calibration and landmarks are shared by all poses; see `elimination` for the algebra.

Home is not in here: a home bearing may turn out to be wrong, and nothing that may have to be taken
back is marginalised.
"""

from __future__ import annotations

import numpy as np

from homeward.localizer.geometry import compose
from homeward.localizer.map import elimination
from homeward.localizer.map.factors import STEP, add_odometry, add_sightings, step_row
from homeward.localizer.map.sightings import (
    COLUMNS,
    KEYFRAME,
    LANDMARK,
    NC,
    bearing_residuals,
    scale_noise,
    without_landmark,
)
from homeward.localizer.map.state import HEAD, Marginal
from homeward.localizer.motion.preintegration import MOUNT, OF_ODOMETRY, Motion

FAR_M = 1e3
"""A landmark that was just entered is this uncertain a priori [m]."""
LONGEST_TURN, LONGEST_SHARE, NEAR_M = 0.2, 0.3, 0.3
"""A step turns no keyframe further [rad], and moves no landmark by more of its distance [1]."""
STEPS = 5
"""Gauss-Newton steps at most."""
SETTLED = 2e-2
"""Smaller steps of poses [m, rad] and landmarks [distance] end it; the rest goes as its square."""


class Window:
    """Keyframes, calibration and landmarks, and what ties them together.

    Parameters
    ----------
    odometry_sigmas : ndarray, shape (4,)
        Of the odometry's calibration a priori, around zero.
    drift : ndarray, shape (7,)
        Variances by which the calibration drifts, per second.
    mount_sigmas : ndarray, shape (3,)
        Of the camera's on the robot, around zero.
    """

    def __init__(
        self, odometry_sigmas: np.ndarray, drift: np.ndarray, mount_sigmas: np.ndarray
    ) -> None:
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
        self.settled = True
        """Whether the last `solve` came to rest."""
        self.mount_sigmas = mount_sigmas
        """What is believed beforehand may change; so it is never marginalised."""
        self._steps = np.zeros((0, STEP))
        """(w - 1, STEP): the motions from keyframe to keyframe."""
        self._closed: list[tuple[np.ndarray, list[float], np.ndarray, np.ndarray]] | None = None
        self._drift = drift
        of_odometry = 1.0 / np.maximum(odometry_sigmas, 1e-6) ** 2
        information = np.concatenate([np.full(3, 1e10), of_odometry, np.zeros(len(mount_sigmas))])
        self._prior_information = np.diag(information)
        self._prior_gradient = np.zeros(HEAD)
        self._prior_at = np.zeros(HEAD)
        self._first_information = self._prior_information

    def keep_closed(self) -> None:
        """Keep closed keyframes too, for `whole`; memory then grows with the drive."""
        self._closed = []

    def whole(self) -> Window:
        """Return a window in which every keyframe since `keep_closed` is open, not yet solved."""
        whole = Window(np.ones(len(OF_ODOMETRY)), self._drift, self.mount_sigmas)
        closed = self._closed or []
        whole.first = self.first - sum(len(poses) for poses, _, _, _ in closed)
        whole.poses = np.concatenate([*(poses for poses, _, _, _ in closed), self.poses])
        whole.stamps = [t for _, stamps, _, _ in closed for t in stamps] + self.stamps
        whole.sightings = np.concatenate([*(rows for _, _, rows, _ in closed), self.sightings])
        whole._steps = np.concatenate([*(steps for _, _, _, steps in closed), self._steps])
        whole.calibration, whole.positions = self.calibration, self.positions
        size = HEAD + self.positions.size
        whole._prior_information = np.eye(size) * FAR_M**-2
        whole._prior_information[:HEAD, :HEAD] = self._first_information
        whole._prior_gradient, whole._prior_at = np.zeros(size), np.zeros(size)
        return whole

    @property
    def newest(self) -> int:
        """Number of the newest keyframe."""
        return self.first + len(self.poses) - 1

    def poses_of(self, rows: np.ndarray) -> np.ndarray:
        """Return the poses of the keyframes of rows of the table, shape (m, 3)."""
        return np.asarray(self.poses[rows[:, KEYFRAME].astype(int) - self.first])

    def add_keyframe(self, t: float, motion: Motion) -> int:
        """Add a keyframe at `t` [s], reached from the last one by `motion`; return its number."""
        pose = compose(self.poses[-1], motion.delta)
        self.poses = np.concatenate([self.poses, pose[None]])
        self.stamps.append(t)
        self.turn_variances.append(float(motion.covariance[2, 2]))
        self.shift_variances.append(float(motion.covariance[0, 0] + motion.covariance[1, 1]))
        self._steps = np.concatenate([self._steps, step_row(motion, self.calibration)])
        return self.newest

    def add_landmark(self, position: np.ndarray) -> int:
        """Add a landmark at `position` [m], shape (2,), so far without sightings."""
        number = len(self.positions)
        self.positions = np.concatenate([self.positions, position[None, :]])
        size = HEAD + 2 * number
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

    def scale_noise(self, factor: float) -> None:
        """Let the bearings' own deviations be so many times as large, of all that are open."""
        for rows in (self.sightings, *(rows for _, _, rows, _ in self._closed or [])):
            scale_noise(rows, factor)

    def drop_landmark(self, number: int) -> None:
        """Take a landmark out; those after it move up by one number."""
        size = len(self._prior_gradient)
        at = HEAD + 2 * number
        out, keep = np.array([at, at + 1]), np.delete(np.arange(size), [at, at + 1])
        information = self._prior_information
        gain = np.linalg.solve(information[np.ix_(out, out)], information[np.ix_(out, keep)]).T
        now = self._head_and_map()
        gradient = self._prior_gradient - information @ (now - self._prior_at)
        self._prior_information = (
            information[np.ix_(keep, keep)] - gain @ information[np.ix_(out, keep)]
        )
        self._prior_gradient = gradient[keep] - gain @ gradient[out]
        self._prior_at = now[keep]
        self.positions = np.delete(self.positions, number, axis=0)
        self.sightings = without_landmark(self.sightings, number)
        if self._closed is not None:
            self._closed = [(p, t, without_landmark(r, number), m) for p, t, r, m in self._closed]

    def adopt(self, marginal: Marginal) -> None:
        """Go on from what is now known of the newest pose, the calibration and the landmarks."""
        self.poses[-1] = marginal.mean[:3]
        self.calibration = marginal.mean[3:HEAD].copy()
        self.positions = marginal.positions.copy()

    def solve(self) -> Marginal:
        """Correct everything that is open, and return what is now known of the newest pose.

        Raises
        ------
        numpy.linalg.LinAlgError
            When the normal equations are singular.
        """
        for _ in range(STEPS):
            poses, common, covariance = elimination.solve(self._all())
            if not (np.isfinite(poses).all() and np.isfinite(covariance).all()):
                raise np.linalg.LinAlgError("a step is not finite")
            self.settled = self._move(poses, common) < SETTLED
            if self.settled:
                break
        mean = np.concatenate([self.poses[-1], self.calibration, self.positions.ravel()])
        return Marginal(mean, covariance)

    def marginals(self) -> list[Marginal]:
        """Return what is known of each open pose, as `solve` does of the newest, after it."""
        own, by_common, common = elimination.marginals(self._all())
        shared = np.concatenate([self.calibration, self.positions.ravel()])
        found = []
        for pose, covariance, lever in zip(self.poses, own, by_common, strict=True):
            cross = -lever @ common
            joint = np.block([[covariance, cross], [cross.T, common]])
            found.append(Marginal(np.concatenate([pose, shared]), joint))
        return found

    def marginalise(self, count: int) -> None:
        """Marginalise the oldest `count` poses: what they say about everything else is kept."""
        old = self.sightings[:, KEYFRAME] < self.first + count
        rows = self.sightings[old]
        left = elimination.eliminate(self._normal_equations(count + 1, rows))
        self._prior_information, self._prior_gradient = left.information, left.gradient
        self._let_drift(self.stamps[count] - self.stamps[0])
        if self._closed is not None:
            closed = (self.poses[:count], self.stamps[:count], rows, self._steps[:count])
            self._closed.append(closed)
        self.first += count
        self.poses, self.stamps = self.poses[count:], self.stamps[count:]
        self._steps = self._steps[count:]
        self.turn_variances = self.turn_variances[count:]
        self.shift_variances = self.shift_variances[count:]
        self.sightings = self.sightings[~old]
        self._prior_at = self._head_and_map()

    def residuals(self) -> np.ndarray:
        """Return measured minus expected bearing of each sighting, shape (m,) [rad]."""
        rows = self.sightings
        positions = self.positions[rows[:, LANDMARK].astype(int)]
        return bearing_residuals(self.poses_of(rows), self.calibration, positions, rows)[0]

    def _head_and_map(self) -> np.ndarray:
        """Return oldest pose, calibration and landmarks in one vector."""
        return np.concatenate([self.poses[0], self.calibration, self.positions.ravel()])

    def _let_drift(self, seconds: float) -> None:
        """Let the calibration drift: the old one is marginalised, the new one takes its place."""
        c = slice(3, HEAD)
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
        turn = float(np.abs(poses[:, 2]).max())
        distances = np.hypot(*(self.positions - self.poses[-1, :2]).T) + NEAR_M
        shares = np.hypot(*landmarks.T) / distances
        share = float(shares.max()) if shares.size else 0.0
        scale = 1.0 / max(1.0, turn / LONGEST_TURN, share / LONGEST_SHARE)
        self.poses = self.poses + scale * poses
        self.calibration = self.calibration + scale * common[:NC]
        self.positions = self.positions + scale * landmarks
        return float(max(turn, share, np.abs(poses[:, :2]).max(), np.abs(common[:NC]).max()))

    def _normal_equations(self, w: int, rows: np.ndarray) -> elimination.NormalEquations:
        """Return what the oldest w poses and rows from them say, and the prior.

        They are linearised where poses, calibration and landmarks are believed to be. What is
        believed of the camera's mount beforehand is not among it.
        """
        equations = elimination.NormalEquations.zeros(w, NC + self.positions.size)
        poses, calibration = self.poses[:w], self.calibration
        self._add_prior(equations)
        add_odometry(equations, poses, calibration, self._steps[: w - 1])
        add_sightings(equations, poses, calibration, self.positions, rows, self.first)
        return equations

    def _all(self) -> elimination.NormalEquations:
        """Return everything that is known."""
        equations = self._normal_equations(len(self.poses), self.sightings)
        at, information = np.arange(NC)[MOUNT], self.mount_sigmas**-2.0
        equations.common[at, at] += information
        equations.common_slope[at] -= information * self.calibration[at]
        return equations

    def _add_prior(self, e: elimination.NormalEquations) -> None:
        """Add what closed poses said."""
        information = self._prior_information
        downhill = self._prior_gradient - information @ (self._head_and_map() - self._prior_at)
        e.own[0] += information[:3, :3]
        e.shared[0] += information[:3, 3:]
        e.common[:] += information[3:, 3:]
        e.slope[0] += downhill[:3]
        e.common_slope[:] += downhill[3:]
