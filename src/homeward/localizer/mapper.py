"""The mapper: twists and sightings in, a map in the odometry frame out, with the robot in it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from homeward.angles import wrap
from homeward.drives.drive import DriveSettings
from homeward.estimator import Counts, Innovation
from homeward.localizer.odometry import Motion, NoiseModel, Odometry
from homeward.localizer.relocation import SightLines, relocate
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.triangulation import triangulate
from homeward.localizer.window import (
    BEARING,
    KEYFRAME,
    LANDMARK,
    NC,
    OFFSET,
    OFFSET_JACOBIAN,
    SIGMA,
    Window,
    bearing_residuals,
    sighting_row,
)

MOST_PER_KEYFRAME = 12
"""Sightings of one landmark that one keyframe takes; a robot that stands learns no more from it."""
STANDS_M, STANDS_RAD = 0.01, 0.01
"""A robot that moved less since its keyframe needs no new one."""
ADVANCE_S = 0.5
"""Twists are integrated for good at least this often [s]."""
BASE = 5.0
"""Landmarks start from a base so many times longer than odometry's uncertainty about it."""
MOST_STARTS = 6
"""Landmarks tried to be started at one keyframe."""
DRIFT_S = 600.0
"""The calibration drifts by its a-priori deviation times `DRIFT_SHARE` in this time [s]."""
DRIFT_SHARE = 0.2
MOST_FORGOTTEN = 2
"""Keyframes closed at once."""
HEAVY_TAIL = 3.0
"""Wheels slip and robots bump: the gate takes odometry for so much worse than its noise says."""
RECENT, LIFTED_SHARE = 10, 0.75
"""When so large a share of the last sightings does not fit, the robot was lifted and put down."""
LOST_RAD, LOST_M = 0.7, 3.0
"""A motion less certain than this does not tell where the robot is."""
LOST_AGAIN_RAD = 0.3
"""Sight lines of a lost robot hold together while their headings are better known than this."""
REFUSED, OTHERS_SHARE = 6, 0.6
"""A landmark refused so often in a row starts anew, when others fit with this share."""
PLACED = 0.3
"""Only a landmark seen under this angle can be said to have moved [rad]."""
MISFIT, FEWEST_TO_JUDGE = 4.0, 6
"""A landmark is taken out when most of at least so many sightings are so many deviations off."""
SIGMA_FLOOR = 1.0
"""The bearing noise is not believed to be less than this share of its default [1]."""
RESIDUALS = 40
"""So many residuals are needed to judge the bearing noise."""
MAD_TO_SIGMA = 1.4826


@dataclass
class Landmark:
    """What the mapper keeps of a landmark in the map."""

    name: str
    number: int
    """In the window."""
    sightings: int = 0
    entered: int = 0
    """Keyframe at which it entered the map."""
    refused: int = 0
    """Sightings in a row that did not fit."""
    lines: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Direction of the first sight line [rad], and how far others lie to either side of it."""

    @property
    def parallax(self) -> float:
        """Angle between the outermost sight lines [rad]."""
        return self.lines[2] - self.lines[1]

    def seen_along(self, directions: np.ndarray) -> None:
        """Count sightings along directions in the odometry frame, shape (m,) [rad]."""
        if not self.sightings:
            self.lines = (float(directions[0]), 0.0, 0.0)
        first, low, high = self.lines
        off = wrap(directions - first)
        self.lines = (first, min(low, float(off.min())), max(high, float(off.max())))
        self.sightings += directions.size


class Mapper:
    """Keyframes, the window over them, and the landmarks that wait to enter it.

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
        self._given_sigma = drive.sensor.bearing_sigma
        self._sigma = self._given_sigma or settings.bearing_sigma
        self._odometry = Odometry(NoiseModel(drive.odometry, settings))
        sigmas = _calibration_sigmas(drive, settings)
        self._new_window = partial(Window, sigmas, (DRIFT_SHARE * sigmas) ** 2 / DRIFT_S)
        self.window = self._new_window()
        self.marginal = self.window.solve()
        self.landmarks: dict[str, Landmark] = {}
        self._pending: dict[str, list[np.ndarray]] = {}
        self._tries: deque[str] = deque()
        self._taken: dict[str, int] = {}
        self.former: dict[str, Landmark] = {}
        """Where landmarks stood that moved during the drive."""
        self.moved_at: dict[str, float] = {}
        """When they moved [s]."""
        self.begun_anew = False
        """Whether the first map was thrown away, and the origin with it."""
        self.lost_since: float | None = None
        """Since when the robot does not know where in its map it is [s]."""
        self._lost_rows: list[tuple[str, np.ndarray]] = []
        self._recent: deque[tuple[str, bool]] = deque(maxlen=RECENT)

    def begin(self, t: float) -> None:
        """Let the first keyframe, the origin, be at `t` [s]."""
        self.window.stamps[0] = t
        self._odometry.restart(t)

    def twist(self, t: float, v: float, omega: float) -> None:
        """Take a twist that holds from `t` [s] on."""
        self._odometry.add(t, v, omega)
        if t - self._odometry.done > ADVANCE_S:
            self._odometry.advance(t, self.window.calibration)

    def motion(self, t: float) -> Motion:
        """Return the motion from the newest keyframe to `t` [s]."""
        return self._odometry.motion(t, self.window.calibration)

    def as_home_saw(self, name: str) -> Landmark | None:
        """Return a landmark where it stood when home was stored, for all the drive knows."""
        return self.former.get(name) or self.landmarks.get(name)

    def sight(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float]
    ) -> tuple[list[Innovation], bool]:
        """Take sightings; return their innovations, and whether there is a new solution."""
        motion = self._odometry.advance(t, self.window.calibration)
        if self.lost_since is None and _hopeless(motion):
            self._lose(t)
        if self.lost_since is not None:
            return [], self._look_around(t, sightings, sigmas)
        innovations = self._judge(motion, sightings, sigmas)
        if self._was_lifted(innovations):
            self._lose(t)
            return innovations, self._look_around(t, sightings, sigmas)
        rejected = {i.landmark for i in innovations if not i.accepted}
        fresh = self._wants_keyframe(t, motion)
        if fresh:
            self._add_keyframe(t, motion)
            motion = Motion.none()
        self._keep_all(motion, sightings, sigmas, rejected)
        restarted = self._restart_refused(t, innovations)
        if fresh or restarted:
            self._solve()
        return innovations, fresh or restarted

    def _keep_all(
        self,
        motion: Motion,
        sightings: Mapping[str, float],
        sigmas: Mapping[str, float],
        rejected: set[str],
    ) -> None:
        """Put what was not rejected into the window."""
        for name, bearing in sightings.items():
            if name in rejected:
                self._counts.reject("bearing does not fit the map")
            elif self._taken.get(name, 0) >= MOST_PER_KEYFRAME:
                self._counts.reject("the robot stands and saw this before")
            else:
                self._taken[name] = self._taken.get(name, 0) + 1
                self._keep(name, motion, bearing, sigmas.get(name, self._sigma))

    def _add_keyframe(self, t: float, motion: Motion) -> None:
        """Let there be a keyframe at `t` [s]."""
        self.window.add_keyframe(t, motion)
        self._odometry.restart(t)
        self._taken.clear()

    def _solve(self) -> None:
        """Correct the map, take in and out of it what is due, and close old keyframes."""
        try:
            self._start_landmarks()
            self.marginal = self.window.solve()
            if self._drop_misfits():
                self.marginal = self.window.solve()
            for _ in range(MOST_FORGOTTEN):
                if self._may_forget():
                    self._forget_oldest()
        except np.linalg.LinAlgError:
            self._begin_anew()
        self._scale_sigma()

    def _begin_anew(self) -> None:
        """Throw the map away, which no longer makes sense, and begin another here."""
        t = self.window.stamps[-1]
        self.window = self._new_window()
        self.window.stamps[0] = t
        self._odometry.restart(t)
        self.marginal = self.window.solve()
        self.landmarks, self.former, self.moved_at = {}, {}, {}
        self._pending, self._taken = {}, {}
        self._tries.clear()
        self._recent.clear()
        self.begun_anew = True
        self._counts.reject("the map was thrown away")

    def _was_lifted(self, innovations: list[Innovation]) -> bool:
        """Return whether hardly anything fits the map any more."""
        self._recent.extend((i.landmark, i.accepted) for i in innovations)
        wrong = [name for name, accepted in self._recent if not accepted]
        return (
            len(self._recent) == RECENT
            and len(wrong) >= LIFTED_SHARE * RECENT
            and len(set(wrong)) >= 2
        )

    def _lose(self, t: float) -> None:
        """Begin to look for the robot in its map, from where it is at `t` [s]."""
        self.lost_since = t
        self._odometry.restart(t)
        self._lost_rows.clear()
        self._recent.clear()

    def _look_around(
        self, t: float, sightings: Mapping[str, float], sigmas: Mapping[str, float]
    ) -> bool:
        """Gather sight lines of a lost robot; return whether they tell where it is."""
        motion = self.motion(t)
        if motion.covariance[2, 2] > LOST_AGAIN_RAD**2:
            self._lose(t)
            motion = Motion.none()
        for name, bearing in sightings.items():
            if name in self.landmarks:
                row = self._row(motion, bearing, sigmas.get(name, self._sigma))
                self._lost_rows.append((name, row))
        del self._lost_rows[:-RECENT]
        found = self._relocate()
        if found is None:
            self._counts.reject("the robot is lost in its map", len(sightings))
            return False
        self._resume(t, motion, *found)
        self._keep_all(Motion.none(), sightings, sigmas, set())
        self._solve()
        return True

    def _relocate(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return where the robot was lost, in the map, and the covariance of that."""
        known = [(self.landmarks[n].number, r) for n, r in self._lost_rows if n in self.landmarks]
        if not known:
            return None
        numbers, rows = np.array([n for n, _ in known]), np.array([r for _, r in known])
        columns = 3 + NC + 2 * numbers[:, None] + np.arange(2)
        by_calibration = rows[:, OFFSET_JACOBIAN].reshape(-1, 3, NC)
        return relocate(
            SightLines(
                cameras=rows[:, OFFSET] + by_calibration @ self.window.calibration,
                bearings=rows[:, BEARING],
                sigmas=rows[:, SIGMA],
                names=numbers,
                positions=self.window.positions[numbers],
                covariances=self.marginal.covariance[columns[:, :, None], columns[:, None, :]],
            )
        )

    def _resume(self, t: float, motion: Motion, pose: np.ndarray, covariance: np.ndarray) -> None:
        """Go on mapping from a pose in the map where the robot was when lost, and a motion since.

        The landmarks' errors are in that pose too, so its covariance is doubled.
        """
        there = Motion(pose, 2.0 * covariance, np.zeros_like(motion.jacobian)).then(motion)
        last = self.window.poses[-1]
        back = Motion(_inverse(last), np.zeros((3, 3)), np.zeros_like(motion.jacobian))
        self._add_keyframe(t, back.then(there))
        self.lost_since = None
        self._lost_rows.clear()

    def _restart_refused(self, t: float, innovations: list[Innovation]) -> bool:
        """Start landmarks anew whose sightings alone are refused again and again."""
        again = []
        for innovation in innovations:
            landmark = self.landmarks[innovation.landmark]
            landmark.refused = 0 if innovation.accepted else landmark.refused + 1
            if landmark.refused >= REFUSED:
                again.append(landmark)
        others = [ok for name, ok in self._recent if name not in {m.name for m in again}]
        if not again or not others or sum(others) < OTHERS_SHARE * len(others):
            return False
        for landmark in again:
            if landmark.parallax >= PLACED and landmark.name not in self.former:
                self.former[landmark.name] = self.landmarks.pop(landmark.name)
                self.moved_at[landmark.name] = t
            else:
                self._drop(landmark.name)
        return True

    def _row(self, motion: Motion, bearing: float, sigma: float) -> np.ndarray:
        """Return a sighting as a row of the window's table."""
        return sighting_row(
            self.window.newest, bearing, sigma, motion, self._mount, self.window.calibration
        )

    def _judge(
        self, motion: Motion, sightings: Mapping[str, float], sigmas: Mapping[str, float]
    ) -> list[Innovation]:
        """Compare the sightings of mapped landmarks with what the map predicts."""
        names = [n for n in sightings if n in self.landmarks]
        if not names:
            return []
        rows = np.array(
            [self._row(motion, sightings[n], sigmas.get(n, self._sigma)) for n in names]
        )
        numbers = np.array([self.landmarks[n].number for n in names])
        residual, jacobian = bearing_residuals(
            np.repeat(self.window.poses[-1:], len(names), axis=0),
            self.window.calibration,
            self.window.positions[numbers],
            rows,
        )
        columns = np.empty((len(names), 5 + NC), int)
        columns[:, : 3 + NC] = np.arange(3 + NC)
        columns[:, 3 + NC :] = 3 + NC + 2 * numbers[:, None] + np.arange(2)
        blocks = self.marginal.covariance[columns[:, :, None], columns[:, None, :]]
        variance = np.einsum("mi,mij,mj->m", jacobian, blocks, jacobian)
        variance += rows[:, SIGMA] ** 2
        closeness = (jacobian[:, 3 + NC :] ** 2).sum(axis=1)
        drift = _by_motion(motion, closeness)
        sigma = np.sqrt(variance + drift)
        widened = np.sqrt(variance + HEAVY_TAIL**2 * drift)
        accepted = np.abs(residual) <= self._settings.gate * widened
        return [
            Innovation(n, float(r), float(s), bool(a))
            for n, r, s, a in zip(names, residual, sigma, accepted, strict=True)
        ]

    def _wants_keyframe(self, t: float, motion: Motion) -> bool:
        """Return whether the robot is far enough from its newest keyframe."""
        if t - self.window.stamps[-1] < self._settings.keyframe_interval:
            return False
        return (
            motion.path > STANDS_M
            or motion.turned > STANDS_RAD
            or motion.covariance[0, 0] > STANDS_M**2
        )

    def _keep(self, name: str, motion: Motion, bearing: float, sigma: float) -> None:
        """Put a sighting into the window, or aside until its landmark enters."""
        self._counts.used += 1
        row = self._row(motion, bearing, math.sqrt(sigma**2 + motion.covariance[2, 2]))
        landmark = self.landmarks.get(name)
        if landmark is None:
            if name not in self._pending:
                self._pending[name] = []
                self._tries.append(name)
            self._pending[name].append(row)
        else:
            row[LANDMARK] = landmark.number
            landmark.seen_along(self._lines(row[None]))
            self.window.add_sightings(row[None])

    def _start_landmarks(self) -> None:
        """Let the landmarks enter whose sight lines agree by now."""
        for _ in range(min(MOST_STARTS, len(self._tries))):
            name = self._tries.popleft()
            rows = np.array(self._pending[name])
            found = self._triangulate(rows)
            if found is None:
                self._tries.append(name)
                continue
            position, agree = found
            number = self.window.add_landmark(position)
            rows = rows[agree]
            rows[:, LANDMARK] = number
            self.window.add_sightings(rows)
            self.landmarks[name] = Landmark(name, number, entered=self.window.newest)
            self.landmarks[name].seen_along(self._lines(rows))
            del self._pending[name]

    def _triangulate(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Return position and agreeing sightings of a landmark, if its base is long enough."""
        cameras = self._cameras(rows)
        base = float(np.hypot(*np.ptp(cameras[:, :2], axis=0)))
        since = int(rows[0, KEYFRAME]) - self.window.first
        if base < BASE * math.sqrt(sum(self.window.shift_variances[since:])):
            return None
        return triangulate(
            cameras, rows[:, BEARING], self._line_sigmas(rows), self._settings.parallax
        )

    def _drop_misfits(self) -> bool:
        """Take landmarks out on which the sightings do not agree; they may start anew."""
        rows = self.window.sightings
        if not len(rows):
            return False
        off = np.abs(self.window.residuals()) > MISFIT * rows[:, SIGMA]
        bad = []
        for name, landmark in self.landmarks.items():
            mine = rows[:, LANDMARK] == landmark.number
            if mine.sum() >= FEWEST_TO_JUDGE and off[mine].mean() > 0.5:
                bad.append(name)
        for name in bad:
            self._drop(name)
        return bool(bad)

    def _drop(self, name: str) -> None:
        """Take a landmark out of the map."""
        gone = self.landmarks.pop(name)
        self.window.drop_landmark(gone.number)
        for other in [*self.landmarks.values(), *self.former.values()]:
            other.number -= other.number > gone.number
        self._counts.reject("landmark did not agree with itself", 1)

    def _line_sigmas(self, rows: np.ndarray) -> np.ndarray:
        """Return the deviations of sight lines, the heading's since then included, shape (m,)."""
        turned = np.cumsum([0.0, *self.window.turn_variances[::-1]])[::-1]
        since = turned[rows[:, KEYFRAME].astype(int) - self.window.first]
        return np.asarray(np.sqrt(rows[:, SIGMA] ** 2 + since))

    def _lines(self, rows: np.ndarray) -> np.ndarray:
        """Return the directions of sight lines in the odometry frame, shape (m,) [rad]."""
        return np.asarray(self._cameras(rows)[:, 2] + rows[:, BEARING])

    def _cameras(self, rows: np.ndarray) -> np.ndarray:
        """Return the camera's pose at each row, shape (m, 3)."""
        pose = self.window.poses[rows[:, KEYFRAME].astype(int) - self.window.first]
        offset = rows[:, OFFSET] + rows[:, OFFSET_JACOBIAN].reshape(-1, 3, NC) @ (
            self.window.calibration
        )
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        return np.stack(
            [
                pose[:, 0] + c * offset[:, 0] - s * offset[:, 1],
                pose[:, 1] + s * offset[:, 0] + c * offset[:, 1],
                pose[:, 2] + offset[:, 2],
            ],
            axis=1,
        )

    def _may_forget(self) -> bool:
        """Return whether the oldest keyframe may be closed.

        A landmark seen from a narrow base is not where it seems, and closing a keyframe that saw it
        would keep that error for good; so keyframes stay open until their landmarks are seen from
        more sides, or have been in the map for as many keyframes as the longest window holds.
        """
        kept = len(self.window.poses)
        if kept <= self._settings.window or kept > self._settings.longest_window:
            return kept > self._settings.window
        rows = self.window.sightings
        seen = np.unique(rows[rows[:, KEYFRAME] == self.window.first, LANDMARK]).astype(int)
        since = self.window.newest - self._settings.longest_window
        young = {
            m.number
            for m in [*self.landmarks.values(), *self.former.values()]
            if m.parallax < self._settings.mature_parallax and m.entered > since
        }
        return young.isdisjoint(seen.tolist())

    def _forget_oldest(self) -> None:
        """Close the oldest keyframe; sightings set aside at it are lost."""
        gone = self.window.first
        self.window.forget_oldest()
        for name, rows in list(self._pending.items()):
            while rows and rows[0][KEYFRAME] <= gone:
                rows.pop(0)
            if not rows:
                del self._pending[name]
                self._tries.remove(name)

    def _scale_sigma(self) -> None:
        """Follow the bearing noise by the residuals, when nobody gave it."""
        if self._given_sigma is not None or len(self.window.sightings) < RESIDUALS:
            return
        now = MAD_TO_SIGMA * float(np.median(np.abs(self.window.residuals())))
        now = max(now, SIGMA_FLOOR * self._settings.bearing_sigma)
        self._sigma += 0.1 * (now - self._sigma)


def _hopeless(motion: Motion) -> bool:
    """Return whether odometry knows so little of a motion that the robot counts as lost."""
    return bool(
        motion.covariance[2, 2] > LOST_RAD**2
        or max(motion.covariance[0, 0], motion.covariance[1, 1]) > LOST_M**2
    )


def _inverse(pose: np.ndarray) -> np.ndarray:
    """Return the inverse of a pose (3,), its heading not wrapped."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array([-c * pose[0] - s * pose[1], s * pose[0] - c * pose[1], -pose[2]])


def _by_motion(motion: Motion, closeness: np.ndarray) -> np.ndarray:
    """Return what the motion's noise adds to the variance of bearings, shape (m,)."""
    shift = motion.covariance[0, 0] + motion.covariance[1, 1]
    return np.asarray(motion.covariance[2, 2] + shift * closeness)


def _calibration_sigmas(drive: DriveSettings, settings: LocalizerSettings) -> np.ndarray:
    """Return how unknown the calibration is a priori, shape (5,)."""
    given, default = drive.odometry, settings.odometry
    scale, bias = given.turn_scale_sigma, given.turn_bias_sigma
    return np.array(
        [
            default.turn_scale if scale is None else scale,
            default.turn_bias if bias is None else bias,
            default.turn_slip if given.speed_scale_sigma is None else 0.0,
            settings.lag_sigma,
            settings.camera_yaw_sigma,
        ]
    )
