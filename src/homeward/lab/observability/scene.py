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
    title: str = ""
    """The drive in words."""

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
        return np.array(self._measure(unknowns)[0])[:, 0]

    def jacobian(self) -> np.ndarray:
        """Return the derivatives of `outputs` at the true values, shape (rows, 3 + 2 q + c)."""
        return np.array(self._measure(self.truth)[1])

    @cached_property
    def rank(self) -> Rank:
        """Rank of the derivatives; its null space is in the units of the unknowns."""
        return rank(self.jacobian(), self.worth)

    @cached_property
    def _measured(self) -> np.ndarray:
        return self.outputs(self.truth)

    def compare(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the differences of the measurements from their true values, and the Jacobian."""
        measured, jacobian = (np.array(part) for part in self._measure(unknowns))
        difference = measured[:, 0] - self._measured
        angles = len(difference) - (self.distances and len(self.landmarks))
        difference[:angles] = wrap(difference[:angles])
        return difference, jacobian

    @cached_property
    def _measure(self) -> ca.Function:
        """Return all measurements and their derivatives as a function of the unknowns."""
        q, unknowns = len(self.landmarks), ca.SX.sym("unknowns", len(self.truth))
        home, marks = unknowns[:POLAR], ca.reshape(unknowns[POLAR : POLAR + 2 * q], 2, q)
        constants = ca.SX(IDEAL)
        for k, name in enumerate(self.unknown):
            constants[CALIBRATIONS.index(name)] = unknowns[POLAR + 2 * q + k]
        poses, twists = self._path(constants)
        n, i = (rows.tolist() for rows in np.nonzero(self.visible))
        kept = np.flatnonzero(self.stored).tolist()
        eyes = ca.horzcat(poses[:, n], ca.repmat(home, 1, len(kept)))
        moving = ca.horzcat(twists[:, n], ca.SX.zeros(INPUTS, len(kept)))
        every = _sighting().map("every", "serial", len(n) + len(kept), [3], [])
        values = [every(eyes, moving, marks[:, i + kept], constants).T]
        if self.compass:
            values.append(home[2])
        if self.distances:
            away = marks - home[:2]
            values.append(ca.sqrt(ca.sum1(away**2)).T)
        measured = ca.vertcat(*values)
        derivatives = ca.densify(ca.jacobian(measured, unknowns))
        return ca.Function("measure", [unknowns], [measured, derivatives])

    def _path(self, constants: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return poses (3, n), and the true twists before them (2, n)."""
        poses, twists = ca.SX(self.poses.T), ca.SX.zeros(INPUTS, len(self.poses))
        if self.unknown and self.twists is not None and self.intervals is not None:
            for k, (twist, dt) in enumerate(zip(self.twists, self.intervals, strict=True)):
                poses[:, k + 1], twists[:, k + 1] = _advance()(poses[:, k], constants, twist, dt)
        return poses, twists


def landmark_names(q: int) -> tuple[str, ...]:
    """Return L1, L2, ... for q landmarks."""
    return tuple(f"L{i + 1}" for i in range(q))


def drive(start: Pose, twists: np.ndarray, intervals: np.ndarray) -> np.ndarray:
    """Return the poses (n, 3) along a drive of twists (n - 1, 2) over intervals (n - 1,) [s]."""
    poses = [np.array(start, float)]
    for twist, interval in zip(twists, intervals, strict=True):
        poses.append(np.array(_advance()(poses[-1], IDEAL, twist, interval)[0])[:, 0])
    return np.array(poses)


@lru_cache(maxsize=1)
def _advance() -> ca.Function:
    """Return a step of miscalibrated odometry: end pose, and the true twist."""
    pose, constants = ca.SX.sym("pose", POLAR), ca.SX.sym("c", len(CALIBRATIONS))
    twist, interval = ca.SX.sym("twist", INPUTS), ca.SX.sym("dt")
    true = ca.vertcat(constants[0] * twist[0], constants[1] * twist[1] + constants[2])
    after = discretise(unicycle_rates, pose, true, interval).state
    return ca.Function("advance", [pose, constants, twist, interval], [after, true])


@lru_cache(maxsize=1)
def _sighting() -> ca.Function:
    """Return the delayed bearing of a landmark from a rotated camera [rad]."""
    pose, twist, mark = ca.SX.sym("p", POLAR), ca.SX.sym("u", INPUTS), ca.SX.sym("m", 2)
    constants = ca.SX.sym("c", len(CALIBRATIONS))
    then = discretise(unicycle_rates, pose, twist, -constants[3]).state
    seen = bearing(Pose(then[0], then[1], then[2]), mark[0], mark[1]) - constants[4]
    return ca.Function("sighting", [pose, twist, mark, constants], [seen])
