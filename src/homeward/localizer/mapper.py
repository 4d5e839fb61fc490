"""The mapper: twists and sightings in, a map in the odometry frame out, with the robot in it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from homeward.drives.drive import DriveSettings
from homeward.drives.odometry_noise import noise_rates
from homeward.estimator import Counts, Innovation
from homeward.localizer.inputs.bearing_noise import BearingNoise
from homeward.localizer.map.gating import gate_bearings
from homeward.localizer.map.inflation import inflate_by_odometry
from homeward.localizer.map.landmarks import Landmark, Landmarks
from homeward.localizer.map.sightings import LANDMARK, OWN, SIGMA, WeighedFrame, sighting_rows
from homeward.localizer.map.smoother import NEAR_M, Window
from homeward.localizer.map.state import Marginal, Prediction
from homeward.localizer.motion.extrinsics import Extrinsics
from homeward.localizer.motion.odometry import Odometry, calibration_sigmas
from homeward.localizer.motion.preintegration import Motion
from homeward.localizer.reasons import Rejection
from homeward.localizer.recovery.common_motion import carried_since
from homeward.localizer.recovery.monitor import Health, Monitor
from homeward.localizer.recovery.search import pose_reset
from homeward.localizer.settings import LocalizerSettings

MOST_PER_KEYFRAME = 12
"""Sightings of one landmark that one keyframe takes; a robot that stands learns no more from it."""
STANDS_M, STANDS_RAD = 0.01, 0.01
"""A robot that moved less since its keyframe needs no new one."""
ADVANCE_S = 0.5
"""Twists are integrated at least this often [s]."""
SOLVED_SHARE = 8
"""Once full, the window is solved once per so large a part of it: a keyframe costs alike always."""
LINEAR_SHARE, LINEAR_RAD = 0.03, 0.03
"""... and when a landmark moved by more of its distance [1], or the robot turned by more [rad]."""
DRIFT_S, DRIFT_SHARE = 600.0, 0.2
"""The calibration drifts by this share of its a-priori deviation in this time [s]."""


class Gated(NamedTuple):
    """Gated frame: which of its bearings fit the map."""

    frame: WeighedFrame
    """Of m landmarks."""
    motion: Motion
    """Since the newest keyframe."""
    new_keyframe: bool
    """Whether that is at this frame."""
    rows: np.ndarray
    """(m, COLUMNS): of the table of sightings."""
    innovations: list[Innovation]
    """Of the landmarks that are mapped ..."""
    prediction: Prediction
    """... and what the map says of them."""


class Mapper:
    """Keyframes, the window over them, and the landmarks in it.

    Parameters
    ----------
    drive : DriveSettings
        Camera and odometry as the drive describes them.
    settings : LocalizerSettings
        Everything else.
    counts : Counts
        Where to count sightings.
    """

    def __init__(self, drive: DriveSettings, settings: LocalizerSettings, counts: Counts) -> None:
        self._settings, self._counts = settings, counts
        self._mount = np.array(drive.sensor.pose)
        self.noise = BearingNoise(drive.sensor.bearing_sigma, settings.bearing_sigma)
        self._odometry = Odometry(noise_rates(drive.odometry, settings.odometry))
        self._start_told = drive.start is not None
        self.extrinsics, sigmas = Extrinsics(drive, settings), calibration_sigmas(drive, settings)
        drift = DRIFT_SHARE * np.concatenate([sigmas, self.extrinsics.sigmas])
        self._new_window = partial(Window, sigmas, drift**2 / DRIFT_S)
        self._keeps = False
        self._begin_map(0.0)
        self.map_was_reset = False
        """Whether the first map was thrown away, and the origin with it."""

    def _begin_map(self, t: float) -> None:
        """Begin a map at the robot, whose pose is the origin, at `t` [s]."""
        self.window: Window = self._new_window(self.extrinsics.sigmas)
        if self._keeps:
            self.window.keep_closed()
        self.monitor = Monitor(self._start_told)
        self.landmarks = Landmarks(self._settings.parallax)
        self._taken: dict[str, int] = {}
        self.begin(t)
        self.marginal: Marginal = self.window.solve()
        self.solved = True
        """Whether `marginal` comes from the whole window, not from a quick correction."""
        self._solved_at, self._solved_positions = self.window.newest, self.window.positions
        self._due = True
        """Whether the whole window is to be solved at this keyframe."""
        self._between: list[np.ndarray] = []
        """Sightings from the newest keyframe that `marginal` does not know yet."""

    def _reset_map(self, t: float) -> Motion:
        """Throw the map away, begin another at `t` [s], and return the motion since: none."""
        self._begin_map(t)
        self.map_was_reset = True
        return Motion.identity()

    def begin(self, t: float) -> None:
        """Let the first keyframe, the origin, be at `t` [s]."""
        self.begun = t
        self.window.stamps[0] = t
        self._odometry.restart(t)

    def keep_closed(self) -> None:
        """Keep closed keyframes too, for `Window.whole`; memory then grows with the drive."""
        self._keeps = True
        self.window.keep_closed()

    def add_twist(self, t: float, v: float, omega: float) -> None:
        """Take a twist that holds from `t` [s] on."""
        if not self.has_odometry and not self._start_told:
            self.begin(t)  # what may have been driven before is of no interest
        self._odometry.add(t, v, omega)
        self.noise.add_turn_rate(t, omega)
        if t - self._odometry.done > ADVANCE_S:
            self._odometry.run_ahead(t, self.window.calibration)

    def accepts(self, t: float) -> bool:
        """Return whether a sample of `t` [s] is not too late for the map."""
        return not self.has_odometry or self._odometry.accepts(t)

    @property
    def last_odometry_t(self) -> float:
        """Stamp of the newest odometry [s]; minus infinity where there was none."""
        return self._odometry.newest

    @property
    def has_odometry(self) -> bool:
        """Whether odometry has come yet; nothing can be mapped before."""
        return self._odometry.has_twists

    def motion(self, t: float) -> Motion:
        """Return the motion from the newest keyframe to `t` [s]."""
        return self._odometry.motion(t, self.window.calibration)

    def as_home_saw(self, name: str) -> Landmark | None:
        """Return a landmark where it stood when home was stored, for all the drive knows."""
        return self.landmarks.former.get(name) or self.landmarks.mapped.get(name)

    def add_bearings(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float]
    ) -> tuple[list[Innovation], bool]:
        """Take sightings; return their innovations, and whether there is a new solution."""
        if not self.has_odometry:
            self._reject(Rejection.NO_ODOMETRY, len(sightings))
            return [], False
        frame = self._weigh(t, sightings, sigmas)
        motion = self._odometry.advance(t, self.window.calibration)
        before = self.monitor.assess_odometry(motion, self.marginal, self.landmarks)
        match before:
            case Health.NO_MAP:
                motion = self._reset_map(t)
            case Health.LOST:
                return [], self._relocalise(frame, motion)
            case Health.ODOMETRY_LOST:
                return [], self._begin_search(frame, before)
        gated = self._gate(frame, motion)
        match self.monitor.assess_innovations(
            gated.innovations, frame, gated.motion, self.marginal
        ):
            case Health.OK:
                solved = self._update(gated)
            case Health.SLIPPED:
                solved = self._relocalise(frame, gated.motion) or self._update(gated)
            case lost:
                solved = self._begin_search(frame, lost)
        return gated.innovations, solved or before is Health.NO_MAP

    def _weigh(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float]
    ) -> WeighedFrame:
        """Give each bearing of `t` [s] its noise."""
        self.noise.add_bearings(t, sightings, sigmas)
        names = list(sightings)
        bearings = np.array([sightings[n] for n in names])
        return WeighedFrame(t, names, bearings, self.noise.sigmas(names, sigmas))

    def _gate(self, frame: WeighedFrame, motion: Motion) -> Gated:
        """Gate a frame, seen after a motion, at a new keyframe where one is due."""
        new_keyframe = self._wants_keyframe(frame.t, motion)
        if new_keyframe:
            self._add_keyframe(frame.t, motion)
        since = Motion.identity() if new_keyframe else motion
        rows = self._rows(since, frame)
        arguments = self.marginal, motion, new_keyframe, frame.names, rows, self._settings.gate
        return Gated(frame, since, new_keyframe, rows, *gate_bearings(*arguments))

    def _update(self, gated: Gated) -> bool:
        """Let the map learn what it did not reject; return whether there is a new solution."""
        frame, since, new_keyframe, rows, innovations, prediction = gated
        if not new_keyframe:
            widened = inflate_by_odometry(
                rows, since, len(self._between) + 1, prediction, self.marginal
            )
            if widened is None:
                self._reject(Rejection.VAGUE_ODOMETRY, len(frame.names))
                return False
            rows[:, SIGMA] = widened
        fits = {i.landmark: i.accepted for i in innovations}
        at_fault = self.monitor.at_fault(self.landmarks.refused(fits))
        kept = self._keep(frame, rows, fits)
        changed = self.landmarks.reinitialise(self.window, at_fault)
        if new_keyframe or changed:
            self._correct(None if changed else prediction.only(kept[rows[:, LANDMARK] >= 0]))
        if changed and self._was_carried():
            return self._begin_search(frame, Health.CARRIED)
        return new_keyframe or changed

    def _wants_keyframe(self, t: float, motion: Motion) -> bool:
        """Return whether the robot is far enough from its newest keyframe."""
        due = t - self.window.stamps[-1] >= self._settings.keyframe_interval
        moved = motion.path > STANDS_M or motion.turned > STANDS_RAD
        return due and (moved or bool(motion.covariance[0, 0] > STANDS_M**2))

    def _add_keyframe(self, t: float, motion: Motion) -> None:
        """Let there be a keyframe at `t` [s], and what is known move on to it."""
        linearised = self.window.calibration
        self.window.add_keyframe(t, motion)
        kept, since = len(self.window.poses), self.window.newest - self._solved_at
        full = kept >= self._settings.window
        self._due = not full or since * SOLVED_SHARE >= kept or not self.window.settled
        if self._between and not self._due:
            seen = self.marginal.predict_bearings(np.concatenate(self._between))
            self._due = not self._take(self.marginal.update(seen))
        self.marginal = self.marginal.propagate(motion, linearised)
        self.window.adopt(self.marginal)
        self.monitor.add_keyframe(motion)
        self._odometry.restart(t)
        self._taken.clear()
        self._between = []

    def _rows(self, motion: Motion, frame: WeighedFrame) -> np.ndarray:
        """Return sightings as rows of the window's table, seen after a motion since its newest."""
        rows = sighting_rows(
            self.window.newest, frame, motion, self._mount, self.window.calibration
        )
        rows[:, LANDMARK] = self.landmarks.number(frame.names)
        return rows

    def _keep(self, frame: WeighedFrame, rows: np.ndarray, fits: Mapping[str, bool]) -> np.ndarray:
        """Put what was not rejected of a frame into the window; return which (m,), bool."""
        t, names = frame.t, frame.names
        kept = np.zeros(len(names), bool)
        for i, name in enumerate(names):
            taken = self._taken[name] = self._taken.get(name, 0) + 1
            if taken > MOST_PER_KEYFRAME:
                self._reject(Rejection.STANDING)
            elif not fits.get(name, True):
                self._reject(Rejection.OUTSIDE_GATE)
                self.landmarks.set_aside(t, name, rows[i])
            else:
                kept[i] = True
        self._counts.used += int(kept.sum())
        mine = rows[kept]
        fitting = [n for n, k in zip(names, kept, strict=True) if k]
        self.landmarks.keep(self.window, t, fitting, mine)
        self._between.append(mine[mine[:, LANDMARK] >= 0])
        return kept

    def _correct(self, seen: Prediction | None) -> None:
        """Correct pose and map: by the newest sightings alone, or the whole window when due."""
        try:
            started = self.landmarks.initialise(self.window, self.marginal.covariance[:3, :3])
            due = started or self._due or seen is None
            if due or seen is None or not self._take(self.marginal.update(seen)):
                self._solve()
            else:
                self.window.adopt(self.marginal)
                self.solved = False
        except np.linalg.LinAlgError:
            self._reject(Rejection.MAP_RESET)
            self._reset_map(self.window.stamps[-1])
        self._between = []

    def _take(self, updated: Marginal) -> bool:
        """Believe a quick correction if it is near enough to linear; return whether it is."""
        if not (np.isfinite(updated.mean).all() and (updated.covariance.diagonal() > 0).all()):
            return False
        turned = abs(updated.mean[2] - self.marginal.mean[2])
        moved = updated.positions - self._solved_positions
        far = updated.distances + NEAR_M
        if turned > LINEAR_RAD or (np.hypot(*moved.T) > LINEAR_SHARE * far).any():
            return False
        self.marginal = updated
        return True

    def _solve(self) -> None:
        """Correct the whole window, take out what does not fit, and close old keyframes."""
        self.marginal = self.window.solve()
        misfits = self.landmarks.drop_misfits(self.window) if self.window.settled else 0
        if misfits:
            self._reject(Rejection.INCONSISTENT_LANDMARK, misfits)
            self.marginal = self.window.solve()
        since = self.window.newest - self._solved_at
        self.solved = True
        self._solved_at, self._solved_positions = self.window.newest, self.window.positions
        self._marginalise_old()
        own, whole = self.window.sightings[:, OWN], self.window.sightings[:, SIGMA]
        wider = self.noise.update(self.window.residuals(), own, whole, since)
        if wider != 1.0:
            self.window.scale_noise(wider)
            self.landmarks.scale_noise(wider)
        sound, now = self.window.settled and self.noise.settled, self.marginal
        if sound and self.extrinsics.denies(now.calibration, now.calibration_variances):
            self.window.mount_sigmas = self.extrinsics.sigmas
            self._solve()

    def _marginalise_old(self) -> None:
        """Close the oldest keyframes that are not needed any more."""
        settings, window = self._settings, self.window
        spare = len(window.poses) - settings.window
        if spare <= 0:
            return
        since = window.newest - settings.longest_window
        needed = self.landmarks.first_needed(window, settings.mature_parallax, since)
        over = len(window.poses) - settings.longest_window
        count = max(min(spare, needed - window.first), over)
        if count > 0:
            window.marginalise(count)
            self.landmarks.drop_rows_before(window.first)

    def _was_carried(self) -> bool:
        """Return whether landmarks moved together; then the map is again what it was before."""
        when = carried_since(self.landmarks, self.marginal)
        if when is None:
            return False
        self.landmarks.revert_to(self.window, when)
        self._between = []
        self._correct(None)
        return True

    def _reject(self, why: Rejection, number: int = 1) -> None:
        """Count sightings that were not used."""
        self._counts.reject(why.words, number)

    def _begin_search(self, frame: WeighedFrame, why: Health) -> bool:
        """Look for the robot in its map from now on; return whether it is found at once."""
        self._odometry.restart(frame.t)
        self.monitor.begin_search(frame.t, why)
        return self._relocalise(frame, Motion.identity())

    def _relocalise(self, frame: WeighedFrame, motion: Motion) -> bool:
        """Look for the robot in its map, and move it where it is found; return whether it is."""
        search = self.monitor.search
        way = search.motion_since(motion)
        search.add_sightings(frame.names, self._rows(way, frame))
        found = search.find(self.landmarks, self.marginal, self.window.calibration)
        if found is None:
            if self.monitor.is_lost:
                self._reject(Rejection.LOST, len(frame.names))
            return False
        self._add_keyframe(frame.t, pose_reset(self.window.poses[-1], *found).compose(way))
        self.monitor.end_search(frame.t)
        self._keep(frame, self._rows(Motion.identity(), frame), {})
        self._correct(None)
        return True
