"""Chart: one map in the odometry frame, and home in it (one map of an atlas, as in ORB-SLAM3).

`Chart.add_bearings` is the heart of the localiser.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping

import numpy as np

from homeward.drives.drive import HomeBearing
from homeward.drives.landmarks import KnownLandmarks
from homeward.drives.settings import DriveSettings, Mount
from homeward.estimator import (
    MIN_AGREEING,
    NO_BEARINGS_S,
    Counts,
    Estimate,
    Innovation,
    LandmarkEstimate,
    Status,
)
from homeward.geometry.frames import between
from homeward.localizer.home.tracker import HomeTracker
from homeward.localizer.inputs.bearing_noise import BearingNoise, WeighedFrame
from homeward.localizer.inputs.reorder import BearingFrame
from homeward.localizer.map.gating import Gated
from homeward.localizer.map.map import Map
from homeward.localizer.map.ranges import ScaleErrors
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.motion.extrinsics import Extrinsics
from homeward.localizer.motion.odometry import OdometryIntegrator, ProcessNoise, calibration_sigmas
from homeward.localizer.motions import (
    CAMERA_YAW,
    DELAY,
    HEAD,
    SPEED_SCALE,
    TIME_CONSTANT,
    Motion,
)
from homeward.localizer.output.contradiction import Contradiction
from homeward.localizer.output.faces import (
    EstimatedCalibration,
    PredictedBearings,
    estimated_calibration,
    predicted_bearings,
)
from homeward.localizer.output.landmark_report import LandmarkReport
from homeward.localizer.output.status import (
    IntegrityMonitor,
    too_few_at_home,
    why_home_is_not_found,
)
from homeward.localizer.recovery.monitor import Health, Monitor, carried_since, odometry_lost
from homeward.localizer.recovery.relocalise import at_pose, by_odometry, find_by_frame, pose_reset
from homeward.localizer.recovery.survey_fix import FirstFix, Resected, Resection
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import (
    ADVANCE_S,
    MEAN_S,
    MEMORY_OF_LAG_S,
    RESECTION_S,
    SLIP_MEMORY_S,
    SLIP_SHARE,
    WINDOW_S,
)
from homeward.odometry.history import Driven, Reckoned, TwistHistory
from homeward.reasons import Reason, Rejection


class Chart:
    """A map, home in it, and the estimators and monitors of both.

    `home`, `drive` and `settings` are those of the `Localizer`, validated.
    """

    def __init__(
        self,
        home: Mapping[str, HomeBearing],
        drive: DriveSettings,
        settings: LocalizerSettings,
        counts: Counts,
        twists: TwistHistory,
        known: KnownLandmarks,
    ) -> None:
        self.counts, self._twists = counts, twists
        self.noise = BearingNoise(drive.sensor.bearing_sigma, settings.bearing_sigma)
        self.process_noise = ProcessNoise(drive.odometry, settings.odometry)
        self.odometry = OdometryIntegrator(twists, self.process_noise)
        self.extrinsics = Extrinsics(drive, settings)
        self.home = HomeTracker(home, drive, settings, self.noise)
        self.drive, self._settings, self._known = drive, settings, known
        """Settings of the drive; the camera's are those of the camera as it was turned last."""
        self._is_surveyed_from_home = known.surveyed_from_home
        self.scale = ScaleErrors.of(drive, settings, known)
        self._integrity = IntegrityMonitor(settings, self.scale.rest)
        self.last_accepted = -math.inf
        """Time of the last frame of which a bearing was accepted [s]."""
        self._in_view: frozenset[str] = frozenset()
        """Landmarks of that frame."""
        self._driven_at_fit = Driven()
        """Wheel motion up to the last frame of which most bearings were accepted."""
        self._at_keyframe = twists.at(-math.inf)
        """Dead reckoning at the newest keyframe."""
        self.slipped_at = -math.inf
        """When bearings last denied a motion [s]."""
        self._resection = Resection()
        self._keeps = False
        self._begin_map(0.0)

    def begin(self, t: float) -> None:
        """Begin the map at the robot, at `t` [s]."""
        self._begin_map(t)
        if self.home.observation.has_start:
            self._find_home(t)

    def retain_marginalised(self) -> None:
        """Keep marginalised keyframes for `finalise`; memory then grows with the drive."""
        self._keeps = True
        self.map.smoother.retain_marginalised()

    def replace_known(self, known: KnownLandmarks, t: float) -> None:
        """Replace the surveyed landmarks by newer ones in the same frame, at `t` [s]."""
        self._known = known
        try:
            self.map.replace_survey(known)
        except np.linalg.LinAlgError:
            self._give_up_map()
        self._find_home(t)

    def replace_home(self, home: Mapping[str, HomeBearing], t: float) -> None:
        """Replace the home bearings, whose landmarks are found without ids, at `t` [s]."""
        self.home.replace(home, self.drive, self._settings)
        self.map.home = self.home.observation.bearings
        self._find_home(t)

    def follow(self, t: float) -> None:
        """Integrate the odometry after a twist of `t` [s] has arrived."""
        self.odometry.rewind(t)
        if t - self.odometry.end > ADVANCE_S:
            self.odometry.run_ahead(t, self.map.smoother.state.calibration)

    @property
    def needed_since(self) -> float:
        """Oldest stamp of the twists that are still needed [s]."""
        return min(self.odometry.needed_since, self._integrable_since - MEMORY_OF_LAG_S)

    @property
    def _integrable_since(self) -> float:
        """Since when motions in the window can be integrated again [s]."""
        return max(self.map.smoother.stamps[0], self.odometry.end - WINDOW_S)

    def add_bearings(self, frame: BearingFrame, reckoned: Reckoned, now: float) -> list[Innovation]:
        """Process all bearings of one stamp; return their innovations.

        The frame is not before the last one, `reckoned` is dead reckoning at its stamp, and `now`
        the newest stamp of all [s].
        """
        if reckoned.age == math.inf and not self._known.landmarks:
            self.counts.reject(Rejection.NO_ODOMETRY, len(frame.sightings))
            return []
        was_singular = self.learn(frame.t, frame.sightings)  # 0 noise, walkers, landmarks in view
        seen = self.noise.weigh(frame, reckoned)  # 1 measurement noise
        if frame.offset is not None:
            sigma = self.drive.cameras[frame.camera].bearing_sigma_at(self.map.smoother.state.scale)
            seen = seen._replace(sigmas=np.hypot(seen.sigmas, sigma))
        calibration = self.map.smoother.state.calibration
        motion = self.odometry.advance(seen.t, calibration)  # 2 preintegration
        rates = self.process_noise.rates
        self._contradiction.add_bearings(seen, self.map, motion, rates, reckoned)
        gated = found = None
        health = self.monitor.assess_odometry(motion, self.map)  # 3 can bearings be predicted?
        reset = health is Health.NO_MAP
        if self._is_surveyed_from_home and self._twists.unknown_time(seen.t) >= RESECTION_S:
            found = self._resect(seen)
            if found is None:
                self.counts.reject(Rejection.VAGUE_ODOMETRY, len(seen.names))
                return []
            seen, reset = found.frame, True
        if reset:
            motion = self._reset_map(seen.t)
        if found is not None:
            self.map.registration.expect(found.origin, found.names)
            self.last_accepted = seen.t
        if reset or health is Health.OK:
            self._take_first_fix(seen, motion)
            gated = self._gate(seen, motion)  # 4 keyframe, innovations, outlier rejection
            health = self.monitor.assess_innovations(gated, self.map)  # 5 monitor
        changed = self._react(health, seen, gated, motion)  # 6 update, or relocalisation
        if changed or reset or was_singular:
            self._find_home(now)  # 7 resection of home, inlier home bearings; 8 status, covariance
        return gated.innovations if gated is not None else []

    def learn(self, t: float, in_view: Collection[str] = (), everything: bool = False) -> bool:
        """Learn from the last solution; return whether the map was reset at `t` [s] as singular.

        At most a piece of the work that is due, unless `everything`. Then the landmarks `in_view`
        of the next frame are made active.
        """
        if self.map.evaluated and self.noise.confirmed and self.map.smoother.is_stale:
            calibration, since = self.map.smoother.state.calibration, self._integrable_since
            self.map.integrate_again(
                since, lambda begin, end: self.odometry.between(begin, end, calibration)
            )
        try:
            self.map.learn(everything)
            for state in self.map.changes:
                change = self.map.changes[state].proved
                if change is not None and change.keyframe > self.map.smoother.first:
                    if state == CAMERA_YAW:
                        self._turn_camera(change.size)
                    self.map.change(change)
            self.map.landmarks.activate(in_view)
        except np.linalg.LinAlgError:
            self.counts.reject(Rejection.MAP_RESET)
            self._reset_map(t)
            return True
        return False

    def _turn_camera(self, size: float) -> None:
        """Turn the camera by `size` [rad], but not at home, where it saw the home bearings."""
        self.home.observation.fix_camera(self.map.smoother.state.calibration)
        x, y, yaw = self.home.observation.mount.tolist()
        turned, home = self.extrinsics.turn(size), Mount(x=x, y=y, yaw=yaw)
        self.drive = self.drive.model_copy(update={"sensor": turned, "home_sensor": home})

    def finalise(self, whole: Smoother) -> bool:
        """Find home again by the solution of a whole drive, also for `landmarks`.

        `whole` is the map with all keyframes in its window, solved. Where home is not found,
        everything stays as it was, and the return value is False.
        """
        found = self.home.finalise(self.map, whole)
        if found:
            self.map.replace_solution(whole)
            self._integrity.update(self.home.hypotheses, True, self.home.stayed(self.map))
        return found

    @property
    def has_pose(self) -> bool:
        """Whether there is a pose to publish."""
        found = self.home.hypotheses is not None
        return found and not self.monitor.is_lost and self._integrity.fixed

    def estimate(
        self, t: float, innovations: tuple[Innovation, ...] = (), complaint: str | None = None
    ) -> Estimate:
        """Return the estimate at `t` [s], not before the newest keyframe, with its innovations.

        `complaint` is the reason to give where there is no pose.
        """
        if self.home.hypotheses is None:
            sets = self.map.landmarks.mapped, self._seen_from_home, self.home.names
            words = complaint or why_home_is_not_found(*sets, bool(self._twists))
            return Estimate(t, Status.MAPPING, words, None, None, innovations)
        if self.monitor.is_lost:
            words = complaint or self.monitor.reason.words
            return Estimate(t, Status.MAPPING, words, None, None, innovations)
        state, moved = self.map.smoother.state, None
        motion = self.odometry.motion(t, state.calibration)
        if odometry_lost(motion, state):
            words = complaint or Reason.LOST.words
            return Estimate(t, Status.MAPPING, words, None, None, innovations)
        if motion is not Motion.identity() or self._may_slip(t):
            moved = motion.delta, self.drift(t, motion)
        late = self.between_stamps(t, self._twists)
        found = self._integrity.estimate(t, moved, late, self.coasts(t), innovations)
        if found.pose is None:
            number = len(self._seen_from_home)
            words = found.reason if number >= MIN_AGREEING else too_few_at_home(number)
            return dataclasses.replace(found, reason=complaint or words)
        if found.status in (Status.LOCALISED, Status.COASTING):
            doubt = None
            if self._known.landmarks:
                doubt = self.map.registration.survey.contradiction(self._in_view)
            is_open = self.extrinsics.is_turn_open(state.calibration_variances)
            if self.map.changes[CAMERA_YAW].is_suspected or is_open:
                doubt = Reason.CAMERA_TURNED.words
            is_open = self.map.smoother.is_scale_open
            if self.map.changes[SPEED_SCALE].is_suspected or is_open:
                doubt = Reason.ODOMETRY_CHANGED.words
            if self.map.smoother.is_unsolved:
                doubt = doubt or Reason.UNSOLVED.words
            if self.monitor.is_suspected:
                doubt = doubt or Reason.UNFIT.words
            if self.monitor.displacement is not None:
                doubt = doubt or Reason.RELOCALISED.words
            if doubt is not None:
                found = dataclasses.replace(found, status=Status.UNVERIFIED, reason=doubt)
        if self._contradiction.is_proved:
            return self._contradiction.applied(found, state, motion)
        return found

    @property
    def _seen_from_home(self) -> set[str]:
        """Landmarks that home saw, and those of a survey that gives home."""
        surveyed = self._known.landmarks if self._is_surveyed_from_home else ()
        return {*self.home.observation.bearings, *surveyed}

    def between_stamps(self, t: float, twists: TwistHistory) -> np.ndarray:
        """Motion (3,) up to `t` [s] in the lag of odometry behind the bearings [m, m, rad].

        Its delay, and a time constant that was not given: late bearings look like either. Half of
        the averaging time of a twist is of the twist's own stamp. Zero where the delay is given:
        the stamps of the bearings are right then.
        """
        given = self.drive.odometry
        if given.delay_sigma is not None:
            return np.zeros(3)
        state = self.map.smoother.state
        lag = float(state.calibration[DELAY])
        lag += float(state.calibration[TIME_CONSTANT]) if given.lag is None else 0.0
        beyond = max(abs(lag) - 0.5 * MEAN_S, 0.0)
        lag = math.hypot(beyond, math.sqrt(state.calibration_variances[DELAY]))
        return np.array(between(twists.pose(t - lag), twists.pose(t)))

    def drift(self, t: float, motion: Motion) -> np.ndarray:
        """Covariance (3, 3) of a motion from the newest keyframe to `t` [s], with calibration."""
        calibration = self.map.smoother.state.covariance[3:HEAD, 3:HEAD]
        drift = motion.covariance + motion.jacobian @ calibration @ motion.jacobian.T
        return np.asarray(drift + self._slip_covariance(t) if self._may_slip(t) else drift)

    def predict(self, t: float, offset: np.ndarray | None) -> PredictedBearings:
        """Predict the bearings of mapped landmarks at `t` [s]; see `predicted_bearings`."""
        motion = self.odometry.motion(t, self.map.smoother.state.calibration)
        slip = self._slip_covariance(t) if self._may_slip(t) else np.zeros((3, 3))
        return predicted_bearings(self.map, motion, slip, offset)

    @property
    def calibration(self) -> EstimatedCalibration:
        """Calibration and noise as estimated."""
        priors = calibration_sigmas(self.drive, self._settings, self.scale.state)
        noise, rest = (self.noise, self.process_noise), self.scale.rest or 0.0
        return estimated_calibration(self.map.smoother, priors, self.extrinsics, *noise, rest)

    def landmarks(self, with_home: bool) -> list[LandmarkEstimate]:
        """Return the estimate of each landmark, by name; relative to home only if `with_home`."""
        hypotheses = self.home.hypotheses if with_home else None
        if hypotheses is not None and not self._integrity.home_is_found(hypotheses.best):
            hypotheses = None
        observed, calibration = self.home.observation, self.map.smoother.state.calibration
        return LandmarkReport(
            observed.with_noise(self.noise),
            observed.yaw(calibration, self.extrinsics.contradicted),
            self.map.landmarks,
            self.home.names,
            hypotheses,
            self.map.registration.places,
            self.map.registration.survey,
            {**self.home.exchanged, **self.map.registration.survey.exchanged},
            observed.offsets,
        ).landmarks()

    def _take_first_fix(self, seen: WeighedFrame, motion: Motion) -> None:
        """Try a first fix in a survey: the pose from a few frames along a short path."""
        known = self.map.registration
        if not self._known.landmarks or known.has_home or self.map.landmarks.expected:
            return
        eye = self.map.camera_at(motion, seen.offset)
        variances = self.map.smoother.state.propagate(motion).covariance.diagonal()[:3]
        found = self._first_fix.add_frame(seen, eye, variances)
        if found is not None:
            known.expect(*found)
            self.last_accepted = seen.t

    def _resect(self, seen: WeighedFrame) -> Resected | None:
        """Return the survey's pose from one frame; None if the frame does not determine it."""
        camera = self.map.camera_pose(seen.offset)
        moved = self.odometry.dropout_motion(seen.t).covariance
        return self._resection.find(seen, camera, self.map.registration.survey, moved)

    def _gate(self, seen: WeighedFrame, motion: Motion) -> Gated:
        """Gate a frame after a motion, at a new keyframe where one is due.

        One is also due where the bearings contradict the motion: the robot moved without odometry.
        """
        if self.map.wants_keyframe(seen.t, motion):
            gated = self._gate_at_keyframe(seen, motion)
        else:
            gated = self.map.gate(seen, motion, False)
            if gated.contradicts_motion:
                self.map.drop_frame()
                wider = motion if motion.path else self.odometry.dropout_motion(seen.t)
                gated = self._gate_at_keyframe(seen, wider)
                self.map.denied_at = self.map.smoother.newest
        fits = gated.fits.values()
        if any(fits):
            self.last_accepted, self._in_view = seen.t, frozenset(seen.names)
        if 2 * sum(fits) > len(fits):
            self._driven_at_fit = seen.driven
        return gated

    def _gate_at_keyframe(self, seen: WeighedFrame, motion: Motion) -> Gated:
        """Gate a frame at a new keyframe, reached by a motion."""
        self.map.add_keyframe(seen.t, motion)
        self._begin_motion(seen.t, motion)
        return self.map.gate(seen, motion, True)

    def _react(
        self, health: Health, seen: WeighedFrame, gated: Gated | None, motion: Motion
    ) -> bool:
        """React to the monitor's result; return whether there is a new solution."""
        match health:
            case Health.OK if gated is not None:
                return self._update(gated)
            case Health.SLIPPED if gated is not None:
                return self._relocalise(seen, gated.motion) or self._update(gated)
            case Health.NOT_DISPLACED if gated is not None:
                return self._undo_displacement(gated)
            case Health.LOST:
                return self._relocalise(seen, motion)
            case _:
                return self._begin_search(seen, health)

    def _update(self, gated: Gated) -> bool:
        """Update the map by accepted bearings; return whether there is a new solution."""
        if not self.map.inflate(gated):
            return False
        rejected = self.map.landmarks.update_rejections(gated.fits)
        may_move = rejected and not self.map.has_doubt
        moved = self.monitor.moved_landmarks(rejected) if may_move else []
        before = {*self.map.landmarks.former}
        try:
            changed = self.map.update(gated, moved)
            is_new = self.map.landmarks.former.keys() - before
            carried = carried_since(self.map.landmarks) if is_new else None
            if carried is None:
                return changed
            self.map.revert_to(carried)
        except np.linalg.LinAlgError:
            self._give_up_map()
            return True
        return self._begin_search(gated.frame, Health.CARRIED)

    def _begin_search(self, seen: WeighedFrame, why: Health) -> bool:
        """Begin a relocalisation; return whether it succeeds at once."""
        self.odometry.restart(seen.t)
        self.monitor.begin_search(seen.t, why)
        return self._relocalise(seen, Motion.identity())

    def _relocalise(self, seen: WeighedFrame, motion: Motion) -> bool:
        """Try to relocalise the robot, and reset its pose; return whether that succeeds."""
        search = self.monitor.search
        since = search.motion_since(motion)
        search.add_bearings(seen, self.map.camera(since, seen.offset), self.map.landmarks)
        found = search.find(self.map.landmarks, self.map.smoother.state)
        if found is None and self.monitor.is_lost:
            camera = self.map.camera(Motion.identity(), seen.offset)
            driven = seen.driven.since(self._at_keyframe.driven)
            found = find_by_frame(seen, camera, self.map.landmarks, self.map.smoother.state, driven)
            since = Motion.identity()
        if found is None:
            if self.monitor.is_lost:
                self.counts.reject(Rejection.LOST, len(seen.names))
            return False
        state, seconds = self.map.smoother.state, seen.t - self.map.smoother.stamps[-1]
        reckoned = self._at_keyframe, self._twists.at(seen.t)
        odometry = by_odometry(state, *reckoned, self.process_noise.rates, seconds)
        self.monitor.displace(at_pose(*found).compose(since), odometry, state.scale)
        return self._reset_pose(seen, at_pose(*found), since)

    def _undo_displacement(self, gated: Gated) -> bool:
        """Reset the pose to that by odometry, since landmarks moved together, not the robot."""
        found, moved = self.monitor.undo_displacement(self.map.smoother.state)
        self.map.landmarks.declare_moved(moved, gated.frame.t)
        return self._reset_pose(gated.frame, found, gated.motion)

    def _reset_pose(self, seen: WeighedFrame, found: Motion, since: Motion) -> bool:
        """Reset the pose to one that was `found`, and a motion since then; return True."""
        reset = pose_reset(self.map.smoother.state.mean[:3], found).compose(since)
        try:
            self.map.reset_pose(seen, reset)
        except np.linalg.LinAlgError:
            self._give_up_map()
            return True
        self._begin_motion(seen.t, reset)
        self.monitor.end_search(seen.t, self.map.smoother.newest)
        if self.monitor.displacement is not None:
            self.monitor.test_displacement(self.map.gate(seen, Motion.identity(), True), self.map)
            self.map.drop_frame()
        self.slipped_at, self._driven_at_fit = seen.t, self._at_keyframe.driven
        return True

    def _find_home(self, now: float) -> None:
        """Update home after a change of the map, and the integrity monitor."""
        try:
            self.home.update(self.map)
            self.share_state(self._integrity)
            updated = self.home.is_updated and not self.coasts(now)
            self._integrity.update(self.home.hypotheses, updated, self.home.stayed(self.map))
        except np.linalg.LinAlgError:  # nothing determines home: search for it again
            self.home.hypotheses = None
            self._integrity.update(None, True)

    def share_state(self, integrity: IntegrityMonitor) -> None:
        """Give an integrity monitor what all keyframes share.

        Errors of the camera extrinsics and of the scale, and whether there was a pose to publish.
        """
        integrity.fixed = self._integrity.fixed
        integrity.set_scale_variance(self.map.scale_variance)
        observed, state = self.home.observation, self.map.smoother.state
        calibration = state.calibration, state.calibration_variances
        errors = integrity.errors
        errors.same_camera, errors.mount = observed.same_camera, observed.mount_covariance(state)
        errors.assumed_mount = self.extrinsics.assumed_covariance(*calibration, state.scale)
        errors.covariance_scale = self.drive.covariance_scale or 1.0

    def _begin_map(self, t: float) -> None:
        """Begin a map whose origin is the robot's pose at `t` [s]."""
        learnt = self.noise, self.process_noise, self.extrinsics
        at_home, counts = self.home.observation.bearings, self.counts
        self.map = Map(
            self.drive, self._settings, *learnt, counts, t, self._known, self.scale, at_home
        )
        self._contradiction = Contradiction()
        self.monitor = Monitor(self.drive.start is not None)
        self._first_fix = FirstFix(self.map.registration.survey)
        self.odometry.restart(t)
        self._at_keyframe = self._twists.at(t)
        if self._keeps:
            self.map.smoother.retain_marginalised()

    def _reset_map(self, t: float) -> Motion:
        """Reset the map at `t` [s], and return the motion since then: none."""
        self._begin_map(t)
        self.home.observation.forget_start()
        return Motion.identity()

    def _give_up_map(self) -> None:
        """Reset a map that has become singular."""
        self.counts.reject(Rejection.MAP_RESET)
        self._reset_map(self.map.smoother.stamps[-1])

    def _begin_motion(self, t: float, motion: Motion) -> None:
        """Restart odometry and monitor at a new keyframe, reached by a motion."""
        self.odometry.restart(t)
        self.monitor.add_keyframe(motion)
        self._at_keyframe = self._twists.at(t)

    def coasts(self, t: float) -> bool:
        """Return whether no bearing has been accepted recently before `t` [s]."""
        return t - self.last_accepted > (0.5 if self._may_slip(t) else 1.0) * NO_BEARINGS_S

    def _may_slip(self, t: float) -> bool:
        """Return whether wheels are expected to slip at `t` [s], since they did before."""
        return t - self.slipped_at < SLIP_MEMORY_S

    def _slip_covariance(self, t: float) -> np.ndarray:
        """Covariance (3, 3) of the motion since the last frame that fits, which may be a slip."""
        _, path, turned = self._twists.driven(t).since(self._driven_at_fit)
        return (SLIP_SHARE * np.diag([path, path, turned])) ** 2
