"""The map: keyframes, landmarks that come and go, and corrections, quick ones or of everything."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from homeward.drives.drive import DriveSettings, KnownLandmarks
from homeward.estimator import Counts, Innovation
from homeward.localizer.inputs.bearing_noise import BearingNoise, WeighedFrame
from homeward.localizer.map.gating import (
    Gated,
    denies_motion,
    gate_bearings,
    inflate_by_odometry,
)
from homeward.localizer.map.landmarks import Landmarks
from homeward.localizer.map.learning.learner import Learner
from homeward.localizer.map.sightings import (
    GAP,
    LANDMARK,
    SIGMA,
    sighting_rows,
)
from homeward.localizer.map.smoother import ALIKE, Smoother
from homeward.localizer.map.state import Marginal, Prediction
from homeward.localizer.map.survey.registration import Registration
from homeward.localizer.map.survey.survey import Survey
from homeward.localizer.motion.extrinsics import Extrinsics
from homeward.localizer.motion.odometry import calibration_sigmas
from homeward.localizer.motion.preintegration import Motion, camera_on_robot
from homeward.localizer.motion.process_noise import ProcessNoise
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import CALIBRATION_DRIFT, FALSE_ALARM, NEGLIGIBLE, STANDSTILL
from homeward.reasons import Rejection

MOST_PER_KEYFRAME = 12
"""Sightings of one landmark that one keyframe takes; a robot that stands learns no more from it."""
SOLVED_SHARE = 8
"""Once full, the window is solved once per so large a part of it: a keyframe costs alike always."""


class Map:
    """The map in the odometry frame, which begins at the robot.

    Parameters
    ----------
    drive : DriveSettings
        Camera and odometry as the drive describes them.
    settings : LocalizerSettings
        Everything else.
    noise : BearingNoise
        Which learns from what the map leaves of bearings.
    process_noise : ProcessNoise
        Which learns from what it leaves of motions.
    extrinsics : Extrinsics
        What is believed of the camera's place on the robot.
    counts : Counts
        Where to count sightings.
    t : float
        When it begins [s].
    known : KnownLandmarks
        What is known of landmarks beforehand.
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
    ) -> None:
        self._settings, self._counts = settings, counts
        self._process_noise = process_noise
        self._mount = np.array(drive.sensor.pose)
        sigmas = calibration_sigmas(drive, settings, known.tells)
        drift = CALIBRATION_DRIFT * np.concatenate([sigmas, extrinsics.sigmas])
        self.smoother = Smoother(sigmas, drift**2, extrinsics.sigmas, noise.correlated, t)
        learnt = noise, process_noise, extrinsics
        self._learner = Learner(*learnt, self.smoother.slip_sigma)
        self.landmarks = Landmarks(self.smoother, settings.parallax)
        self.registration = Registration(Survey(known, settings), self.landmarks)
        self.begun = t
        self.solved = True
        """Whether the state comes from the whole window, not from a quick correction."""
        self._solved_at, self._solved_positions = 0, self.smoother.positions
        self.busy = False
        """Whether the newest look had long work already: a solution, or to learn from one."""
        self._unlearnt = False
        """Whether there is a solution that was not learnt from."""
        self._due = True
        """Whether the whole window is to be solved at this keyframe."""
        self._path = 0.0
        """How far it drove from the newest keyframe to the last frame [m]."""
        self._taken: dict[str, int] = {}
        """Sightings of landmarks from the newest keyframe."""
        self._last_seen: dict[str, float] = {}
        """When landmarks were last seen [s]."""
        self._between: list[np.ndarray] = []
        """Those of them that the state does not know yet."""
        self._scale_information = 0.0
        """Of the map's scale by motions, were their noise what was believed at first [1]."""

    @property
    def state(self) -> Marginal:
        """What is known of the newest keyframe's pose, the calibration and the landmarks."""
        return self.smoother.state

    @property
    def scale_variance(self) -> float:
        """Of the map's scale, by slips that nothing shows [1]."""
        uncounted = self._process_noise.common_slip_variance
        return uncounted / max(self._scale_information, uncounted)

    def camera(self, motion: Motion) -> Motion:
        """Return where the camera is after the robot's motion."""
        return motion.compose(camera_on_robot(self._mount, self.state.calibration))

    def as_home_saw(self, names: list[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return where landmarks stand where home saw them, for all one knows.

        Returns
        -------
        index : ndarray, shape (q,), int
            In the state.
        walks, astray : ndarray, shape (q,), (q, 2, 2)
            How probable they are to walk, and how far they are off then: second moments [m^2].
        """
        known = self.landmarks
        there = [known.former.get(n) or known.mapped[n] for n in names]
        astray = np.array([m.astray for m in there]).reshape(-1, 2, 2)
        return known.index(there), known.walking(there), astray

    def learn(self) -> None:
        """Learn from what the last solution left, unless that was done.

        A solution of the whole window takes long enough: then it is done at the look after it.

        Raises
        ------
        numpy.linalg.LinAlgError
            When nothing can be made of the map any more.
        """
        self.busy = self._unlearnt
        if self._unlearnt:
            self._unlearnt = False
            self._learner.learn(self.smoother, self.landmarks)
            if self._learner.opens_mount(self.smoother):
                self._solve()

    def wants_keyframe(self, t: float, motion: Motion) -> bool:
        """Return whether the robot is far enough from its newest keyframe, or came to rest."""
        rests, self._path = 0.0 < motion.path == self._path, motion.path
        due = t - self.smoother.stamps[-1] >= self._settings.keyframe_interval
        scale = self.state.scale if self.landmarks.mapped else 0.0
        shift = max(motion.path, math.sqrt(motion.covariance[0, 0]))
        return due and (rests or shift > STANDSTILL * scale or motion.turned > STANDSTILL)

    def add_keyframe(self, t: float, motion: Motion) -> None:
        """Let there be a keyframe at `t` [s], and what is known move on to it."""
        noise = motion.covariance[0, 0] + motion.covariance[1, 1]
        if noise > 0.0:
            self._scale_information += motion.path**2 / noise * self._process_noise.scales[1, 0]
        self._move_on(t, motion, self._process_noise.inlier_ratios)

    def _move_on(self, t: float, motion: Motion, core: np.ndarray) -> None:
        """Add a keyframe; see `Smoother.add_keyframe`."""
        smoother = self.smoother
        kept, since = len(smoother.stamps) + 1, smoother.newest + 1 - self._solved_at
        full = kept >= self._settings.window
        self._due = not full or since * SOLVED_SHARE >= kept or not smoother.settled
        if self._between and not self._due:
            seen = smoother.predict(np.concatenate(self._between))
            self._due = not self._take(self.state.update(seen))
        smoother.add_keyframe(t, motion, core)
        self._taken.clear()
        self._between = []

    def gate(self, frame: WeighedFrame, motion: Motion, new_keyframe: bool) -> Gated:
        """Gate the bearings of a frame: innovations, and which of them fit.

        Parameters
        ----------
        frame : WeighedFrame
            The bearings.
        motion : Motion
            The last one before them.
        new_keyframe : bool
            Whether the newest keyframe is after it, not before.
        """
        since = Motion.identity() if new_keyframe else motion
        rows, eye, by_head = self._rows(frame, since)
        (known,) = (rows[:, LANDMARK] >= 0).nonzero()
        bearings, sigmas = frame.bearings[known], frame.sigmas[known]
        index = self.smoother.index(rows[known, LANDMARK])
        seen = self.state.predict_bearings(bearings, sigmas, (eye, by_head), index)
        heading = self.state.mean[2] - (motion.delta[2] if new_keyframe else 0.0)
        accepted, deviations = gate_bearings(
            seen, motion, new_keyframe, heading, self._settings.gate
        )
        accepted &= self.smoother.stands[index] > FALSE_ALARM  # who walks fits nowhere for long
        names = [frame.names[i] for i in known.tolist()]
        columns = (column.tolist() for column in (seen.residual, deviations, accepted))
        innovations = [Innovation(*each) for each in zip(names, *columns, strict=True)]
        lines = eye[2] + frame.bearings
        denies = not new_keyframe and denies_motion(seen.only(accepted), motion, heading)
        return Gated(frame, since, new_keyframe, rows, lines, seen, innovations, denies)

    def take_back(self) -> None:
        """Take back the frame that was gated last, of which nothing was made yet."""
        self.smoother.frames.drop_newest()

    def inflate(self, gated: Gated) -> bool:
        """Inflate the noise of bearings between keyframes by that of the way; tell if it holds.

        Where it does not, the way is so uncertain that the bearings are of no use.
        """
        if gated.new_keyframe:
            return True
        arguments = gated.motion, len(self._between) + 1, gated.prediction, self.state
        widened = inflate_by_odometry(gated.rows, *arguments)
        if widened is None:
            self._counts.reject(Rejection.VAGUE_ODOMETRY, len(gated.frame.names))
            return False
        gated.rows[:, SIGMA] = widened
        return True

    def update(self, gated: Gated, refused: list[str]) -> bool:
        """Update the map by what fits; return whether there is a new solution.

        Parameters
        ----------
        gated : Gated
            Of a frame.
        refused : list of str
            Landmarks that are not where the map says; they start anew.

        Raises
        ------
        numpy.linalg.LinAlgError
            When nothing can be made of the map any more.
        """
        if self.solved and gated.new_keyframe:  # that of the solution itself takes long enough
            self._marginalise_old()
        rows, prediction = gated.rows, gated.prediction
        kept = self._keep(gated.frame, rows, gated.directions, gated.fits)
        fixed = bool(self.landmarks.expected and not self.landmarks.mapped)
        changed = self.landmarks.reinitialise(refused) or fixed
        rests = gated.motion.path == 0.0 and bool(kept.any())  # and looks again
        due = gated.new_keyframe or changed or rests
        if due:
            self._correct(None if changed else self._effective(prediction, rows, kept))
        if fixed and not self.landmarks.mapped:
            self.landmarks.expected = {}  # the next look may tell
        return due

    def reset_pose(self, frame: WeighedFrame, motion: Motion) -> None:
        """Let the robot be where a motion leads from the newest keyframe, and saw a frame there.

        Raises
        ------
        numpy.linalg.LinAlgError
            When nothing can be made of the map any more.
        """
        self._move_on(frame.t, motion, ALIKE)
        rows, eye, _ = self._rows(frame, Motion.identity())
        self._keep(frame, rows, eye[2] + frame.bearings, {})
        self._correct(None)

    def revert_to(self, keyframe: int) -> None:
        """Let the map be what it was at a keyframe: what entered or moved since did not.

        Raises
        ------
        numpy.linalg.LinAlgError
            When nothing can be made of the map any more.
        """
        self.landmarks.revert_to(keyframe)
        self._between = []
        self._correct(None)

    def adopt(self, whole: Smoother) -> None:
        """Take what the whole of a drive says, of the same landmarks."""
        self.smoother = self.landmarks.smoother = whole
        self._unlearnt = False

    def _rows(
        self, frame: WeighedFrame, motion: Motion
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return a frame after a motion since the newest keyframe as rows, and its camera."""
        newest, camera = self.smoother.newest, self.camera(motion)
        rows = sighting_rows(newest, self.smoother.frames.add(newest, camera), frame)
        rows[:, LANDMARK] = self.landmarks.ids(frame.names)
        return rows, *self.state.after(camera)

    def _keep(
        self,
        frame: WeighedFrame,
        rows: np.ndarray,
        directions: np.ndarray,
        fits: Mapping[str, bool],
    ) -> np.ndarray:
        """Put what was not rejected of a frame into the window; return which (m,), bool."""
        t, names, stands = frame.t, frame.names, 0
        kept = np.zeros(len(names), bool)
        rows[:, GAP] = [t - self._last_seen.get(name, -math.inf) for name in names]
        for i, name in enumerate(names):
            taken = self._taken[name] = self._taken.get(name, 0) + 1
            if taken > MOST_PER_KEYFRAME:
                stands += 1
                continue
            self._last_seen[name] = t
            if not fits.get(name, True):
                self._counts.reject(Rejection.OUTSIDE_GATE)
                self.landmarks.set_aside(t, name, rows[i])
            else:
                kept[i] = True
        self._counts.reject(Rejection.STANDING, stands)
        self._counts.used += int(np.count_nonzero(kept))
        if stands == len(names):
            self.smoother.frames.drop_newest()
        mine = rows[kept]
        fitting = [n for n, k in zip(names, kept.tolist(), strict=True) if k]
        self.landmarks.keep(t, fitting, mine, directions[kept])
        self._between.append(mine[mine[:, LANDMARK] >= 0])
        return kept

    def _effective(self, seen: Prediction, rows: np.ndarray, kept: np.ndarray) -> Prediction:
        """Return what was kept of a prediction, with the deviations by which it counts."""
        mapped = rows[:, LANDMARK] >= 0
        rows = rows[mapped & kept]
        more = self.smoother.effective_sigmas(rows) ** 2 - rows[:, SIGMA] ** 2
        return seen.only(kept[mapped]).widened(more)

    def _correct(self, seen: Prediction | None) -> None:
        """Correct pose and map: by the newest sightings alone, or the whole window when due."""
        started = self.landmarks.initialise()
        if started:
            self.registration.hold_expected()
        quick = not (started or self._due) and seen is not None
        if quick and seen is not None and self._take(self.state.update(seen)):
            self.solved = False
        else:
            self._solve()
        self._between = []

    def _take(self, updated: Marginal) -> bool:
        """Believe a quick correction if it is near enough to linear; return whether it is."""
        if not (np.isfinite(updated.mean).all() and (updated.covariance.diagonal() > 0).all()):
            return False
        turned = abs(updated.mean[2] - self.state.mean[2])
        moved = updated.positions - self._solved_positions
        if turned > NEGLIGIBLE or (np.hypot(*moved.T) > NEGLIGIBLE * updated.reach).any():
            return False
        self.smoother.state = updated
        return True

    def _solve(self) -> None:
        """Correct the whole window, take out what does not fit, and learn from what is left."""
        self.busy, smoother = True, self.smoother
        if self.landmarks.mapped:
            self._learner.fit_robot_to_scene(smoother)
        smoother.solve()
        if smoother.settled:
            self.registration.judge()
        misfits = self.landmarks.drop_misfits(smoother.residuals()) if smoother.settled else 0
        if misfits:
            self._counts.reject(Rejection.INCONSISTENT_LANDMARK, misfits)
            smoother.solve()
        self.solved = self._unlearnt = True
        self._solved_at, self._solved_positions = smoother.newest, smoother.positions
        if len(smoother.stamps) < self._settings.window:  # short yet: this takes no time
            self.learn()

    def _marginalise_old(self) -> None:
        """Close the oldest keyframes that are not needed any more."""
        settings, smoother = self._settings, self.smoother
        kept = len(smoother.stamps)
        spare = kept - settings.window
        if spare <= 0:
            return
        since = smoother.newest - settings.longest_window
        needed = self.landmarks.first_needed(settings.mature_parallax, since)
        count = max(min(spare, needed - smoother.first), kept - settings.longest_window)
        if count > 0:
            smoother.marginalise(count)
            self.landmarks.drop_rows_before(smoother.first)
