"""Fixed-lag smoother: recent keyframes, calibration and landmarks, in the odometry frame.

The state is one Gaussian on the newest pose, the calibration and the landmarks. Between solutions
it is propagated and updated as in an EKF. The poses of the last keyframes, the window, are kept as
well; from time to time all are solved together by Gauss-Newton. Poses that leave the window are
marginalised (Schur complement) into a Gaussian prior on the pose after them, the calibration and
the landmarks.

Home is not part of it: a home bearing may turn out to be wrong, and nothing that may have to be
undone is marginalised.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.covariance import ROUNDING
from homeward.geometry.se2 import MIN_DISTANCE, sight
from homeward.localizer import kernels
from homeward.localizer.inputs.correlated_errors import CorrelatedErrors
from homeward.localizer.map.gating import Prediction, predict_bearings
from homeward.localizer.map.prior import Prior
from homeward.localizer.map.ranges import range_residuals, range_sigmas, weigh_ranges
from homeward.localizer.map.sightings import (
    BEARING,
    COLUMNS,
    FRAME,
    KEYFRAME,
    LANDMARK,
    RANGE_SIGMA,
    SIGMA,
    Frames,
    effective_sigmas,
    scale_noise,
)
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.steps import scale_steps, step_row
from homeward.localizer.map.survey.factors import SurveyFactors
from homeward.localizer.motions import (
    CAMERA_X,
    CAMERA_YAW,
    DELAY,
    HEAD,
    MOUNT,
    NC,
    ODOMETRY_CALIBRATION,
    SPEED_SCALE,
    TIME_CONSTANT,
    TURN_SLIP,
    Motion,
    camera_after,
)
from homeward.localizer.reference.window import (
    BY_CALIBRATION,
    FREE,
    IS_ODOMETRY,
    STEP,
    NormalEquations,
    OdometryErrors,
    SightedFrom,
    WeighedSightings,
    eliminate,
    marginals,
    odometry_errors,
    weighed,
)
from homeward.localizer.tunables import (
    FIXED_TIME_CONSTANT_S,
    INFINITY_RATIO,
    LAG_GATE,
    LINEAR,
    MAX_SOLVE_STEPS,
    MIN_CALIBRATION_SIGMA,
    NEGLIGIBLE_CALIBRATION,
    SOLVE_CONVERGED,
    STALE_S,
)

ONE_SIDED = [TURN_SLIP, TIME_CONSTANT]
"""Unknowns that cannot be negative: wheels gain no way in bends, and no robot precedes its command.
"""
NO_TAIL = np.ones(2)
"""Ratios of inlier variances of shift and turn where motions have no heavy tail [1]."""


class Closed(NamedTuple):
    """Marginalised keyframes, kept for smoothing the whole drive."""

    poses: np.ndarray
    stamps: list[float]
    sightings: np.ndarray
    frames: Frames
    steps: np.ndarray


class Smoother:
    """Keyframes, calibration and landmarks, and the factors between them.

    Prior standard deviations, around zero: `odometry_sigmas` (6,) of the odometry's calibration,
    `mount_sigmas` (3,) of the extrinsics. `drift` (9,) are the variances by which the calibration
    drifts, per second; `lasting` is the present model of time-correlated bearing errors, and `t`
    the time of the first keyframe, the origin [s].
    """

    def __init__(
        self,
        odometry_sigmas: np.ndarray,
        drift: np.ndarray,
        mount_sigmas: np.ndarray,
        correlated: CorrelatedErrors,
        t: float,
        time_constant: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.first = 0
        """Number of the oldest keyframe in the window."""
        self.stamps = [t]
        """Times of the keyframes in the window [s]."""
        self.ids = np.zeros(0, int)
        """(n,): ids of the landmarks in the state, ascending; none is reused."""
        self.p_static = np.zeros(0)
        """(n,): probability of each to be static, the weight of its sightings [1]."""
        self._sightings = np.zeros((0, COLUMNS))
        self._added: tuple[np.ndarray, ...] = ()
        self.frames = Frames()
        self.turn_variances: list[float] = []
        """Variance of turn of the motion into each keyframe but the oldest [rad^2]."""
        self.shift_variances: list[float] = []
        """The same of shift [m^2]."""
        self.converged = True
        """Whether the last `solve` converged."""
        self.mount_sigmas = mount_sigmas
        """Priors that may change are never marginalised: of the extrinsics ..."""
        self.slip_sigma = max(float(odometry_sigmas[TURN_SLIP]), MIN_CALIBRATION_SIGMA)
        """... of slip in bends [m] ..."""
        mean, sigma = time_constant
        self.time_constant_prior = mean, max(sigma, FIXED_TIME_CONSTANT_S)
        """... of the time constant: its mean and standard deviation [s] ..."""
        self.survey = SurveyFactors.none()
        """... and the survey of landmarks."""
        self.one_sided = list(ONE_SIDED)
        """Unknowns that cannot be negative, as long as odometry is not corrected for them."""
        self._bounded = np.zeros(NC, bool)
        """Which of the calibration are kept at zero, since they would be negative without that."""
        self.range_ratio = 0.0
        """Scale of ranges over the speed scale; see `homeward.localizer.map.ranges`."""
        self._older = np.zeros((0, 3))
        """(w - 1, 3): poses of the keyframes in the window but the newest."""
        self._steps = np.zeros((0, STEP))
        """(w - 1, STEP): the motions between them."""
        self._next_id = 0
        self._closed: list[Closed] | None = None
        self._drift, self._correlated = drift, correlated
        self._integrated_at = np.array([0.0, mean])
        """Delay and time constant [s] of the motions in the window."""
        of_odometry = 1.0 / np.maximum(odometry_sigmas, MIN_CALIBRATION_SIGMA) ** 2
        of_odometry[ONE_SIDED] = 0.0
        information = np.concatenate([np.full(3, 1e10), of_odometry, np.zeros(len(mount_sigmas))])
        self._first_information = np.diag(information)
        self._prior = Prior(self._first_information)
        self.state = Marginal(np.zeros(HEAD), np.zeros((HEAD, HEAD)))
        """The Gaussian on newest pose, calibration and landmarks."""
        self.solve()

    def retain_marginalised(self) -> None:
        """Keep marginalised keyframes for `whole`; memory then grows with the drive."""
        self._closed = []

    def whole(self) -> Smoother:
        """Return a smoother with all keyframes since `retain_marginalised`, unsolved."""
        unused = np.ones(len(ODOMETRY_CALIBRATION))
        whole = Smoother(unused, self._drift, self.mount_sigmas, self._correlated, 0.0)
        closed = self._closed or []
        whole.slip_sigma, whole.range_ratio = self.slip_sigma, self.range_ratio
        whole.one_sided, whole._bounded = self.one_sided, self._bounded
        whole.time_constant_prior = self.time_constant_prior
        whole.first = self.first - sum(len(part.poses) for part in closed)
        whole._older = np.concatenate([*(part.poses for part in closed), self._older])
        whole.stamps = [t for part in closed for t in part.stamps] + self.stamps
        rows = np.concatenate([*(part.sightings for part in closed), self.sightings])
        whole.sightings = rows[np.isin(rows[:, LANDMARK], self.ids)]
        whole.frames = Frames.joined([*(part.frames for part in closed), self.frames])
        whole._steps = np.concatenate([*(part.steps for part in closed), self._steps])
        whole.ids, whole.state, whole.survey = self.ids, self.state, self.survey
        whole.p_static = self.p_static
        information = np.eye(self.state.mean.size) * (INFINITY_RATIO * self.state.scale) ** -2
        information[:HEAD, :HEAD] = self._first_information
        whole._prior = Prior(information)
        return whole

    @property
    def sightings(self) -> np.ndarray:
        """Sightings of landmarks in the state from keyframes in the window."""
        if self._added:  # joined when they are needed: a window may have 100,000
            self.sightings = np.concatenate([self._sightings, *self._added])
        return self._sightings

    @sightings.setter
    def sightings(self, rows: np.ndarray) -> None:
        self._sightings, self._added = rows, ()

    @property
    def poses(self) -> np.ndarray:
        """(w, 3): poses of the keyframes in the window, in the odometry frame."""
        return np.concatenate([self._older, self.state.mean[None, :3]])

    @property
    def newest(self) -> int:
        """Number of the newest keyframe."""
        return self.first + len(self._older)

    @property
    def range_scale(self) -> float:
        """Logarithm of the scale of ranges [1]."""
        return self.range_ratio * float(self.state.calibration[SPEED_SCALE])

    @property
    def range_over_odometry(self) -> tuple[float, float]:
        """Ranges over distances from odometry, and the standard deviation of that [1]."""
        both, state = 1.0 + self.range_ratio, self.state
        scale = math.exp(both * state.calibration[SPEED_SCALE])
        return scale, scale * both * math.sqrt(state.calibration_variances[SPEED_SCALE])

    def index(self, ids: np.ndarray) -> np.ndarray:
        """Return the indices in the state of landmarks with these ids, shape (m,)."""
        return np.asarray(self.ids.searchsorted(ids))

    def cameras(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the camera's poses at rows of the table, (m, 3), and Jacobians (m, 3, 12)."""
        frame = rows[:, FRAME].astype(int)
        begin = int(frame.min(initial=self.frames.next))
        some = self.frames.since(begin)
        eyes, by_head = some.eyes(self.poses[some.keyframes - self.first], self.state.calibration)
        return eyes[frame - begin], by_head[frame - begin]

    def add_keyframe(self, t: float, motion: Motion, inlier_ratios: np.ndarray = NO_TAIL) -> None:
        """Add a keyframe at `t` [s], reached by `motion` from the last one; propagate the state.

        The factor has the variances of inlier motions, `inlier_ratios` (2,) of those of shift and
        turn; its robust weight then decides how far this one is an outlier.
        """
        self._older = self.poses
        self.stamps.append(t)
        self.turn_variances.append(float(motion.covariance[2, 2]))
        self.shift_variances.append(float(motion.covariance[0, 0] + motion.covariance[1, 1]))
        step = step_row(motion)
        scale_steps(step, inlier_ratios)
        self._steps = np.concatenate([self._steps, step])
        self.state = self.state.propagate(motion)

    def add_landmark(self, position: np.ndarray) -> int:
        """Add a landmark at `position` [m], shape (2,), without sightings yet; return its id."""
        distance = float(np.hypot(*(self.poses[:, :2] - position).T).max())
        unknown = INFINITY_RATIO * max(distance, MIN_DISTANCE)
        self._prior.add_landmark(position, unknown)
        self.state = self.state.with_landmark(position, unknown)
        self.ids = np.append(self.ids, self._next_id)
        self.p_static = np.append(self.p_static, 1.0)
        self._next_id += 1
        return self._next_id - 1

    def add_sightings(self, rows: np.ndarray) -> None:
        """Add rows of the table of sightings, shape (m, COLUMNS), of keyframes in the window."""
        self._added = (*self._added, rows)

    def drop_sightings_from(self, keyframe: int) -> None:
        """Drop the sightings from a keyframe, by its number."""
        self.sightings = self.sightings[self.sightings[:, KEYFRAME] != keyframe]

    def move_keyframe(self, number: int, pose: np.ndarray) -> None:
        """Set the pose (3,) of a keyframe in the window, where the next `solve` begins."""
        if number < self.newest:
            self._older[number - self.first] = pose
        else:
            mean = np.concatenate([pose, self.state.mean[3:]])
            self.state = Marginal(mean, self.state.covariance)

    @property
    def is_stale(self) -> bool:
        """Whether delay or time constant differ from those of the motions, beyond their error.

        False while the delay is negative: the newest motions then lack twists that are still to
        come, and an older one without such errors is no measure of their noise.
        """
        of_lag, state = [DELAY, TIME_CONSTANT], self.state
        if state.calibration[DELAY] < 0.0:
            return False
        change = np.abs(state.calibration[of_lag] - self._integrated_at)
        sigmas = np.sqrt(state.calibration_variances[of_lag])
        return bool((change > np.maximum(STALE_S, LAG_GATE * sigmas)).any())

    def integrate_again(
        self, since: float, between: Callable[[float, float], Motion], mount: np.ndarray
    ) -> None:
        """Replace the motions in the window: delay and time constant act nonlinearly.

        `since` is the time of the oldest one that can be integrated again [s]; `between` returns
        the motion between two times [s] at the present calibration; `mount` (3,) is the given pose
        of the camera on the robot.
        """
        self._integrated_at = self.state.calibration[[DELAY, TIME_CONSTANT]]
        known = np.array(self.stamps[:-1]) >= since
        for k in np.flatnonzero(known & (self._steps[:, IS_ODOMETRY] > 0.0)).tolist():
            motion = between(self.stamps[k], self.stamps[k + 1])
            self._steps[k, FREE] = motion.uncalibrated
            self._steps[k, BY_CALIBRATION] = motion.jacobian.ravel()
        frames = self.frames
        for k, (keyframe, t) in enumerate(zip(frames.keyframes, frames.stamps, strict=True)):
            begin = self.stamps[keyframe - self.first]
            if t > begin >= since:
                motion, offset = between(begin, t), frames.offsets.get(frames.first + k)
                motion = camera_after(motion, mount, self.state.calibration, offset)
                frames.replace(k, motion)

    def replace_motion(self, k: int, motion: Motion) -> None:
        """Replace the motion from the k-th keyframe in the window to the next."""
        self._steps = np.concatenate([self._steps[:k], step_row(motion), self._steps[k + 1 :]])

    def scale_noise(self, factor: float) -> None:
        """Scale the measurement noise of all sightings in the window."""
        for rows in (self.sightings, *(part.sightings for part in self._closed or [])):
            scale_noise(rows, factor)

    def scale_odometry(self, factors: np.ndarray) -> None:
        """Scale variances of shift and turn by factors (2, 2): of inlier motions, and of all."""
        for steps in (self._steps, *(part.steps for part in self._closed or [])):
            scale_steps(steps, factors[0])
        self.shift_variances = [float(factors[1, 0] * v) for v in self.shift_variances]
        self.turn_variances = [float(factors[1, 1] * v) for v in self.turn_variances]

    def odometry_errors(self) -> OdometryErrors:
        """Return the residuals of the motions between keyframes in the window, linearised."""
        return odometry_errors(self.poses, self.state.calibration, self._steps)

    def denied_turns(self) -> np.ndarray:
        """Return the squares of the normalised residuals of turns between keyframes, (w - 1,) [1].

        Infinite where the robot was relocalised: odometry was denied entirely.
        """
        found = self.odometry_errors()
        squares = found.error[:, 2] ** 2 * found.information[:, 2, 2]
        return np.where(self._steps[:, IS_ODOMETRY] > 0.0, squares, np.inf)

    def drop_landmark(self, number: int) -> None:
        """Marginalise the landmark of an id: the information on the others is kept."""
        index = int(self.index(np.array(number)))
        self._prior.drop_landmark(index, self._linearisation_point())
        self.state = self.state.without_landmark(index)
        self.ids, self.p_static = np.delete(self.ids, index), np.delete(self.p_static, index)
        self.survey = self.survey.among(self.ids)
        self.sightings = self.sightings[self.sightings[:, LANDMARK] != number]

    def predict(self, rows: np.ndarray) -> Prediction:
        """Predict sightings from the newest keyframe, rows of the table."""
        seen = rows[:, BEARING], self.effective_sigmas(rows)
        index = self.index(rows[:, LANDMARK])
        return predict_bearings(self.state, *seen, self.cameras(rows), index)

    def solve(self) -> None:
        """Solve the whole window by Gauss-Newton.

        `numpy.linalg.LinAlgError` when the normal equations are singular.
        """
        for _ in range(MAX_SOLVE_STEPS):
            poses, common, covariance = kernels.solve(self.equations())
            if not (np.isfinite(poses).all() and np.isfinite(covariance).all()):
                raise np.linalg.LinAlgError("a step is not finite")
            if not (covariance.diagonal() > 0.0).all():
                raise np.linalg.LinAlgError("a variance is not positive")
            small = self._move(poses, common, covariance) < SOLVE_CONVERGED
            self.converged = not self._update_bounded() and small
            if self.converged:
                break

    def without_survey(self, size: float) -> Marginal:
        """Return the state without the survey; each landmark has a prior of `size` [m] instead."""
        equations = self._equations_without_survey()
        at = np.arange(NC, len(equations.common))
        equations.common[at, at] += size**-2.0
        poses, common, covariance = kernels.solve(equations)
        return Marginal(self.state.mean + np.concatenate([poses[-1], common]), covariance)

    def marginals(self, indices: Sequence[int] | None = None) -> list[Marginal]:
        """Return the state at poses in the window, by default at each, after `solve`."""
        own, by_common, common = marginals(self.equations())
        found, poses = [], self.poses
        for k in range(len(poses)) if indices is None else indices:
            cross = -by_common[k] @ common
            joint = np.block([[own[k], cross], [cross.T, common]])
            found.append(Marginal(np.concatenate([poses[k], self.state.mean[3:]]), joint))
        return found

    def turn_camera(self, keyframe: int, size: float) -> None:
        """Turn the camera on the robot by `size` [rad] from a keyframe on, and solve the window.

        Earlier keyframes are marginalised: the error of the new yaw is another one than before.
        `numpy.linalg.LinAlgError` when the normal equations are singular.
        """
        poses = self.poses
        poses[keyframe - self.first :, 2] -= size
        self._older = poses[:-1]
        self.move_keyframe(self.newest, poses[-1])
        self.frames.free[self.frames.keyframes >= keyframe, 2] += size
        self.marginalise(keyframe - self.first, yaw_variance=LINEAR**2)
        self.solve()

    def marginalise(self, count: int, yaw_variance: float = 0.0) -> None:
        """Marginalise the oldest `count` poses into the prior, in which the yaw may have changed.

        That has a variance [rad^2].
        """
        first = self.first + count
        old = self.sightings[:, KEYFRAME] < first
        rows = self.sightings[old]
        eliminated = eliminate(self._normal_equations(count + 1, rows))
        drift = self._drift * max(self.stamps[count] - self.stamps[0], 1e-3)
        drift[CAMERA_YAW] += yaw_variance
        frames = self.frames.take_before(first)
        if self._closed is not None:
            chain = self._older[:count], self.stamps[:count]
            self._closed.append(Closed(*chain, rows, frames, self._steps[:count]))
        self.first = first
        self._older, self.stamps = self._older[count:], self.stamps[count:]
        self._steps = self._steps[count:]
        self.turn_variances = self.turn_variances[count:]
        self.shift_variances = self.shift_variances[count:]
        self.sightings = self.sightings[~old]
        self._prior.replace(eliminated, self._linearisation_point(), drift)

    def residuals(self) -> np.ndarray:
        """Return the residuals of sightings, measured minus expected bearing, (m,) [rad]."""
        rows = self.sightings
        seen = sight(self.cameras(rows)[0], self.state.positions[self.index(rows[:, LANDMARK])])
        return np.asarray(wrap(rows[:, BEARING] - seen.bearing))

    def range_deviations(self, since: int) -> np.ndarray:
        """Return the residuals of ranges from keyframe `since` on, (m,) [standard deviations]."""
        rows = self.sightings
        rows = rows[(rows[:, RANGE_SIGMA] > 0.0) & (rows[:, KEYFRAME] >= since)]
        residual, _ = self._range_residuals(rows, self.index(rows[:, LANDMARK]))
        return np.asarray(residual / range_sigmas(rows))

    def effective_sigmas(self, rows: np.ndarray) -> np.ndarray:
        """Return the effective standard deviations of rows (m,) [rad].

        They are larger for correlated sightings, and for landmarks that may walk.
        """
        p_static = self.p_static[self.index(rows[:, LANDMARK])]
        return np.asarray(effective_sigmas(rows, self._correlated) / np.sqrt(p_static))

    def equations(self, seen: WeighedSightings | None = None) -> NormalEquations:
        """Return the normal equations at the present estimate.

        `seen` are the sightings, if they are weighted already.
        """
        equations = self._equations_without_survey(seen)
        self.survey.add_to(equations, self.state.positions, self.ids)
        return equations

    def linearised(self) -> tuple[NormalEquations, WeighedSightings]:
        """Return the normal equations and the weighted sightings at the present estimate."""
        seen = weighed(self._seen(self.sightings), self.poses, self.state.mean[3:])
        return self.equations(seen), seen

    def _seen(self, rows: np.ndarray) -> SightedFrom:
        """Return the bearings in rows of the table, for the normal equations."""
        return SightedFrom(
            rows[:, BEARING],
            rows[:, SIGMA],
            self.effective_sigmas(rows),
            rows[:, FRAME].astype(int) - self.frames.first,
            self.index(rows[:, LANDMARK]),
            self.frames.keyframes - self.first,
            self.frames.free,
            self.frames.jacobians,
        )

    def _weighed_ranges(self, rows: np.ndarray) -> WeighedSightings:
        """Return the ranges in rows of the table as factors, linearised and weighted."""
        pose, landmark = rows[:, KEYFRAME].astype(int) - self.first, self.index(rows[:, LANDMARK])
        seen = self._range_residuals(rows, landmark)
        return weigh_ranges(rows, seen, self.p_static[landmark], pose, landmark)

    def _range_residuals(
        self, rows: np.ndarray, landmark: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals of ranges and their Jacobian; see `range_residuals`."""
        scale = self.range_scale, self.range_ratio
        return range_residuals(rows, self.cameras(rows), self.state.positions[landmark], *scale)

    def _linearisation_point(self) -> np.ndarray:
        """Return oldest pose, calibration and landmarks as one vector."""
        return np.concatenate([self.poses[0], self.state.mean[3:]])

    def _move(self, poses: np.ndarray, common: np.ndarray, covariance: np.ndarray) -> float:
        """Apply a step, limited to the linear range; return its full size."""
        landmarks = common[NC:].reshape(-1, 2)
        turn = float(np.abs(poses[:, 2]).max())
        share = float((np.hypot(*landmarks.T) / self.state.reach).max(initial=0.0))
        scale = 1.0 / max(1.0, max(turn, share) / LINEAR)
        self._older = self._older + scale * poses[:-1]
        shift = max(np.abs(poses[:, :2]).max(), np.abs(common[CAMERA_X:NC]).max())
        size = max(turn, share, shift / self.state.scale, np.abs(common[:CAMERA_X]).max())
        step = np.concatenate([poses[-1], common])
        self.state = Marginal(self.state.mean + scale * step, covariance)
        return float(size)

    def _normal_equations(
        self, w: int, rows: np.ndarray, seen: WeighedSightings | None = None
    ) -> NormalEquations:
        """Return the normal equations of the oldest w poses, sightings from them, and the prior.

        The priors on extrinsics, slip and time constant are not among them, since they may change.
        """
        equations = NormalEquations.zeros(w, NC + self.state.positions.size)
        self._prior.add_to(equations, self._linearisation_point())
        poses, calibration = self.poses[:w], self.state.calibration
        kernels.add_odometry(equations, poses, calibration, self._steps[: w - 1])
        if seen is None:
            kernels.add_bearings(equations, self._seen(rows), poses, self.state.mean[3:])
        else:
            kernels.add_sightings(equations, seen)
        with_range = rows[:, RANGE_SIGMA] > 0.0
        if with_range.any():
            kernels.add_sightings(equations, self._weighed_ranges(rows[with_range]))
        return equations

    def _update_bounded(self) -> bool:
        """Update which unknowns are kept at zero (an active set); return whether any changed.

        An unknown that nothing observes is zero but for rounding, whose sign must not decide: one
        is kept at zero from a notable negative value on, until it is not negative even then.
        """
        now, before = self.state.calibration, self._bounded
        limit = np.where(before, -ROUNDING, -NEGLIGIBLE_CALIBRATION)
        self._bounded = np.zeros(NC, bool)
        self._bounded[self.one_sided] = (now < limit)[self.one_sided]
        return bool((self._bounded != before).any())

    def _equations_without_survey(self, seen: WeighedSightings | None = None) -> NormalEquations:
        """Return the normal equations of everything but the survey."""
        equations = self._normal_equations(len(self.poses), self.sightings, seen)
        at = np.array([*ONE_SIDED, *range(NC)[MOUNT]])
        time_constant, sigma = self.time_constant_prior
        means = np.array([0.0, time_constant, 0.0, 0.0, 0.0])
        information = np.array([self.slip_sigma, sigma, *self.mount_sigmas]) ** -2.0
        equations.common[at, at] += information
        equations.common_slope[at] -= information * (self.state.calibration[at] - means)
        bounded = self._bounded.nonzero()[0]
        equations.common[bounded, bounded] += NEGLIGIBLE_CALIBRATION**-2.0
        equations.common_slope[bounded] -= (
            NEGLIGIBLE_CALIBRATION**-2.0 * self.state.calibration[bounded]
        )
        return equations
