"""Motions that are linear in the calibration of odometry and camera.

The calibration is one vector (`CALIBRATION`), constant but for a slow drift; the reference of
preintegration explains each unknown of odometry. All speeds are ``1 + speed_scale`` times as large,
which only known landmarks make observable, and that to the left another ``1 + sideways_scale``
times; the camera is turned by ``camera_yaw`` and shifted by
``camera_x`` and ``camera_y`` from its given pose.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from homeward.geometry.se2 import between, composition
from homeward.geometry.statistics import positive

ODOMETRY_CALIBRATION = (
    "turn_scale",
    "turn_bias",
    "turn_slip",
    "delay",
    "time_constant",
    "speed_scale",
    "sideways_scale",
)
CALIBRATION = (*ODOMETRY_CALIBRATION, "camera_yaw", "camera_x", "camera_y")
"""Unknowns of odometry and camera: [1], [rad/s], [m], [s], [s], [1], [1], [rad], [m], [m]."""
NC = len(CALIBRATION)
HEAD = 3 + NC
"""Length of the state before the landmarks: newest pose and calibration."""
(
    TURN_SCALE,
    TURN_BIAS,
    TURN_SLIP,
    DELAY,
    TIME_CONSTANT,
    SPEED_SCALE,
    SIDEWAYS_SCALE,
    CAMERA_YAW,
    CAMERA_X,
    CAMERA_Y,
) = range(NC)
MOUNT = slice(CAMERA_YAW, CAMERA_Y + 1)
CAMERA_JACOBIAN = np.eye(NC)[[CAMERA_X, CAMERA_Y, CAMERA_YAW]]
"""(3, 10): Jacobian of the camera's pose on the robot by the calibration."""


@dataclass(frozen=True)
class Motion:
    """Preintegrated motion in the frame of its start, linear in the calibration."""

    delta: np.ndarray
    """(3,): x [m], y [m], heading [rad], the heading not wrapped."""
    covariance: np.ndarray
    """(3, 3): of `delta`, by white noise alone."""
    jacobian: np.ndarray
    """(3, 10): of `delta` by the calibration."""
    path: float = 0.0
    """Length driven [m]."""
    turned: float = 0.0
    """Sum of the sizes of all turns [rad]."""
    calibration: np.ndarray = field(default_factory=lambda: np.zeros(NC))
    """(10,): linearisation point."""
    is_odometry: bool = False
    """Whether it is from twists alone, and so can be integrated again."""

    @property
    def uncalibrated(self) -> np.ndarray:
        """(3,): the motion for a calibration of zero."""
        return np.asarray(self.delta - self.jacobian @ self.calibration)

    @staticmethod
    @cache
    def identity() -> Motion:
        """Return the identity: no motion."""
        return Motion(np.zeros(3), np.zeros((3, 3)), np.zeros((3, NC)))

    def compose(self, later: Motion) -> Motion:
        """Return the composition: this motion, then another."""
        if self is Motion.identity() or later is Motion.identity():
            return later if self is Motion.identity() else self
        delta, first, second = composition(self.delta, later.delta)
        covariance = first @ self.covariance @ first.T + second @ later.covariance @ second.T
        # Back to where it was, the shift's variance by a turn is a difference of larger ones.
        lever = float(first[0, 2] ** 2 + first[1, 2] ** 2)
        scale = (1.0 + lever) * float(self.covariance.trace()) + float(later.covariance.trace())
        return Motion(
            delta,
            positive(covariance, "the covariance of a composed motion", scale),
            first @ self.jacobian + second @ later.jacobian,
            self.path + later.path,
            self.turned + later.turned,
            later.calibration,
            self.is_odometry and later.is_odometry,
        )

    def inverse(self) -> Motion:
        """Return the inverse motion, taken as exact."""
        delta = between(self.delta, np.zeros(3))
        return Motion(delta, np.zeros((3, 3)), np.zeros((3, NC)))


def camera_after(
    motion: Motion, mount: np.ndarray, calibration: np.ndarray, offset: np.ndarray | None = None
) -> Motion:
    """Return the motion to a camera from the start of the robot's motion; see above.

    `offset` (3,) is the pose of the camera in the frame of the first one; None for the first.
    """
    delta = mount + calibration[[CAMERA_X, CAMERA_Y, CAMERA_YAW]]
    on_robot = Motion(delta, np.zeros((3, 3)), CAMERA_JACOBIAN, calibration=calibration)
    first = motion.compose(on_robot)
    if offset is None:
        return first
    fixed = dataclasses.replace(Motion.identity(), delta=offset, calibration=calibration)
    return first.compose(fixed)
