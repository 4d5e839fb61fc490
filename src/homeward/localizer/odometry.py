"""Preintegration: twists since a keyframe as one motion, with what is unknown of the odometry.

The unknowns are one vector, constant or nearly so (`CALIBRATION`): the true turn rate is
``(1 + turn_scale) omega + turn_bias`` while the robot moves, the true speed is less in bends than
on the straight, by ``turn_slip (|omega| - r |v|)``, twists act ``lag`` seconds after their stamps,
and the camera's axis is turned by ``camera_yaw``. A robot whose twist is exactly zero stands, and
neither drifts nor gathers noise.

In the slip, r is how much this robot turns per metre where it drives straightest. So the speed is
right there, and a robot that always turns alike has no slip: it could trade slip for the scale of
the map, which nothing else holds, and the map would shrink, since small maps fit noise better.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import cache

import numpy as np

from homeward.drives.drive import DriveSettings, OdometryNoise
from homeward.estimator import HOLD_S
from homeward.localizer.settings import LocalizerSettings

CALIBRATION = ("turn_scale", "turn_bias", "turn_slip", "lag", "camera_yaw")
"""The unknowns of the odometry and the camera: [1], [rad/s], [m], [s], [rad]."""
TURN_SCALE, TURN_BIAS, TURN_SLIP, LAG, CAMERA_YAW = range(5)
LOST_SPEED = 0.3
"""Without odometry the robot may drive this fast [m/s] ..."""
LOST_TURN = 0.3
"""... and turn this fast [rad/s]."""
STRAIGHTEST = 0.2
"""So large a share of the path counts as the straightest [1]."""
BEND, BENDS = 0.125, 33
"""The path is sorted by how much the robot turned per metre, into classes so wide [rad/m]."""
STRAIGHT_BEFORE_M = 1.0
"""Before it began the robot is thought to have driven straight for so long [m]."""
LONGEST_LAG = 0.8
"""A lag beyond this is not believed [s]."""


@dataclass(frozen=True)
class Motion:
    """A motion in the frame of its own start, linear in the calibration around `at`."""

    delta: np.ndarray
    """(3,): x [m], y [m], heading [rad], the heading not wrapped."""
    covariance: np.ndarray
    """(3, 3), of `delta`, from white noise alone."""
    jacobian: np.ndarray
    """(3, 5), of `delta` with respect to the calibration."""
    path: float = 0.0
    """Length driven [m]."""
    turned: float = 0.0
    """Sum of the sizes of all turns [rad]."""

    @staticmethod
    @cache
    def none() -> Motion:
        """Return the motion that is none."""
        return Motion(np.zeros(3), np.zeros((3, 3)), np.zeros((3, len(CALIBRATION))))

    def then(self, later: Motion) -> Motion:
        """Return this motion followed by another."""
        c, s = math.cos(self.delta[2]), math.sin(self.delta[2])
        x, y, turn = later.delta.tolist()
        step = np.array([c * x - s * y, s * x + c * y, turn])
        first = np.array([[1.0, 0.0, -step[1]], [0.0, 1.0, step[0]], [0.0, 0.0, 1.0]])
        second = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return Motion(
            self.delta + step,
            first @ self.covariance @ first.T + second @ later.covariance @ second.T,
            first @ self.jacobian + second @ later.jacobian,
            self.path + later.path,
            self.turned + later.turned,
        )


class NoiseModel:
    """White noise of the odometry: the drive's own figures, or else in proportion to the motion.

    Parameters
    ----------
    given : OdometryNoise
        What the drive says; None where it does not.
    settings : LocalizerSettings
        The defaults.
    """

    def __init__(self, given: OdometryNoise, settings: LocalizerSettings) -> None:
        self._given, self._default = given, settings.odometry

    def variances(
        self, speed: np.ndarray, turn: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return how fast the variances along, across and of the heading grow.

        Parameters
        ----------
        speed, turn : ndarray, shape (n,)
            Sizes of the twists [m/s], [rad/s].

        Returns
        -------
        along, across, heading : ndarray, shape (n,)
            [m^2/s], [m^2/s], [rad^2/s].
        """
        if self._given.speed_sigma is None:
            along = self._default.distance**2 * speed
            across = along / 9.0
        else:
            along = np.full(speed.shape, self._given.speed_sigma**2)
            across = np.zeros(speed.shape)
        if self._given.turn_sigma is None:
            d = self._default
            heading = d.turn_by_turning**2 * turn + d.turn_by_driving**2 * speed
        else:
            heading = np.full(speed.shape, self._given.turn_sigma**2)
        return along, across, heading


def calibration_sigmas(drive: DriveSettings, settings: LocalizerSettings) -> np.ndarray:
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


class Odometry:
    """Twists as they come, and the motion since the last keyframe.

    Parameters
    ----------
    noise : NoiseModel
        Of the twists.
    """

    def __init__(self, noise: NoiseModel) -> None:
        self._noise = noise
        self._twists: deque[tuple[float, float, float]] = deque()
        self._motion = Motion.none()
        self._done = -math.inf
        self._path_by_bend = np.zeros(BENDS)
        self._path_by_bend[0] = STRAIGHT_BEFORE_M
        self._straightest = 0.0

    def add(self, t: float, v: float, omega: float) -> None:
        """Take a twist; one of the same stamp as the last replaces it."""
        if self._twists and t == self._twists[-1][0]:
            self._twists.pop()
        self._twists.append((t, v, omega))

    def restart(self, t: float) -> None:
        """Let the motion begin anew at `t` [s]: there is a keyframe now."""
        self._motion, self._done = Motion.none(), t
        share = self._path_by_bend.cumsum() / self._path_by_bend.sum()
        straight = int((share >= STRAIGHTEST).argmax())
        self._straightest = BEND * (straight + 0.5) if straight else 0.0

    def motion(self, t: float, calibration: np.ndarray) -> Motion:
        """Return the motion since the last keyframe up to `t` [s]; nothing changes.

        Parameters
        ----------
        t : float
            A time before the end of what `advance` has done counts as that end.
        calibration : ndarray, shape (5,)
            Where to linearise.
        """
        if t <= self._done:
            return self._motion
        return self._motion.then(self._integrate(self._done, t, calibration)[0])

    def advance(self, t: float, calibration: np.ndarray) -> Motion:
        """Return the motion up to `t` [s], and be done with it: no earlier twist is to come."""
        if t > self._done:
            motion, path = self._integrate(self._done, t, calibration)
            self._motion, self._done = self._motion.then(motion), t
            self._path_by_bend += path  # for r
            self._forget(t - 2.0 * LONGEST_LAG)
        return self._motion

    @property
    def done(self) -> float:
        """How far `advance` has come [s]."""
        return self._done

    def _forget(self, t: float) -> None:
        """Drop the twists that ended before `t` [s]."""
        while len(self._twists) > 1 and self._twists[1][0] < t:
            self._twists.popleft()

    def _integrate(
        self, begin: float, end: float, calibration: np.ndarray
    ) -> tuple[Motion, np.ndarray]:
        """Return the motion from `begin` to `end` [s], and its path by bend, shape (BENDS,)."""
        lag = min(max(float(calibration[LAG]), -LONGEST_LAG), LONGEST_LAG)
        lost, dt, v, omega = self._pieces(begin - lag, end - lag)
        moving = (v != 0.0) | (omega != 0.0)
        rate = moving * ((1.0 + calibration[TURN_SCALE]) * omega + calibration[TURN_BIAS])
        speed, turned = np.abs(v), np.abs(omega)
        along, across, heading = self._noise.variances(speed, turned)
        slip = np.sign(v) * turned - v * self._straightest
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
        ones, zeros = np.ones(dt.size), np.zeros(dt.size)
        by_turn = np.array([swing_x, swing_y, ones])
        by_path = np.array([c, s, zeros])
        by_slip = np.array([-s, c, zeros])
        steady, shift, swing = moving * dt, (LOST_SPEED * lost) ** 2, (LOST_TURN * lost) ** 2
        covariance = (
            (by_turn * (heading * steady + swing)) @ by_turn.T
            + (by_path * (along * steady + shift)) @ by_path.T
            + (by_slip * (across * steady + shift)) @ by_slip.T
        )
        jacobian = np.zeros((3, len(CALIBRATION)))
        jacobian[:, TURN_SCALE] = by_turn @ (omega * dt)
        jacobian[:, TURN_BIAS] = by_turn @ steady
        jacobian[:, TURN_SLIP] = -by_path @ (slip * dt)
        jacobian[:, LAG] = _shift(delta, v[0], rate[0], v[-1], rate[-1])
        return (
            Motion(delta, covariance, jacobian, float(speed @ dt), float(np.abs(turn).sum())),
            path,
        )

    def _pieces(
        self, begin: float, end: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return time without odometry, time with it [s], v and omega of each piece of time."""
        twists = self._twists
        first = len(twists)
        while first > 0 and twists[first - 1][0] >= begin:
            first -= 1
        first = max(first - 1, 0)
        pieces = [twists[i] for i in range(first, len(twists)) if twists[i][0] < end]
        if not pieces:  # before the first twist, or none at all
            return np.array([end - begin]), np.zeros(1), np.zeros(1), np.zeros(1)
        stamps, v, omega = np.array(pieces).T
        edges = np.append(np.maximum(stamps, begin), end)
        length = edges[1:] - edges[:-1]
        known = np.minimum(np.maximum(stamps + HOLD_S - edges[:-1], 0.0), length)
        lost = length - known
        lost[0] += max(stamps[0] - begin, 0.0)
        return lost, known, v, omega


def _shift(delta: np.ndarray, v0: float, rate0: float, v1: float, rate1: float) -> np.ndarray:
    """Return the derivative of a motion by a delay of all its twists, shape (3,)."""
    c, s = math.cos(delta[2]), math.sin(delta[2])
    return np.array([v0 - rate0 * delta[1] - c * v1, rate0 * delta[0] - s * v1, rate0 - rate1])
