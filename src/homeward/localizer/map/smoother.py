"""Fixed-lag smoother: the last keyframes, the calibration and the landmarks, in the odometry frame.

The state is one Gaussian on the newest pose, the calibration and the landmarks. The poses of the
last keyframes stay open to correction beside it; when some leave, what they say is kept as a
Gaussian on the pose after them, the calibration and the landmarks (a Schur complement). Between two
solutions the state is moved on and corrected by itself, as in a Kalman filter.

Home is not in here: a home bearing may turn out to be wrong, and nothing that may have to be taken
back is marginalised.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from homeward.angles import wrap
from homeward.localizer.geometry import sight
from homeward.localizer.inputs.correlated_errors import CorrelatedErrors
from homeward.localizer.map.elimination import NormalEquations, Prior, eliminate, marginals
from homeward.localizer.map.factors import (
    STEP,
    OdometryErrors,
    WeighedSightings,
    add_odometry,
    add_sightings,
    odometry_errors,
    scale_steps,
    step_row,
    weigh_sightings,
)
from homeward.localizer.map.sightings import (
    BEARING,
    COLUMNS,
    FRAME,
    KEYFRAME,
    LANDMARK,
    SIGMA,
    Frames,
    bearing_residuals,
    effective_sigmas,
    scale_noise,
)
from homeward.localizer.map.state import HEAD, Marginal, Prediction
from homeward.localizer.map.survey.factors import SurveyFactors
from homeward.localizer.map.triangulation import FAR
from homeward.localizer.motion.preintegration import (
    CAMERA_X,
    MOUNT,
    NC,
    ODOMETRY_CALIBRATION,
    TURN_SLIP,
    Motion,
)
from homeward.localizer.tunables import LINEAR_RANGE

STEPS = 5
"""Gauss-Newton steps at most."""
ALIKE = np.ones(2)
"""Variances of most motions over those of all where no tail is known of, of shift and turn [1]."""
SURE = 1e-6
"""Nothing of the odometry's calibration is known better than this."""
NO_GAIN = 1e-4
"""So far below zero a slip in bends is as good as none [m]."""
SETTLED = 2e-2
"""Smaller steps [distance, rad] end it; the rest goes as its square."""


class Closed(NamedTuple):
    """Closed keyframes, for the whole of a drive."""

    poses: np.ndarray
    stamps: list[float]
    sightings: np.ndarray
    frames: Frames
    steps: np.ndarray


class Smoother:
    """The map: keyframes, calibration and landmarks, and what ties them together.

    Parameters
    ----------
    odometry_sigmas : ndarray, shape (5,)
        Of the odometry's calibration a priori, around zero.
    drift : ndarray, shape (8,)
        Variances by which the calibration drifts, per second.
    mount_sigmas : ndarray, shape (3,)
        Of the camera's on the robot, around zero.
    lasting : CorrelatedErrors
        What lasts in the errors of bearings, as believed now.
    t : float
        Of the first keyframe, the origin [s].
    """

    def __init__(
        self,
        odometry_sigmas: np.ndarray,
        drift: np.ndarray,
        mount_sigmas: np.ndarray,
        correlated: CorrelatedErrors,
        t: float,
    ) -> None:
        self.first = 0
        """Number of the oldest keyframe that is still open."""
        self.stamps = [t]
        """Times of the open keyframes [s]."""
        self.ids = np.zeros(0, int)
        """(n,): of the landmarks in the state, ascending; none is given twice."""
        self.stands = np.zeros(0)
        """(n,): probability of each to stand, by which what is seen of it counts [1]."""
        self.sightings = np.zeros((0, COLUMNS))
        """Those of landmarks in the state from open keyframes."""
        self.frames = Frames()
        self.turn_variances: list[float] = []
        """Of the motion into each open keyframe but the oldest [rad^2]."""
        self.shift_variances: list[float] = []
        """The same of its length [m^2]."""
        self.settled = True
        """Whether the last `solve` came to rest."""
        self.mount_sigmas = mount_sigmas
        """What is believed beforehand may change; so it is never marginalised ..."""
        self.slip_sigma = max(float(odometry_sigmas[TURN_SLIP]), SURE)
        """... neither of the mount nor of the slip in bends [m] ..."""
        self.known = SurveyFactors.none()
        """... and neither is what is known of landmarks."""
        self._older = np.zeros((0, 3))
        """(w - 1, 3), poses of the open keyframes but the newest."""
        self._steps = np.zeros((0, STEP))
        """(w - 1, STEP): the motions from keyframe to keyframe."""
        self._next_id = 0
        self._closed: list[Closed] | None = None
        self._drift, self._correlated = drift, correlated
        of_odometry = 1.0 / np.maximum(odometry_sigmas, SURE) ** 2
        of_odometry[TURN_SLIP] = 0.0
        information = np.concatenate([np.full(3, 1e10), of_odometry, np.zeros(len(mount_sigmas))])
        self._first_information = np.diag(information)
        self._prior = Prior(self._first_information)
        self.state = Marginal(np.zeros(HEAD), np.zeros((HEAD, HEAD)))
        """What is known of the newest pose, the calibration and the landmarks."""
        self.solve()

    def keep_closed(self) -> None:
        """Keep closed keyframes too, for `whole`; memory then grows with the drive."""
        self._closed = []

    def whole(self) -> Smoother:
        """Return one in which every keyframe since `keep_closed` is open, not yet solved."""
        unused = np.ones(len(ODOMETRY_CALIBRATION))
        whole = Smoother(unused, self._drift, self.mount_sigmas, self._correlated, 0.0)
        closed = self._closed or []
        whole.slip_sigma = self.slip_sigma
        whole.first = self.first - sum(len(part.poses) for part in closed)
        whole._older = np.concatenate([*(part.poses for part in closed), self._older])
        whole.stamps = [t for part in closed for t in part.stamps] + self.stamps
        rows = np.concatenate([*(part.sightings for part in closed), self.sightings])
        whole.sightings = rows[np.isin(rows[:, LANDMARK], self.ids)]
        whole.frames = Frames.joined([*(part.frames for part in closed), self.frames])
        whole._steps = np.concatenate([*(part.steps for part in closed), self._steps])
        whole.ids, whole.state, whole.known = self.ids, self.state, self.known
        whole.stands = self.stands
        information = np.eye(self.state.mean.size) * (FAR * self.state.scale) ** -2
        information[:HEAD, :HEAD] = self._first_information
        whole._prior = Prior(information)
        return whole

    @property
    def poses(self) -> np.ndarray:
        """(w, 3), of the open keyframes in the odometry frame."""
        return np.concatenate([self._older, self.state.mean[None, :3]])

    @property
    def calibration(self) -> np.ndarray:
        """(8,), of odometry and camera."""
        return self.state.calibration

    @property
    def positions(self) -> np.ndarray:
        """(n, 2), of the landmarks in the odometry frame [m]."""
        return self.state.positions

    @property
    def newest(self) -> int:
        """Number of the newest keyframe."""
        return self.first + len(self._older)

    def index(self, ids: np.ndarray) -> np.ndarray:
        """Return which landmarks of the state have these ids, shape (m,)."""
        return np.asarray(self.ids.searchsorted(ids))

    def cameras(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the camera's poses at rows of the table, (m, 3), and Jacobians (m, 3, 11)."""
        frame = rows[:, FRAME].astype(int)
        begin = int(frame.min(initial=self.frames.next))
        some = self.frames.since(begin)
        eyes, by_head = some.eyes(self.poses[some.keyframes - self.first], self.calibration)
        return eyes[frame - begin], by_head[frame - begin]

    def add_keyframe(self, t: float, motion: Motion, core: np.ndarray = ALIKE) -> None:
        """Add a keyframe at `t` [s], reached from the last one by `motion`; the state moves on.

        Of most motions the variances of shift and turn are but so many times, `core` (2,), as large
        as its own; how far this one is off all the same its weight says.
        """
        self._older = self.poses
        self.stamps.append(t)
        self.turn_variances.append(float(motion.covariance[2, 2]))
        self.shift_variances.append(float(motion.covariance[0, 0] + motion.covariance[1, 1]))
        step = step_row(motion)
        scale_steps(step, core)
        self._steps = np.concatenate([self._steps, step])
        self.state = self.state.propagate(motion)

    def add_landmark(self, position: np.ndarray) -> int:
        """Add a landmark at `position` [m], shape (2,), so far without sightings; return its id."""
        unknown = FAR * float(np.hypot(*(self.poses[:, :2] - position).T).max())
        self._prior.add_landmark(position, unknown)
        self.state = self.state.with_landmark(position, unknown)
        self.ids = np.append(self.ids, self._next_id)
        self.stands = np.append(self.stands, 1.0)
        self._next_id += 1
        return self._next_id - 1

    def add_sightings(self, rows: np.ndarray) -> None:
        """Add rows of the table of sightings, shape (m, COLUMNS), of open keyframes."""
        self.sightings = np.concatenate([self.sightings, rows])

    def scale_noise(self, factor: float) -> None:
        """Let the bearings' own deviations be so many times as large, of all that are open."""
        for rows in (self.sightings, *(part.sightings for part in self._closed or [])):
            scale_noise(rows, factor)

    def scale_odometry(self, factors: np.ndarray) -> None:
        """Let variances of shift and turn be so many times as large, (2, 2): of most, of all."""
        for steps in (self._steps, *(part.steps for part in self._closed or [])):
            scale_steps(steps, factors[0])
        self.shift_variances = [float(factors[1, 0] * v) for v in self.shift_variances]
        self.turn_variances = [float(factors[1, 1] * v) for v in self.turn_variances]

    def odometry_errors(self) -> OdometryErrors:
        """Return what is left of the motions between open keyframes, linearised."""
        return odometry_errors(self.poses, self.calibration, self._steps)

    def drop_landmark(self, number: int) -> None:
        """Take the landmark of an id out: what is known of the others stays."""
        index = int(self.index(np.array(number)))
        self._prior.drop_landmark(index, self._head_and_map())
        self.state = self.state.without_landmark(index)
        self.ids, self.stands = np.delete(self.ids, index), np.delete(self.stands, index)
        self.known = self.known.among(self.ids)
        self.sightings = self.sightings[self.sightings[:, LANDMARK] != number]

    def predict(self, rows: np.ndarray) -> Prediction:
        """Predict sightings from the newest keyframe, rows of the table."""
        seen = rows[:, BEARING], self.effective_sigmas(rows)
        return self.state.predict_bearings(*seen, self.cameras(rows), self.index(rows[:, LANDMARK]))

    def solve(self) -> None:
        """Correct everything that is open, and so what is known of the newest pose and the map.

        Raises
        ------
        numpy.linalg.LinAlgError
            When the normal equations are singular.
        """
        for _ in range(STEPS):
            poses, common, covariance = eliminate(self.linearised()[0]).solve()
            if not (np.isfinite(poses).all() and np.isfinite(covariance).all()):
                raise np.linalg.LinAlgError("a step is not finite")
            held, small = self._gains, self._move(poses, common, covariance) < SETTLED
            slip = float(self.calibration[TURN_SLIP])
            self.settled = small and (slip <= 0.0 if held else slip > -NO_GAIN)
            if self.settled:
                break

    def without_known(self, size: float) -> Marginal:
        """Return the state by all but what is known of landmarks, each within `size` [m]."""
        equations = self._measured(self._weighed(self.sightings))
        at = np.arange(NC, len(equations.common))
        equations.common[at, at] += size**-2.0
        poses, common, covariance = eliminate(equations).solve()
        return Marginal(self.state.mean + np.concatenate([poses[-1], common]), covariance)

    def marginals(self) -> list[Marginal]:
        """Return what is known of each open pose, as the state is of the newest, after `solve`."""
        own, by_common, common = marginals(self.linearised()[0])
        found = []
        for pose, covariance, lever in zip(self.poses, own, by_common, strict=True):
            cross = -lever @ common
            joint = np.block([[covariance, cross], [cross.T, common]])
            found.append(Marginal(np.concatenate([pose, self.state.mean[3:]]), joint))
        return found

    def marginalise(self, count: int) -> None:
        """Marginalise the oldest `count` poses: what they say about everything else is kept."""
        first = self.first + count
        old = self.sightings[:, KEYFRAME] < first
        rows = self.sightings[old]
        left = eliminate(self._normal_equations(count + 1, self._weighed(rows)))
        drift = self._drift * max(self.stamps[count] - self.stamps[0], 1e-3)
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
        self._prior.replace(left, self._head_and_map(), drift)

    def residuals(self) -> np.ndarray:
        """Return measured minus expected bearing of each sighting, shape (m,) [rad]."""
        rows = self.sightings
        seen = sight(self.cameras(rows)[0], self.positions[self.index(rows[:, LANDMARK])])
        return np.asarray(wrap(rows[:, BEARING] - seen.bearing))

    def effective_sigmas(self, rows: np.ndarray) -> np.ndarray:
        """Return the deviations by which rows count (m,), less of what may walk [rad]."""
        stands = self.stands[self.index(rows[:, LANDMARK])]
        return np.asarray(effective_sigmas(rows, self._correlated) / np.sqrt(stands))

    def linearised(self) -> tuple[NormalEquations, WeighedSightings]:
        """Return all that is known, and what is seen of it, around what is believed now."""
        seen = self._weighed(self.sightings)
        equations = self._measured(seen)
        self.known.add_to(equations, self.positions, self.ids)
        return equations, seen

    def _weighed(self, rows: np.ndarray) -> WeighedSightings:
        """Return rows of the table, linearised and weighed."""
        pose, landmark = rows[:, KEYFRAME].astype(int) - self.first, self.index(rows[:, LANDMARK])
        seen = bearing_residuals(rows[:, BEARING], *self.cameras(rows), self.positions[landmark])
        sigmas = rows[:, SIGMA], self.effective_sigmas(rows)
        return weigh_sightings(*seen, *sigmas, pose, landmark)

    def _head_and_map(self) -> np.ndarray:
        """Return oldest pose, calibration and landmarks in one vector."""
        return np.concatenate([self.poses[0], self.state.mean[3:]])

    def _move(self, poses: np.ndarray, common: np.ndarray, covariance: np.ndarray) -> float:
        """Apply a step, no longer than the linearisation can be trusted; return its size."""
        landmarks = common[NC:].reshape(-1, 2)
        turn = float(np.abs(poses[:, 2]).max())
        share = float((np.hypot(*landmarks.T) / self.state.reach).max(initial=0.0))
        scale = 1.0 / max(1.0, max(turn, share) / LINEAR_RANGE)
        self._older = self._older + scale * poses[:-1]
        shift = max(np.abs(poses[:, :2]).max(), np.abs(common[CAMERA_X:NC]).max())
        size = max(turn, share, shift / self.state.scale, np.abs(common[:CAMERA_X]).max())
        step = np.concatenate([poses[-1], common])
        self.state = Marginal(self.state.mean + scale * step, covariance)
        return float(size)

    def _normal_equations(self, w: int, seen: WeighedSightings) -> NormalEquations:
        """Return what the oldest w poses and sightings from them say, and the prior.

        They are linearised where poses, calibration and landmarks are believed to be. What is
        believed of the camera's mount beforehand is not among it.
        """
        equations = NormalEquations.zeros(w, NC + self.positions.size)
        self._prior.add_to(equations, self._head_and_map())
        add_odometry(equations, self.poses[:w], self.calibration, self._steps[: w - 1])
        add_sightings(equations, seen)
        return equations

    @property
    def _gains(self) -> bool:
        """Whether wheels would gain way in bends, which they cannot: rubbing, they lose it."""
        return bool(self.calibration[TURN_SLIP] < 0.0)

    def _measured(self, seen: WeighedSightings) -> NormalEquations:
        """Return everything but what is known of landmarks."""
        equations = self._normal_equations(len(self.poses), seen)
        at = np.array([TURN_SLIP, *range(NC)[MOUNT]])
        information = np.array([self.slip_sigma, *self.mount_sigmas]) ** -2.0
        equations.common[at, at] += information
        equations.common_slope[at] -= information * self.calibration[at]
        if self._gains:
            equations.common[TURN_SLIP, TURN_SLIP] += NO_GAIN**-2.0
            equations.common_slope[TURN_SLIP] -= NO_GAIN**-2.0 * self.calibration[TURN_SLIP]
        return equations
