"""Fixed-lag smoother: recent keyframes, calibration and landmarks, in the odometry frame.

The poses of the last keyframes, the window, are solved together with calibration and landmarks at
each keyframe, by Gauss-Newton. The state is one Gaussian on the newest pose, the calibration and
the landmarks; a motion to a new keyframe propagates it until the next solution. Poses that leave
the window are marginalised (Schur complement) into a Gaussian prior on the pose after them, the
calibration and the landmarks.

Home bearings may turn out to be wrong, and nothing that may have to be undone is marginalised.
Where they move the map by more than bearings are linear, they are factors of each solution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress

import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.se2 import MIN_DISTANCE, compose, sight
from homeward.localizer import kernels
from homeward.localizer.inputs.bearing_noise import CorrelatedErrors
from homeward.localizer.map.all_landmarks import AllLandmarks
from homeward.localizer.map.passive import PassiveLandmarks
from homeward.localizer.map.prior import Closed, Prior
from homeward.localizer.map.ranges import RangeFactors
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
    scale_steps,
    step_row,
)
from homeward.localizer.map.state import Marginal
from homeward.localizer.map.survey.factors import HomeFactors, HomeInformation, SurveyFactors
from homeward.localizer.motions import (
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
from homeward.localizer.reference.factors import (
    BY_CALIBRATION,
    FREE,
    PER_S,
    STEP,
    NormalEquations,
    OdometryErrors,
    SightedFrom,
)
from homeward.localizer.reference.window import (
    AddMore,
    Conditional,
    Linearised,
    Window,
    eliminate,
    marginals,
)
from homeward.localizer.tunables import (
    FIXED_TIME_CONSTANT_S,
    INFINITY_RATIO,
    INLIER,
    LAG_GATE,
    LINEAR,
    LONG_DRIVE,
    LONG_IN_A_ROOM,
    MAX_WHOLE_SOLVES,
    MIN_CALIBRATION_SIGMA,
    MIN_CHANGE,
    MIN_IDLE,
    STALE_S,
)
from homeward.table import GrowingTable

ONE_SIDED = [TURN_SLIP, TIME_CONSTANT]
"""Unknowns that cannot be negative: wheels gain no way in bends, and no robot precedes its command.
"""
NO_TAIL = np.ones(2)
"""Ratios of inlier variances of shift and turn where motions have no heavy tail [1]."""


class Smoother:
    """Keyframes, calibration and landmarks, and the factors between them.

    Prior standard deviations, around zero: `odometry_sigmas` (7,) of the odometry's calibration,
    `mount_sigmas` (3,) of the extrinsics. `drift` (10,) are the variances by which the calibration
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
        """(n,): ids of the landmarks in the state, the active ones, ascending; none is reused."""
        self.p_static = np.zeros(0)
        """(n,): probability of each to be static, the weight of its sightings [1]."""
        self.passive = PassiveLandmarks()
        """The other landmarks of the map, which are in no sighting of the window."""
        self._in_view: dict[int, int] = {}
        """Keyframe, or the one before the frame, that saw each active landmark last."""
        self._sightings = GrowingTable((COLUMNS,))
        self.frames = Frames()
        self.variances = GrowingTable((2,))
        """(w - 1, 2): variances of shift [m^2] and turn [rad^2] of the motions between them."""
        self.converged = True
        """Whether the last `solve` converged ..."""
        self._converged_at = 0
        """... and the newest keyframe when one did last."""
        self.mount_sigmas = mount_sigmas
        """Priors that may change are never marginalised: of the extrinsics ..."""
        self.slip_sigma = max(float(odometry_sigmas[TURN_SLIP]), MIN_CALIBRATION_SIGMA)
        """... of slip in bends [m] ..."""
        mean, sigma = time_constant
        self.time_constant_prior = mean, max(sigma, FIXED_TIME_CONSTANT_S)
        """... of the time constant: its mean and standard deviation [s] ..."""
        self.survey = SurveyFactors.none()
        """... of the survey of landmarks ..."""
        self.at_home: HomeFactors | None = None
        """... and of home bearings."""
        self._known_by_home: HomeInformation | None = None
        """Their part of the present state ..."""
        self._added: HomeInformation | None = None
        """... and to the normal equations that were built last."""
        self.one_sided = list(ONE_SIDED)
        """Unknowns that cannot be negative, as long as odometry is not corrected for them."""
        self._bounded = np.zeros(NC, bool)
        """Which of the calibration are kept at zero, since they would be negative without that."""
        self.range_ratio = 0.0
        """Scale of ranges over the speed scale; see `homeward.localizer.map.ranges`."""
        self.scale_before: tuple[float, float] | None = None
        """`speed_scale` before the odometry changed first; ranges are not used since."""
        self._poses = GrowingTable((3,))
        """(w, 3): poses of the keyframes in the window."""
        self._poses.add(np.zeros(3))
        self._steps = GrowingTable((STEP,))
        """(w - 1, STEP): the motions between them."""
        self._next_id = 0
        self._closed: list[Closed] = []
        """The marginalised keyframes, ..."""
        self._keeps_all, self._can_repeat = False, True
        """... whether they are kept for ever, and whether they may be linearised again."""
        self._turned = 0.0
        """By how much the map has turned since they were linearised [rad]."""
        self._solved_all_at = 0
        """Newest keyframe when all keyframes were solved."""
        self.leaves_view = False
        """Whether landmarks have left the view, as in a hall."""
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
        """Keep all marginalised keyframes for `whole`; memory then grows with the drive."""
        self._keeps_all = True

    def whole(self) -> Smoother:
        """Return a smoother with all keyframes that are kept, unsolved."""
        unused = np.ones(len(ODOMETRY_CALIBRATION))
        whole = Smoother(unused, self._drift, self.mount_sigmas, self._correlated, 0.0)
        own = Closed(self.poses, self.stamps, self.sightings, self.frames, self._steps.rows)
        found = Closed.joined([*self._closed, own])
        whole.slip_sigma, whole.range_ratio = self.slip_sigma, self.range_ratio
        whole.scale_before = self.scale_before
        whole.one_sided, whole._bounded = self.one_sided, self._bounded
        whole.time_constant_prior = self.time_constant_prior
        whole.first = self.newest + 1 - len(found.poses)
        whole._poses, whole._steps = GrowingTable.of(found.poses), GrowingTable.of(found.steps)
        whole.stamps, whole.frames = found.stamps, found.frames
        landmarks = self.all_landmarks
        whole.ids = ids = landmarks.ids
        whole.state, whole.p_static = landmarks.joint(ids), landmarks.static_probabilities(ids)
        whole.sightings = found.sightings[np.isin(found.sightings[:, LANDMARK], ids)]
        whole.survey, whole.at_home = self.survey, self.at_home
        information = np.eye(whole.state.mean.size) * (INFINITY_RATIO * self.state.scale) ** -2
        information[:HEAD, :HEAD] = self._first_information
        whole._prior = Prior(information)
        return whole

    def use_home(self, found: HomeFactors | None) -> bool:
        """Use home factors in each solution from now on; return whether all keyframes are solved.

        They turn the map, so the first ones are used from a solution of all keyframes on.
        """
        is_solved_by_window = found is None or self.at_home is not None or not self.first
        self.at_home = found
        if is_solved_by_window:
            return False
        if not self._solve_all():
            self.at_home = None
        return self.at_home is not None

    def linearise_again(self) -> None:
        """Solve for all keyframes and marginalise again, if the map has turned since.

        The error of a prior that has turned by d is d^2 / 2 of all distances.
        """
        turned = self._turned + float(self.poses[0, 2] - self._prior.at[2])
        if turned**2 > LINEAR * math.sqrt(self.state.covariance[2, 2]):
            self._solve_all()

    def _solve_all(self) -> bool:
        """Solve for all keyframes, and marginalise those before the window again.

        Not after a change of the calibration, nor on a drive too long to be solved between two
        frames, nor twice in a window. Nothing changes if the solution does not converge.
        """
        if not (self.first and self._can_repeat) or self._solved_all_at > self.first:
            return False
        whole = self.whole()
        before = len(whole.poses) - len(self.poses)
        self._solved_all_at, self._turned = self.newest, 0.0
        with suppress(np.linalg.LinAlgError):
            for _ in range(MAX_WHOLE_SOLVES):
                whole.solve()
                if whole.converged:
                    break
            if whole.converged:
                closed = Closed.joined(self._closed)._replace(poses=whole.poses[:before].copy())
                self._closed = [closed]
                whole.marginalise(before)
                self._poses, self._prior, self.passive = whole._poses, whole._prior, whole.passive
                self.ids, self.p_static, self.state = whole.ids, whole.p_static, whole.state
                self._bounded, self._known_by_home = whole._bounded, whole._known_by_home
                return True
        return False

    @property
    def all_landmarks(self) -> AllLandmarks:
        """Active and passive landmarks together."""
        step = self._linearisation_point() - self._prior.at
        known = self.ids, self.p_static, self.state, self.passive
        return AllLandmarks(*known, step, self.linearised)

    @property
    def sightings(self) -> np.ndarray:
        """Sightings of landmarks in the state from keyframes in the window."""
        return self._sightings.rows

    @sightings.setter
    def sightings(self, rows: np.ndarray) -> None:
        self._sightings = GrowingTable.of(rows)

    @property
    def poses(self) -> np.ndarray:
        """(w, 3): poses of the keyframes in the window, in the odometry frame."""
        return self._poses.rows

    @property
    def newest(self) -> int:
        """Number of the newest keyframe."""
        return self.first + len(self._poses) - 1

    @property
    def is_unsolved(self) -> bool:
        """Whether the solutions of the last two keyframes have not converged, but one before has.

        Then the covariance is not that of a minimum: bearings and odometry contradict each other.
        """
        return 0 < self._converged_at <= self.newest - 2

    @property
    def range_scale(self) -> float:
        """Logarithm of the scale of ranges [1]."""
        return self.range_ratio * float(self.state.calibration[SPEED_SCALE])

    @property
    def uses_ranges(self) -> bool:
        """Whether ranges are used."""
        return self.range_ratio > 0.0 and self.scale_before is None

    @property
    def range_over_odometry(self) -> tuple[float, float]:
        """Ranges over distances from odometry, and the standard deviation of that [1]."""
        speed, sigma = self.scale_before or self.speed_scale
        both = 1.0 + self.range_ratio
        scale = math.exp(both * speed)
        return scale, scale * both * sigma

    @property
    def speed_scale(self) -> tuple[float, float]:
        """Estimated speed scale, and its standard deviation [1]."""
        variance = self.state.calibration_variances[SPEED_SCALE]
        return float(self.state.calibration[SPEED_SCALE]), math.sqrt(variance)

    @property
    def is_scale_open(self) -> bool:
        """Whether the speed has changed its scale, and is not known to have the former one again.

        Wheels that spin or slip do so by another factor the next moment.
        """
        if self.scale_before is None:
            return False
        scale, sigma = self.speed_scale
        return abs(scale - self.scale_before[0]) + INLIER * sigma >= MIN_CHANGE

    def index(self, ids: np.ndarray) -> np.ndarray:
        """Return the indices in the state of landmarks with these ids, shape (m,)."""
        return np.asarray(self.ids.searchsorted(ids))

    def cameras(self, rows: np.ndarray) -> np.ndarray:
        """Return the camera's poses at rows of the table, (m, 3)."""
        frames, frame = self.frames, rows[:, FRAME].astype(int) - self.frames.first
        begin = int(frame.min(initial=len(frames.free)))
        some = slice(begin, int(frame.max(initial=begin - 1)) + 1)
        camera = frames.free[some] + frames.jacobians[some] @ self.state.calibration
        eyes = compose(self.poses[frames.keyframes[some] - self.first], camera)
        return np.asarray(eyes[frame - begin])

    def add_keyframe(self, t: float, motion: Motion, inlier_ratios: np.ndarray = NO_TAIL) -> None:
        """Add a keyframe at `t` [s], reached by `motion` from the last one; propagate the state.

        The factor has the variances of inlier motions, `inlier_ratios` (2,) of those of shift and
        turn; its robust weight then decides how far this one is an outlier.
        """
        self.stamps.append(t)
        x, y, turn = motion.covariance.diagonal().tolist()
        self.variances.add((x + y, turn))
        step = step_row(motion, t - self.stamps[-2])
        scale_steps(step, inlier_ratios)
        self._steps.extend(step)
        self.state = self.state.propagate(motion)
        self._poses.add(self.state.mean[:3])

    def add_landmark(self, position: np.ndarray) -> int:
        """Add a landmark at `position` [m], shape (2,), without sightings yet; return its id."""
        distance = float(np.hypot(*(self.poses[:, :2] - position).T).max())
        unknown = INFINITY_RATIO * max(distance, MIN_DISTANCE)
        self.passive.insert_unknowns(len(self._prior.at), 2)
        self._prior.add_landmark(position, unknown)
        self.state = self.state.with_landmark(position, unknown)
        self.ids = np.append(self.ids, self._next_id)
        self.p_static = np.append(self.p_static, 1.0)
        self._next_id += 1
        return self._next_id - 1

    def add_sightings(self, rows: np.ndarray) -> None:
        """Add rows of the table of sightings, shape (m, COLUMNS), of keyframes in the window."""
        self._sightings.extend(rows)

    def drop_sightings(self, column: int, number: int) -> None:
        """Drop the sightings with a number in a column: of a landmark, or from a keyframe."""
        self.sightings = self.sightings[self.sightings[:, column] != number]

    def move_keyframe(self, number: int, pose: np.ndarray) -> None:
        """Set the pose (3,) of a keyframe in the window, where the next `solve` begins."""
        poses = self.poses.copy()
        poses[number - self.first] = pose
        self._poses = GrowingTable.of(poses)
        if number == self.newest:
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
        steps = self._steps.rows
        for k in np.flatnonzero(known & (steps[:, PER_S] > 0.0)).tolist():
            motion = between(self.stamps[k], self.stamps[k + 1])
            steps[k, FREE] = motion.uncalibrated
            steps[k, BY_CALIBRATION] = motion.jacobian.ravel()
        frames = self.frames
        for k, (keyframe, t) in enumerate(zip(frames.keyframes, frames.stamps, strict=True)):
            begin = self.stamps[keyframe - self.first]
            if t > begin >= since:
                motion, offset = between(begin, t), frames.offsets.get(frames.first + k)
                motion = camera_after(motion, mount, self.state.calibration, offset)
                frames.replace(k, motion)

    def replace_motion(self, k: int, motion: Motion) -> None:
        """Replace the motion from the k-th keyframe in the window to the next."""
        steps = self._steps.rows.copy()
        steps[k] = step_row(motion, self.stamps[k + 1] - self.stamps[k])
        self._steps = GrowingTable.of(steps)

    def scale_noise(self, factor: float) -> None:
        """Scale the measurement noise of all sightings in the window."""
        for rows in (self.sightings, *(part.sightings for part in self._closed)):
            scale_noise(rows, factor)

    def scale_odometry(self, factors: np.ndarray) -> None:
        """Scale variances of shift and turn by factors (2, 2): of inlier motions, and of all."""
        if (factors == 1.0).all():
            return
        for steps in (self._steps.rows, *(part.steps for part in self._closed)):
            scale_steps(steps, factors[0])
        self.variances.rows[:] *= factors[1]

    def denied_turns(self, motions: OdometryErrors) -> np.ndarray:
        """Return the squares of the normalised residuals of turns between keyframes, (w - 1,) [1].

        `motions` are those of the window, linearised. Infinite where the robot was relocalised:
        odometry was denied entirely.
        """
        squares = motions.error[:, 2] ** 2 * motions.information[:, 2, 2]
        return np.where(self._steps.rows[:, PER_S] > 0.0, squares, np.inf)

    def drop_landmark(self, number: int) -> None:
        """Marginalise the landmark of an id: the information on the others is kept."""
        gone = np.array([number])
        if number in self.passive.ids:
            self.passive.drop(self.passive.index(gone))
            return
        out, found = self._take_out(gone)
        self.passive.eliminate(out, found)
        self.survey = self.survey.among(self.ids)
        self.drop_sightings(LANDMARK, number)
        self._in_view.pop(number, None)

    def activate(self, ids: np.ndarray) -> None:
        """Make landmarks that are in view active; the solution stays.

        `numpy.linalg.LinAlgError` when the normal equations are singular.
        """
        self._in_view.update(dict.fromkeys(ids.tolist(), self.newest))
        back = ids[np.isin(ids, self.passive.ids)]
        if not back.size:
            return
        every = np.append(self.ids, back)
        order = every.argsort()
        joint = self.all_landmarks.joint(every[order])
        self._known_by_home = self._added
        self._move_linearisation_point()
        index = self.passive.index(back)
        p_static = self.passive.p_static[index]
        self._prior.append(*self.passive.take(index))
        self.ids, self.p_static = every[order], np.append(self.p_static, p_static)[order]
        unknowns = np.append(np.arange(HEAD), Marginal.columns(order))
        self._prior.reorder(unknowns)
        self.passive.reorder(unknowns)
        self.state = joint

    def deactivate(self, needed: np.ndarray) -> None:
        """Make landmarks passive that no frame in the window saw, except the `needed` ids.

        Not a few of them: the solution with them takes less time than that.
        """
        seen = [number for number, last in self._in_view.items() if last >= self.first]
        kept = np.concatenate([seen, needed, self.survey.ids, self.sightings[:, LANDMARK]])
        idle = self.ids[~np.isin(self.ids, kept)]
        if idle.size < MIN_IDLE:
            return
        self.leaves_view = True
        index = self.index(idle)
        at, p_static = self.state.positions[index].ravel(), self.p_static[index]
        self.passive.add(idle, p_static, at, *self._take_out(idle))
        for number in idle.tolist():
            self._in_view.pop(number, None)

    def _take_out(self, ids: np.ndarray) -> tuple[np.ndarray, Conditional]:
        """Take landmarks out of state and prior; return their unknowns, and their conditional."""
        index = self.index(ids)
        out = Marginal.columns(index).ravel()
        self._move_linearisation_point()
        found = self._prior.take_out(out)
        self.state = self.state.reordered(np.delete(np.arange(self.state.mean.size), out))
        self.ids, self.p_static = np.delete(self.ids, index), np.delete(self.p_static, index)
        return out, found

    def _move_linearisation_point(self) -> None:
        """Linearise the prior, and passive landmarks, at the present estimate."""
        now = self._linearisation_point()
        self._turned += float(now[2] - self._prior.at[2])
        self.passive.move(now - self._prior.at)
        self._prior.move_to(now)

    def solve(self) -> None:
        """Solve the whole window by Gauss-Newton.

        `numpy.linalg.LinAlgError` when the normal equations are singular; then nothing changes.
        """
        found = kernels.solve(self._window(), self._add_more())
        mean = np.concatenate([found.poses[-1], found.shared])
        self._poses, self.state = GrowingTable.of(found.poses), Marginal(mean, found.covariance)
        self._known_by_home = self._added
        self._bounded, self.converged = found.is_bounded, found.has_converged
        if self.converged:
            self._converged_at = self.newest

    def without_survey(self, size: float) -> Marginal:
        """Return the state without the survey; each landmark has a prior of `size` [m] instead."""
        equations = kernels.linearised(self._window(), self._add_ranges(self.sightings)).equations
        at = np.arange(NC, len(equations.common))
        equations.common[at, at] += size**-2.0
        poses, common, covariance = kernels.solve_equations(equations)
        return Marginal(self.state.mean + np.concatenate([poses[-1], common]), covariance)

    def marginal_of(self) -> Callable[[int], Marginal]:
        """Return a function from a pose in the window to the state there, after `solve`.

        With hundreds of landmarks, the states at all poses together exceed the memory.
        """
        own, by_common, common = marginals(self.linearised().equations)
        poses, mean = self.poses.copy(), self.state.mean[3:].copy()

        def marginal(k: int) -> Marginal:
            cross = -by_common[k] @ common
            joint = np.block([[own[k], cross], [cross.T, common]])
            return Marginal(np.concatenate([poses[k], mean]), joint)

        return marginal

    def change(self, state: int, keyframe: int, size: float) -> None:
        """Free a state of the calibration from a keyframe on, and solve the window.

        A camera is first turned on the robot by `size` [rad]. With another speed scale, ranges are
        not used any more: their scale is a multiple of that. Earlier keyframes are marginalised:
        the error of the new value is another one than before.
        `numpy.linalg.LinAlgError` when the normal equations are singular.
        """
        is_yaw = state == CAMERA_YAW
        if is_yaw:
            poses = self.poses.copy()
            poses[keyframe - self.first :, 2] -= size
            self._poses = GrowingTable.of(poses)
            self.move_keyframe(self.newest, poses[-1])
            self.frames.free[self.frames.keyframes >= keyframe, 2] += size
        self.marginalise(keyframe - self.first, {state: LINEAR**2 if is_yaw else 1.0})
        if not is_yaw:
            self.scale_before = self.scale_before or self.speed_scale
        self.solve()

    def marginalise(self, count: int, changes: Mapping[int, float] | None = None) -> None:
        """Marginalise the oldest `count` poses into the prior.

        The calibration may have changed by these variances, by state.
        """
        first = self.first + count
        old = self.sightings[:, KEYFRAME] < first
        rows = self.sightings[old]
        whole, free = self._window(), np.zeros(NC, bool)
        oldest = whole._replace(
            poses=whole.poses[: count + 1],
            steps=whole.steps[:count],
            seen=self._seen(rows),
            weights=np.zeros(NC),  # priors that may change
            is_bounded=free,
        )
        eliminated = eliminate(kernels.linearised(oldest, self._add_ranges(rows)).equations)
        drift = self._drift * max(self.stamps[count] - self.stamps[0], 1e-3)
        for state, variance in (changes or {}).items():
            drift[state] += variance
        self._move_linearisation_point()
        if len(self.passive):
            self.passive.replace(slice(3), eliminated.oldest())
        frames = self.frames.take_before(first)
        chain = self.poses[:count].copy(), self.stamps[:count]
        self._closed.append(Closed(*chain, rows, frames, self._steps.rows[:count].copy()))
        longest = LONG_DRIVE if self.leaves_view else LONG_IN_A_ROOM
        self._can_repeat &= not changes and first < longest
        if not (self._can_repeat or self._keeps_all):
            self._closed = []
        self.first = first
        self.stamps = self.stamps[count:]
        self._poses.drop_first(count)
        self._steps.drop_first(count)
        self.variances.drop_first(count)
        self.sightings = self.sightings[~old]
        before = self._prior.replace(eliminated, self._linearisation_point(), drift)
        self.passive.replace(slice(3, HEAD), before)

    def without_home(self, state: Marginal, ids: np.ndarray | None = None) -> Marginal:
        """Return a state of the last solution, or propagated from it, without home factors.

        Its landmarks are those of `ids` (n,), by default the active ones.
        """
        known = self._known_by_home
        if known is None:
            return state
        return known.removed_from(state, self.ids if ids is None else ids)

    def residuals(self) -> np.ndarray:
        """Return the residuals of sightings, measured minus expected bearing, (m,) [rad]."""
        rows = self.sightings
        seen = sight(self.cameras(rows), self.state.positions[self.index(rows[:, LANDMARK])])
        return np.asarray(wrap(rows[:, BEARING] - seen.bearing))

    def range_deviations(self, since: int) -> np.ndarray:
        """Return the residuals of ranges from keyframe `since` on, (m,) [standard deviations]."""
        rows = self.sightings
        found = self._ranges(rows[rows[:, KEYFRAME] >= since])
        return found.deviations(self.poses, self.state.mean[3:]) if found else np.zeros(0)

    def effective_sigmas(self, rows: np.ndarray) -> np.ndarray:
        """Return the effective standard deviations of rows (m,) [rad].

        They are larger for correlated sightings, and for landmarks that may walk.
        """
        p_static = self.p_static[self.index(rows[:, LANDMARK])]
        return np.asarray(effective_sigmas(rows, self._correlated) / np.sqrt(p_static))

    def linearised(self, mount_sigmas: np.ndarray | None = None) -> Linearised:
        """Return the window, linearised; `mount_sigmas` (3,) may replace those of the prior."""
        window = self._window()
        if mount_sigmas is not None:
            window.weights[MOUNT] = mount_sigmas**-2.0
        return kernels.linearised(window, self._add_more())

    def _window(self) -> Window:
        """Return all knowledge of poses, calibration and landmarks but survey and ranges."""
        time_constant, sigma = self.time_constant_prior
        at = [*ONE_SIDED, *range(NC)[MOUNT]]
        weights, means, is_one_sided = np.zeros(NC), np.zeros(NC), np.zeros(NC, bool)
        weights[at] = np.array([self.slip_sigma, sigma, *self.mount_sigmas]) ** -2.0
        means[TIME_CONSTANT] = time_constant
        is_one_sided[self.one_sided] = True
        bounds = is_one_sided, self._bounded
        seen, prior, shared = self._seen(self.sightings), self._prior, self.state.mean[3:]
        known = self._steps.rows, seen, prior.information, prior.gradient, prior.at
        return Window(self.poses, shared, *known, weights, means, *bounds)

    def _add_more(self) -> AddMore | None:
        """Return what adds survey, home and ranges to normal equations; None: there are none."""
        add_ranges, survey, ids = self._add_ranges(self.sightings), self.survey, self.ids
        at_home, self._added = self.at_home and self.at_home.among(ids), None
        if not survey.is_given and at_home is None:
            return add_ranges

        def add(e: NormalEquations, poses: np.ndarray, shared: np.ndarray) -> None:
            nonlocal at_home
            positions = shared[NC:].reshape(-1, 2)
            if survey.is_given:
                survey.add_to(e, positions, ids)
            if at_home is not None:
                self._added, at_home = at_home.add_to(e, positions, ids)
            if add_ranges is not None:
                add_ranges(e, poses, shared)

        return add

    def _add_ranges(self, rows: np.ndarray) -> AddMore | None:
        """Return the function that adds the ranges in rows of the table; None: there are none."""
        found = self._ranges(rows)
        return found.add_to if found else None

    def _ranges(self, rows: np.ndarray) -> RangeFactors | None:
        """Return the ranges in rows of the table; None: there are none, or they are not used."""
        rows = rows[rows[:, RANGE_SIGMA] > 0.0]
        if not (len(rows) and self.uses_ranges):
            return None
        landmark = self.index(rows[:, LANDMARK])
        known = landmark, self.p_static[landmark], self.range_ratio
        return RangeFactors(rows, self.frames, self.first, *known)

    def _seen(self, rows: np.ndarray) -> SightedFrom:
        """Return the bearings in rows of the table, for the normal equations."""
        landmark = self.index(rows[:, LANDMARK])
        return SightedFrom(
            rows[:, BEARING].copy(),
            rows[:, SIGMA].copy(),
            effective_sigmas(rows, self._correlated) / np.sqrt(self.p_static)[landmark],
            rows[:, FRAME].astype(int) - self.frames.first,
            landmark,
            self.frames.keyframes - self.first,
            self.frames.free,
            self.frames.jacobians,
        )

    def _linearisation_point(self) -> np.ndarray:
        """Return oldest pose, calibration and landmarks as one vector."""
        return np.concatenate([self.poses[0], self.state.mean[3:]])
