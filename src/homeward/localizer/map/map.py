"""The map: keyframes, landmark life cycle, and the solution of the window at each keyframe."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping

import numpy as np

from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.settings import DriveSettings
from homeward.estimator import Counts
from homeward.geometry.se2 import compose
from homeward.localizer import kernels
from homeward.localizer.inputs.bearing_noise import BearingNoise, ById, WeighedFrame
from homeward.localizer.map.gating import Gated
from homeward.localizer.map.landmarks import Landmarks, numbers
from homeward.localizer.map.learning.changes import ChangeTest, ModelChange
from homeward.localizer.map.learning.learner import Learner
from homeward.localizer.map.ranges import ScaleErrors
from homeward.localizer.map.sightings import AGE, GAP, LANDMARK, MIN_COVARIANCE, SIGMA
from homeward.localizer.map.smoother import NO_TAIL, Smoother
from homeward.localizer.map.survey.survey import Registration, Survey
from homeward.localizer.motion.extrinsics import Extrinsics
from homeward.localizer.motion.odometry import ProcessNoise, calibration_sigmas
from homeward.localizer.motions import (
    CAMERA_X,
    CAMERA_Y,
    CAMERA_YAW,
    DELAY,
    SPEED_SCALE,
    TURN_SLIP,
    Motion,
    camera_after,
)
from homeward.localizer.reference.frame import GateInput
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import (
    BASELINE,
    CALIBRATION_DRIFT,
    EVALUATED_AFTER_DENIAL,
    EVALUATIONS_PER_WINDOW,
    INLIER,
    INTERVAL_OF_SIDEWAYS,
    LONG_WINDOW,
    MAX_IDS,
    MAX_PER_KEYFRAME,
    NEGLIGIBLE,
    STANDSTILL,
    WINDOW_S,
)
from homeward.reasons import Rejection


class Map:
    """The map in the odometry frame, whose origin is the robot's pose at the start, time `t` [s].

    The residuals update `noise` and `process_noise`; `extrinsics` is the prior on the camera's pose
    on the robot, `known` has surveyed landmarks and distances, `scale` is that of speeds and
    ranges, and `home` are the landmarks that home saw.
    """

    def __init__(
        self,
        drive: DriveSettings,
        settings: LocalizerSettings,
        noise: BearingNoise,
        process_noise: ProcessNoise,
        extrinsics: Extrinsics,
        counts: Counts,
        t: float,
        known: KnownLandmarks,
        scale: ScaleErrors,
        home: Collection[str],
    ) -> None:
        self.home = home
        """Landmarks that home saw."""
        self._settings, self._counts = settings, counts
        self._interval = settings.keyframe_interval
        if drive.odometry.sideways_sigma:
            self._interval *= INTERVAL_OF_SIDEWAYS
        self._process_noise, self._extrinsics = process_noise, extrinsics
        self._mount = np.array(drive.sensor.pose)
        sigmas = calibration_sigmas(drive, settings, scale.state)
        drift = CALIBRATION_DRIFT * np.concatenate([sigmas, extrinsics.sigmas])
        given, lag = drive.odometry, drive.odometry.lag or (0.0, 0.0)
        self.smoother = Smoother(sigmas, drift**2, extrinsics.sigmas, noise.correlated, t, lag)
        self.smoother.range_ratio = scale.ratio
        if given.turn_slip_sigma is not None:
            self.smoother.one_sided.remove(TURN_SLIP)
        is_lag_known = given.lag is not None
        if is_lag_known and given.delay_sigma is None:
            self.smoother.one_sided.append(DELAY)
        lag_sigma = None if is_lag_known else settings.time_constant_sigma
        self._learner = Learner(
            noise, process_noise, extrinsics, lag_sigma, self.smoother.slip_sigma
        )
        self.landmarks = Landmarks(self.smoother, settings.parallax)
        survey = Survey(known, settings, drive.together)
        self.registration = Registration(survey, self.landmarks)
        self.changes = {CAMERA_YAW: ChangeTest(), SPEED_SCALE: ChangeTest()}
        """Tests for a knocked camera, and for another scale of the odometry."""
        self._num_doubted = 0
        """Number of solutions since one of them has been suspected."""
        self.denied_at = -settings.window
        """Newest keyframe at which bearings denied a motion: then the window is solved often."""
        self.begun = t
        self.evaluated = True
        """Whether the newest solution was evaluated: landmarks that do not fit it are dropped, and
        learning from it may be due. That takes long, so it is not done at each keyframe."""
        self._evaluated = self.smoother.ids, self.smoother.state.positions
        self._learnt_at = 0
        """Newest keyframe when learning from a solution was due last."""
        self.busy = False
        """Whether the newest frame has taken long already: for an evaluation, or learning."""
        self._after_evaluation: list[Callable[[], None]] = []
        """Learning that is due, one piece per frame."""
        self._evaluation_due = True
        """Whether the solution at this keyframe is to be evaluated."""
        self._last_path = 0.0
        """Path from the newest keyframe to the last frame [m]."""
        self._counts_here: dict[str, int] = {}
        """Sightings of each landmark from the newest keyframe."""
        self._seen = ById[tuple[float, float]]()
        """When each landmark was first and last seen [s]."""
        self._is_vague, self._num_vague = False, 0
        """Whether odometry to the newest frame is too uncertain for the map, so that its bearings
        only show landmarks that are new or moved; number of such frames since the keyframe."""
        self._num_between = 0
        """Number of frames since the keyframe that are not vague and not in a solution yet."""
        self._ranges_counted = 0
        """First keyframe whose ranges have not been counted."""
        self._scale_information = 0.0
        """Information on the scale by the motions, at the initial process noise [1]."""

    @property
    def scale_variance(self) -> float:
        """Variance of the map's scale by slips that leave no residuals [1]."""
        common_slip = self._process_noise.common_slip_variance
        return common_slip / max(self._scale_information, common_slip) if common_slip else 0.0

    def camera_pose(self, offset: np.ndarray | None) -> np.ndarray:
        """Return the pose of a camera on the robot, (3,) [m, m, rad], by the newest state."""
        calibration = self.smoother.state.calibration
        on_robot = self._mount + calibration[[CAMERA_X, CAMERA_Y, CAMERA_YAW]]
        return on_robot if offset is None else compose(on_robot, offset)

    def camera_at(self, motion: Motion, offset: np.ndarray | None) -> np.ndarray:
        """Return the pose of a camera in the odometry frame, (3,) [m, m, rad], after a motion.

        The motion is from the newest keyframe, and `offset` as for `camera`.
        """
        robot = compose(self.smoother.state.mean[:3], motion.delta)
        return compose(robot, self.camera_pose(offset))

    def camera(self, motion: Motion, offset: np.ndarray | None = None) -> Motion:
        """Return the motion to a camera after the robot's from the newest keyframe.

        `offset` (3,) is its pose in the frame of the first camera; None for the first.
        """
        return camera_after(motion, self._mount, self.smoother.state.calibration, offset)

    def places_for_home(
        self, names: list[str], smoother: Smoother
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return positions of q landmarks when home saw them, as far as known.

        Their indices in the state of a smoother (q,); the probability that each walks (q,), and the
        second moment of its offset if so (q, 2, 2) [m^2].
        """
        known = self.landmarks
        landmarks = [known.former.get(n) or known.mapped[n] for n in names]
        walk_moment = np.array([m.walk_moment for m in landmarks]).reshape(-1, 2, 2)
        index = smoother.index(numbers(landmarks))
        return index, known.walking_probabilities(landmarks), walk_moment

    @property
    def is_window_full(self) -> bool:
        """Whether solutions are rare and take long, so that work is spread over frames."""
        return len(self.smoother.stamps) >= self._settings.window

    def learn(self, everything: bool = False) -> None:
        """Do a piece of the work after an evaluation: learning from residuals, marginalisation.

        Or `everything` that is due. `numpy.linalg.LinAlgError` when the map has become singular.
        """
        self.busy = bool(self._after_evaluation)
        while self._after_evaluation:
            self._after_evaluation.pop(0)()
            if not everything:
                break

    def _learn_bearings(self) -> None:
        """Test for changes of the robot, learn from the residuals of bearings, and marginalise."""
        self._test_changes()
        if not self.has_doubt:
            self._learner.learn_bearings(self.smoother, self.landmarks)
        self._count_ranges()
        if self._learner.free_contradicted(self.smoother):
            self._solve()
        self._marginalise_old()

    def _test_changes(self) -> None:
        """Test the last solution for a knocked camera, and for another scale of the odometry."""
        if not self._learner.is_noise_confirmed:
            return
        camera, odometry = self.changes[CAMERA_YAW], self.changes[SPEED_SCALE]
        camera.add_yaw(self.smoother, self._extrinsics.widest(self.smoother.state.scale))
        odometry.add_scale(self.smoother, camera.square)
        if odometry.square > camera.square:
            camera = self.changes[CAMERA_YAW] = ChangeTest()
        if camera.possible is not None or odometry.is_suspected:
            self.denied_at = self.smoother.newest
        is_suspected = camera.is_suspected or odometry.is_suspected
        self._num_doubted = self._num_doubted + 1 if is_suspected else 0

    @property
    def has_doubt(self) -> bool:
        """Whether the camera or the odometry may have changed, by the solutions of one window.

        Then no landmark counts as moved, and nothing is learnt: that would explain a change away.
        But where it is not proved soon, or the map is young, residuals are rather those of noise or
        of landmarks that move.
        """
        return self.is_window_full and 0 < self._num_doubted <= EVALUATIONS_PER_WINDOW

    def _learn_odometry(self) -> None:
        """Learn from the residuals of motions."""
        if self.landmarks.mapped:
            self._learner.learn_odometry(self.smoother)

    def change(self, proved: ModelChange) -> None:
        """Apply a change of the camera or the odometry; see `Smoother.change`."""
        if proved.state == CAMERA_YAW:
            self._mount[2] += proved.size
            self.smoother.mount_sigmas = self._extrinsics.sigmas
        self.smoother.change(proved.state, proved.keyframe, proved.size)
        self.landmarks.drop_candidates_before(self.smoother.first)
        self.changes[proved.state] = ChangeTest()
        self._solve()

    def _count_ranges(self) -> None:
        """Count the ranges that came since the last solution, and that it accepts or not."""
        deviations = np.abs(self.smoother.range_deviations(self._ranges_counted))
        self._ranges_counted = self.smoother.newest + 1
        accepted = int(np.count_nonzero(deviations < INLIER))
        self._counts.ranges += accepted
        self._counts.reject(Rejection.RANGE_OUTSIDE_GATE, deviations.size - accepted)

    def wants_keyframe(self, t: float, motion: Motion) -> bool:
        """Return whether the robot is far enough from its newest keyframe, or has stopped."""
        stopped, self._last_path = 0.0 < motion.path == self._last_path, motion.path
        due = t - self.smoother.stamps[-1] >= self._interval
        scale = self.smoother.state.scale if self.landmarks.mapped else 0.0
        shift = max(motion.path, math.sqrt(motion.covariance[0, 0]))
        return due and (stopped or shift > STANDSTILL * scale or motion.turned > STANDSTILL)

    def add_keyframe(self, t: float, motion: Motion) -> None:
        """Add a keyframe at `t` [s], and propagate the state to it."""
        noise = motion.covariance[0, 0] + motion.covariance[1, 1]
        noise = max(noise, MIN_COVARIANCE[0, 0] + MIN_COVARIANCE[1, 1])  # it may be given as zero
        self._scale_information += motion.path**2 / noise * self._process_noise.scales[1, 0]
        self._add_keyframe(t, motion, self._process_noise.inlier_ratios)

    def _add_keyframe(self, t: float, motion: Motion, inlier_ratios: np.ndarray) -> None:
        """Add a keyframe; see `Smoother.add_keyframe`."""
        smoother = self.smoother
        kept, since = len(smoother.stamps) + 1, smoother.newest + 1 - self._learnt_at
        full, every = kept >= self._settings.window, kept / EVALUATIONS_PER_WINDOW
        if smoother.newest - self.denied_at < self._settings.window:
            every = min(every, EVALUATED_AFTER_DENIAL)
        self._evaluation_due = not full or since >= every or not smoother.converged
        smoother.add_keyframe(t, motion, inlier_ratios)
        self._counts_here.clear()
        self._num_vague = self._num_between = 0

    def gate(self, frame: WeighedFrame, motion: Motion, new_keyframe: bool) -> Gated:
        """Gate the bearings of a frame: innovations, and which of them are accepted.

        The motion led to the frame; with `new_keyframe`, the newest keyframe is at its end, not at
        its start.
        """
        smoother, state, ids = self.smoother, self.smoother.state, self.landmarks.ids(frame.names)
        stamp = self._num_between + 1
        given = GateInput(
            mean=state.mean,
            covariance=state.covariance,
            p_static=smoother.p_static,
            scale=math.inf if new_keyframe else state.scale,
            motion=motion,
            is_keyframe=new_keyframe,
            mount=self._mount,
            offset=frame.offset,
            bearings=frame.bearings,
            sigmas=frame.sigmas,
            landmark=np.where(ids >= 0, smoother.index(ids), -1),
            gate=self._settings.gate,
            stamps=(stamp, stamp + self._num_vague),
        )
        found = kernels.gate_frame(given)
        rows = smoother.frames.add(smoother.newest, found.free, found.jacobian, frame)
        rows[:, LANDMARK] = ids
        return Gated.of(frame, given, rows, found)

    def drop_frame(self) -> None:
        """Drop the frame that was gated last, before an update with it."""
        self.smoother.frames.drop_newest()

    def inflate(self, gated: Gated) -> bool:
        """Inflate bearings between keyframes by the odometry noise; return whether they are useful.

        They are not where odometry since the keyframe is too uncertain and nothing is mapped. Where
        it is uncertain and something is mapped, they only add to candidates.
        """
        self._is_vague = False
        if gated.new_keyframe:
            return True
        motion, found = gated.motion, gated.result
        across = 0.5 * (motion.covariance[0, 0] + motion.covariance[1, 1])
        nothing_mapped = gated.frame.names and not self.smoother.ids.size
        if nothing_mapped and across > (motion.path / BASELINE) ** 2:
            self._counts.reject(Rejection.VAGUE_ODOMETRY, len(gated.frame.names))
            return False
        gated.rows[:, SIGMA], self._is_vague = found.inflated, found.is_vague
        self._num_vague += self._is_vague
        return True

    def update(self, gated: Gated, moved: list[str]) -> bool:
        """Update the map by accepted bearings; return whether there is a new solution.

        Landmarks in `moved` are not where they were mapped, and are reinitialised.
        `numpy.linalg.LinAlgError` when the map has become singular.
        """
        kept = self._add_sightings(gated.frame, gated.rows, gated.result.eye[2], gated.fits)
        fixed = bool(self.landmarks.expected and not self.landmarks.mapped)
        briefly = not self._extrinsics.is_assumed
        changed = bool(moved and self.landmarks.reinitialise(moved, briefly)) or fixed
        rests = gated.motion.path == 0.0 and bool(kept.any())  # standing, with new bearings
        due = gated.new_keyframe or changed or rests
        if due:
            self._correct(changed)
        if fixed and not self.landmarks.mapped:
            self.landmarks.expected = {}  # wait for the next frame
        return due

    def reset_pose(self, frame: WeighedFrame, motion: Motion) -> None:
        """Reset the pose to a motion from the newest keyframe, and add the frame seen there.

        `numpy.linalg.LinAlgError` when the map has become singular.
        """
        self._add_keyframe(frame.t, motion, NO_TAIL)
        self.denied_at = self.smoother.newest
        here = Motion.identity()
        camera = self.camera(here, frame.offset)
        rows = self.smoother.frames.add(
            self.smoother.newest, camera.uncalibrated, camera.jacobian, frame
        )
        rows[:, LANDMARK] = self.landmarks.ids(frame.names)
        self._add_sightings(frame, rows, float(self.camera_at(here, frame.offset)[2]), {})
        self._correct(True)

    def revert_to(self, keyframe: int) -> None:
        """Revert the landmarks to those of a keyframe, undoing later initialisations and moves.

        `numpy.linalg.LinAlgError` when the map has become singular.
        """
        self.landmarks.revert_to(keyframe)
        self._correct(True)

    def integrate_again(self, since: float, between: Callable[[float, float], Motion]) -> None:
        """Integrate the motions since a time again, and evaluate the next solution with them."""
        self.smoother.integrate_again(since, between, self._mount)
        self._evaluation_due = True

    def replace_solution(self, whole: Smoother) -> None:
        """Adopt the solution of the whole drive, for the same landmarks."""
        self.smoother = whole
        self.landmarks.replace_solution(whole)
        self._after_evaluation = []

    def _add_sightings(
        self, frame: WeighedFrame, rows: np.ndarray, heading: float, fits: Mapping[str, bool]
    ) -> np.ndarray:
        """Add accepted sightings to the window, others to candidates; return which, (m,) bool.

        `heading` [rad] is that of the camera in the odometry frame.
        """
        t, names, skipped = frame.t, frame.names, 0
        kept = np.zeros(len(names), bool)
        before = [self._seen.get(name, (t, -math.inf)) for name in names]
        rows[:, [AGE, GAP]] = t - np.array(before).reshape(-1, 2)
        for i, name in enumerate(names):
            if self._is_vague and fits.get(name, False):
                self._counts.reject(Rejection.VAGUE_ODOMETRY)
                continue
            taken = self._counts_here[name] = self._counts_here.get(name, 0) + 1
            if taken > MAX_PER_KEYFRAME:
                skipped += 1
                continue
            self._seen[name] = before[i][0], t
            if not fits.get(name, True):
                self._counts.reject(Rejection.OUTSIDE_GATE)
                self.landmarks.add_rejected(t, name, rows[i])
            else:
                kept[i] = True
        if len(self._seen) > MAX_IDS:
            self._seen.prune(lambda seen: seen[1] < t - WINDOW_S)
        if skipped:
            self._counts.reject(Rejection.STANDING, skipped)
        self._counts.used += int(np.count_nonzero(kept))
        if skipped == len(names):
            self.smoother.frames.drop_newest()
        accepted = rows[kept]
        fitting = [n for n, k in zip(names, kept.tolist(), strict=True) if k]
        self.landmarks.add_accepted(t, fitting, accepted, heading + frame.bearings[kept])
        self._num_between += not self._is_vague
        return kept

    def _correct(self, changed: bool) -> None:
        """Solve the window with the newest sightings, after landmarks have `changed` or not."""
        initialised = self.landmarks.initialise()
        if initialised:
            self.registration.fix_expected()
        self.evaluated = False
        if changed or initialised or self._evaluation_due:
            self._solve()
        else:
            self.smoother.solve()
            if self._has_moved():
                if self.smoother.leaves_view and self.smoother.converged:
                    self._evaluate()
                else:
                    self._solve()
        self._num_between = 0

    def _has_moved(self) -> bool:
        """Return whether a landmark has moved notably in the map since the last evaluation."""
        (ids, before), state = self._evaluated, self.smoother.state
        now, reach = state.positions, state.reach
        if ids is not self.smoother.ids:  # some have become active since
            _, here, then = np.intersect1d(self.smoother.ids, ids, True, return_indices=True)
            now, reach, before = now[here], reach[here], before[then]
        return bool((np.hypot(*(now - before).T) > NEGLIGIBLE * reach).any())

    def _solve(self) -> None:
        """Solve the window, and evaluate the solution."""
        if self.landmarks.mapped:
            self._learner.scale_noise_prior(self.smoother)
        self.smoother.solve()
        self._evaluate()

    def _evaluate(self) -> None:
        """Remove landmarks that do not fit the solution, and learn from it where that is due.

        In a hall, landmarks come into view all the time: then learning keeps its interval.
        """
        self.busy, smoother = True, self.smoother
        if smoother.converged:
            self.registration.evaluate()
        misfits = self.landmarks.drop_misfits(smoother.residuals()) if smoother.converged else 0
        if misfits:
            self._counts.reject(Rejection.INCONSISTENT_LANDMARK, misfits)
            smoother.solve()
        self._evaluated = smoother.ids, smoother.state.positions
        self.evaluated = True
        work = [self._test_changes]
        if self._evaluation_due or not smoother.leaves_view:
            self._learnt_at = smoother.newest
            work = [self._learn_bearings, self._learn_odometry]
        self._after_evaluation += [piece for piece in work if piece not in self._after_evaluation]
        if not self.is_window_full:  # takes no time
            self.learn(everything=True)

    def replace_survey(self, known: KnownLandmarks) -> None:
        """Replace the survey by a newer one in the same frame, and solve the window with it."""
        self.registration.replace(known)
        if self.landmarks.mapped:
            self._solve()

    def _marginalise_old(self) -> None:
        """Marginalise the oldest keyframes that are not needed any more."""
        settings, smoother = self._settings, self.smoother
        kept = len(smoother.stamps)
        spare = kept - settings.window
        if spare <= 0:
            return
        longest = max(settings.window, LONG_WINDOW // max(smoother.ids.size, 1))
        longest = min(longest, settings.longest_window)
        since = smoother.newest - longest
        needed = self.landmarks.first_needed(settings.mature_parallax, since)
        if (jump := self.changes[CAMERA_YAW].possible) is not None:
            needed = min(needed, jump.keyframe - 1)
        count = max(min(spare, needed - smoother.first), kept - longest)
        if count > 0:
            self.landmarks.drop_undetermined(smoother.first + count)
            smoother.marginalise(count)
            self.landmarks.drop_candidates_before(smoother.first)
            if not self.registration.survey.known.is_given:
                self.landmarks.deactivate(self.home)
            smoother.linearise_again()
