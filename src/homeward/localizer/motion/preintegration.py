"""Preintegration of odometry (Lupton and Sukkarieh, 2012): twists as one motion, with its Jacobian.

The unknowns are one vector, constant or nearly so (`CALIBRATION`): the true turn rate is
``(1 + turn_scale) omega + turn_bias`` while the robot moves, the true speed is less in bends than
on the straight, by ``turn_slip (|omega| - r |v|)``, twists act ``lag`` seconds after their stamps,
and the camera is turned by ``camera_yaw`` and shifted by ``camera_x`` and ``camera_y`` from where
it is said to sit. A robot whose twist is exactly zero stands, and neither drifts nor gathers noise.

In the slip, r is how much this robot turns per metre where it drives straightest. So the speed is
right there, and a robot that always turns alike has no slip: it could trade slip for the scale of
the map, which nothing else holds, and the map would shrink, since small maps fit noise better.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from homeward.localizer.geometry import between, compose, lever, rotation

OF_ODOMETRY = ("turn_scale", "turn_bias", "turn_slip", "lag")
CALIBRATION = (*OF_ODOMETRY, "camera_yaw", "camera_x", "camera_y")
"""The unknowns of odometry and camera: [1], [rad/s], [m], [s], [rad], [m], [m]."""
NC = len(CALIBRATION)
TURN_SCALE, TURN_BIAS, TURN_SLIP, LAG, CAMERA_YAW, CAMERA_X, CAMERA_Y = range(len(CALIBRATION))
MOUNT = slice(CAMERA_YAW, CAMERA_Y + 1)
BEND, BENDS = 0.125, 33
"""The path is sorted by how much the robot turned per metre, into classes so wide [rad/m]."""


@dataclass(frozen=True)
class Motion:
    """Preintegrated motion in the frame of its start, linear in the calibration."""

    delta: np.ndarray
    """(3,): x [m], y [m], heading [rad], the heading not wrapped."""
    covariance: np.ndarray
    """(3, 3), of `delta`, from white noise alone."""
    jacobian: np.ndarray
    """(3, 7), of `delta` with respect to the calibration."""
    path: float = 0.0
    """Length driven [m]."""
    turned: float = 0.0
    """Sum of the sizes of all turns [rad]."""
    calibration: np.ndarray = field(default_factory=lambda: np.zeros(NC))
    """(7,): where it is linearised."""

    @property
    def free(self) -> np.ndarray:
        """(3,): the motion were the calibration zero."""
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
        delta = compose(self.delta, later.delta)
        first, second = lever(delta - self.delta), rotation(self.delta[2])
        return Motion(
            delta,
            first @ self.covariance @ first.T + second @ later.covariance @ second.T,
            first @ self.jacobian + second @ later.jacobian,
            self.path + later.path,
            self.turned + later.turned,
            later.calibration,
        )

    def inverse(self) -> Motion:
        """Return the inverse motion, taken for exact and known."""
        delta = between(self.delta, np.zeros(3))
        return Motion(delta, np.zeros((3, 3)), np.zeros((3, NC)))


def camera_on_robot(mount: np.ndarray, calibration: np.ndarray) -> Motion:
    """Return the camera's pose on the robot: as told, `mount` (3,), corrected by a calibration."""
    camera = [CAMERA_X, CAMERA_Y, CAMERA_YAW]
    jacobian = np.zeros((3, NC))
    jacobian[[0, 1, 2], camera] = 1.0
    delta = mount + calibration[camera]
    return Motion(delta, np.zeros((3, 3)), jacobian, calibration=calibration)


def integrate(
    pieces: np.ndarray, calibration: np.ndarray, rates: np.ndarray, straightest: float
) -> tuple[Motion, np.ndarray]:
    """Return the motion over pieces of time.

    Parameters
    ----------
    pieces : ndarray, shape (n, 5)
        By what the variances of shift [m^2] and heading [rad^2] grow before each while odometry is
        silent; time with it [s], v [m/s] and omega [rad/s].
    calibration : ndarray, shape (7,)
        Where to linearise; the lag is in the pieces' times.
    rates : ndarray, shape (3, 3)
        Of the noise; see `homeward.drives.odometry_noise.noise_rates`.
    straightest : float
        How much the robot turns per metre where it drives straightest [rad/m].

    Returns
    -------
    motion : Motion
        From begin to end.
    by_bend : ndarray, shape (BENDS,)
        Its length by how much the robot turned per metre [m].
    """
    shift, swing, dt, v, omega = pieces.T
    moving = (v != 0.0) | (omega != 0.0)
    rate = moving * ((1.0 + calibration[TURN_SCALE]) * omega + calibration[TURN_BIAS])
    speed, turned = np.abs(v), np.abs(omega)
    along, across, heading = rates @ np.array([np.ones(dt.size), speed, turned])
    slip = np.sign(v) * turned - v * straightest
    bend = turned / np.maximum(speed, 1e-6) / BEND
    path = np.bincount(np.minimum(bend, BENDS - 1).astype(int), speed * dt, BENDS)
    v = v - calibration[TURN_SLIP] * slip

    turn = rate * dt
    psi_end = turn.cumsum()
    psi = psi_end - 0.5 * turn
    c, s = np.cos(psi), np.sin(psi)
    half = 0.5 * turn + 1e-12
    chord = v * dt * (np.sin(half) / half)
    along_x, along_y = chord * c, chord * s
    x, y = along_x.cumsum(), along_y.cumsum()
    delta = np.array([x[-1], y[-1], psi_end[-1]])

    # a turn in piece i swings everything that comes after its middle
    swing_x, swing_y = y - 0.5 * along_y - delta[1], delta[0] - x + 0.5 * along_x
    n, steady = dt.size, moving * dt
    by_error = np.zeros((3, 3, n))  # by the turn of each piece, its length, and a shift across it
    by_error[0, 0], by_error[1, 0], by_error[2, 0] = swing_x, swing_y, 1.0
    by_error[0, 1], by_error[1, 1] = c, s
    by_error[0, 2], by_error[1, 2] = -s, c
    by_turn, by_path = by_error[:, 0], by_error[:, 1]
    variances = np.array([heading, along, across]) * steady
    variances += np.array([swing, shift, shift])
    flat = by_error.reshape(3, 3 * n)
    covariance = (flat * variances.ravel()) @ flat.T
    jacobian = np.zeros((3, NC))
    jacobian[:, TURN_SCALE] = by_turn @ (omega * dt)
    jacobian[:, TURN_BIAS] = by_turn @ steady
    jacobian[:, TURN_SLIP] = -by_path @ (slip * dt)
    jacobian[:, LAG] = _shift(delta, v[0], rate[0], v[-1], rate[-1])
    lengths = float(speed @ dt), float(np.abs(turn).sum())
    return Motion(delta, covariance, jacobian, *lengths, calibration), np.asarray(path)


def _shift(delta: np.ndarray, v0: float, rate0: float, v1: float, rate1: float) -> np.ndarray:
    """Return the derivative of a motion by a delay of all its twists, shape (3,)."""
    c, s = math.cos(delta[2]), math.sin(delta[2])
    return np.array([v0 - rate0 * delta[1] - c * v1, rate0 * delta[0] - s * v1, rate0 - rate1])
