"""A drive past landmarks: its measurements, and their derivatives by all unknowns.

The robot's path is fixed in the frame. Home is an unknown pose in it, from which the home bearings
were measured. Unobservable directions are changes of home, landmarks and calibration that change no
bearing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal, get_args

import casadi as ca
import numpy as np

from homeward.geometry.angles import wrap
from homeward.geometry.frames import Pose, bearing
from homeward.lab.model import INPUTS, POLAR, discretise, unicycle_rates
from homeward.lab.observability.ranks import Rank, rank

Calibration = Literal["speed-scale", "turn-scale", "turn-bias", "lag", "camera-yaw"]
CALIBRATIONS: tuple[Calibration, ...] = get_args(Calibration)
"""Constants that may be unknown: scales of speed and yaw rate [1], bias of the yaw rate [rad/s],
delay of the bearing stamps [s], yaw of the camera on the robot [rad]."""
UNITS = ("", "", "rad/s", "s", "rad")
IDEAL = (1.0, 1.0, 0.0, 0.0, 0.0)
"""Values of a correct calibration."""


@dataclass(frozen=True)
class Scene:
    """Poses of robot and home, and landmarks; q landmarks, n stamps."""

    names: tuple[str, ...]
    """(q,), ids of the landmarks."""
    home: np.ndarray
    """(3,), x [m], y [m], heading [rad]."""
    landmarks: np.ndarray
    """(q, 2), [m]."""
    poses: np.ndarray
    """(n, 3), of the camera: x [m], y [m], heading [rad]."""
    visible: np.ndarray
    """(n, q), bool, whether a landmark is seen at a stamp."""
    stored: np.ndarray
    """(q,), bool, whether it has a home bearing."""
    twists: np.ndarray | None = None
    """(n - 1, 2), speed [m/s] and yaw rate [rad/s] from pose to pose; needed only where a
    calibration is unknown."""
    intervals: np.ndarray | None = None
    """(n - 1,), between the stamps [s]."""
    unknown: tuple[Calibration, ...] = ()
    compass: bool = False
    """Whether the heading relative to home is measured."""
    distances: bool = False
    """Whether the landmarks' distances from home are known."""
    axis: str = "the robot's first heading"
    """The x-axis of the frame in words."""

    @cached_property
    def length(self) -> float:
        """Typical distance [m]: root mean square over home and landmarks."""
        everything = np.vstack([self.landmarks, self.home[None, :2]]) - self.poses[0, :2]
        return float(np.sqrt(np.mean(everything**2) * 2)) or 1.0

    @property
    def truth(self) -> np.ndarray:
        """True values of all unknowns: home (3), landmarks (2 q), unknown calibrations (c)."""
        ideal = [IDEAL[CALIBRATIONS.index(name)] for name in self.unknown]
        return np.concatenate([self.home, self.landmarks.ravel(), ideal])

    @property
    def worth(self) -> np.ndarray:
        """Unit of each unknown that makes them comparable: `length` for lengths."""
        L, q = self.length, len(self.landmarks)
        time = 1.0 if self.intervals is None else float(self.intervals.sum()) or 1.0
        constants = {"turn-bias": 1 / time, "lag": time}
        rest = [constants.get(name, 1.0) for name in self.unknown]
        return np.array([L, L, 1.0, *[L] * (2 * q), *rest])

    def outputs(self, unknowns: np.ndarray) -> np.ndarray:
        """Return all measurements [rad; distances m] for given unknowns."""
        return self._measure(unknowns)[0]

    def jacobian(self) -> np.ndarray:
        """Return the derivatives of `outputs` at the true values, shape (rows, 3 + 2 q + c)."""
        return self._measure(self.truth)[1]

    def rank(self) -> Rank:
        """Return the rank; its null space is in the units of the unknowns."""
        return rank(self.jacobian(), self.worth)

    @cached_property
    def _measured(self) -> np.ndarray:
        return self.outputs(self.truth)

    def compare(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the differences of the measurements from their true values, and the Jacobian."""
        measured, jacobian = self._measure(unknowns)
        difference = measured - self._measured
        angles = len(difference) - (self.distances and len(self.landmarks))
        difference[:angles] = wrap(difference[:angles])
        return difference, jacobian

    def _measure(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        q, size = len(self.landmarks), unknowns.size
        home, marks = unknowns[:POLAR], unknowns[POLAR : POLAR + 2 * q].reshape(q, 2)
        constants = np.array(IDEAL)
        which = [CALIBRATIONS.index(name) for name in self.unknown]
        constants[which] = unknowns[POLAR + 2 * q :]
        poses, twists, by_constants = self._path(constants)

        n, i = np.nonzero(self.visible)
        seen, gradient = _sightings(poses[n], twists[n], marks[i], constants)
        rows = np.zeros((n.size, size))
        _put_marks(rows, i, gradient[:, POLAR : POLAR + 2])
        chained = np.einsum("kp,kpc->kc", gradient[:, :POLAR], by_constants[n])
        rows[:, POLAR + 2 * q :] = (chained + gradient[:, POLAR + 2 :])[:, which]

        kept = np.flatnonzero(self.stored)
        still = np.zeros((kept.size, INPUTS))
        stored, by_home = _sightings(np.tile(home, (kept.size, 1)), still, marks[kept], constants)
        home_rows = np.zeros((kept.size, size))
        home_rows[:, :POLAR] = by_home[:, :POLAR]
        _put_marks(home_rows, kept, by_home[:, POLAR : POLAR + 2])
        home_rows[:, POLAR + 2 * q :] = by_home[:, POLAR + 2 :][:, which]

        values, blocks = [seen, stored], [rows, home_rows]
        if self.compass:
            compass = np.zeros((1, size))
            compass[0, 2] = 1.0
            values.append(home[2:3])
            blocks.append(compass)
        if self.distances:
            away = marks - home[:2]
            far = np.hypot(*away.T)
            surveyed = np.zeros((q, size))
            surveyed[:, :2] = -away / far[:, None]
            _put_marks(surveyed, np.arange(q), away / far[:, None])
            values.append(far)
            blocks.append(surveyed)
        return np.concatenate(values), np.vstack(blocks)

    def _path(self, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return poses (n, 3), the true twists before them (n, 2), and d(poses)/d(constants)."""
        n = len(self.poses)
        arrived = np.zeros((n, INPUTS))
        by_constants = np.zeros((n, POLAR, len(CALIBRATIONS)))
        if not self.unknown or self.twists is None or self.intervals is None:
            return self.poses, arrived, by_constants
        poses = self.poses.copy()
        for k in range(1, n):
            end, by_pose, by_own, used = (
                np.array(m)
                for m in _advance()(
                    poses[k - 1], constants, self.twists[k - 1], self.intervals[k - 1]
                )
            )
            poses[k], arrived[k] = end[:, 0], used[:, 0]
            by_constants[k] = by_pose @ by_constants[k - 1] + by_own
        return poses, arrived, by_constants


def drive(start: Pose, twists: np.ndarray, intervals: np.ndarray) -> np.ndarray:
    """Return the poses (n, 3) along a drive of twists (n - 1, 2) over intervals (n - 1,) [s]."""
    poses = [np.array(start, float)]
    for twist, interval in zip(twists, intervals, strict=True):
        poses.append(np.array(_advance()(poses[-1], IDEAL, twist, interval)[0])[:, 0])
    return np.array(poses)


def _put_marks(rows: np.ndarray, which: np.ndarray, gradient: np.ndarray) -> None:
    """Write gradients (k, 2) by landmarks `which` (k,) into rows (k, ...)."""
    k = np.arange(which.size)
    rows[k, POLAR + 2 * which], rows[k, POLAR + 2 * which + 1] = gradient.T


@lru_cache(maxsize=1)
def _advance() -> ca.Function:
    """Return a step of miscalibrated odometry: end pose, its derivatives, and the true twist."""
    pose, constants = ca.SX.sym("pose", POLAR), ca.SX.sym("c", len(CALIBRATIONS))
    twist, interval = ca.SX.sym("twist", INPUTS), ca.SX.sym("dt")
    true = ca.vertcat(constants[0] * twist[0], constants[1] * twist[1] + constants[2])
    step = discretise(unicycle_rates, pose, true, interval)
    by_constants = step.by_input @ ca.jacobian(true, constants)
    outputs = [ca.densify(m) for m in (step.state, step.by_state, by_constants, true)]
    return ca.Function("advance", [pose, constants, twist, interval], outputs)


@lru_cache(maxsize=256)
def _sighting(k: int) -> ca.Function:
    """Return k delayed bearings of a rotated camera, and gradients by pose, mark, constants."""
    pose, twist, mark = ca.SX.sym("p", POLAR), ca.SX.sym("u", INPUTS), ca.SX.sym("m", 2)
    constants = ca.SX.sym("c", len(CALIBRATIONS))
    then = discretise(unicycle_rates, pose, twist, -constants[3]).state
    seen = bearing(Pose(then[0], then[1], then[2]), mark[0], mark[1]) - constants[4]
    unknowns = ca.vertcat(pose, mark, constants)
    gradient = ca.densify(ca.jacobian(seen, unknowns))
    return ca.Function("sighting", [pose, twist, mark, constants], [seen, gradient]).map(k)


def _sightings(
    poses: np.ndarray, twists: np.ndarray, marks: np.ndarray, constants: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return bearings (k,) [rad] and their gradients (k, 3 + 2 + 5)."""
    k = len(poses)
    size = POLAR + 2 + len(CALIBRATIONS)
    if not k:
        return np.zeros(0), np.zeros((0, size))
    seen, gradient = _sighting(k)(poses.T, twists.T, marks.T, np.tile(constants[:, None], (1, k)))
    return np.array(seen)[0], np.array(gradient).reshape(k, size)
