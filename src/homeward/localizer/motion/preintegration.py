"""Preintegration of odometry (Lupton and Sukkarieh, 2012; Forster et al., 2017).

The twists between two keyframes become one motion, with its covariance and its Jacobian by the
calibration, so that a new calibration needs no new integration.

The calibration is one vector (`CALIBRATION`), constant but for a slow drift. The true turn rate is
``(1 + turn_scale) omega + turn_bias`` while the robot moves; the true speed is reduced in bends by
the slip ``turn_slip (|omega| - r |v|)``; twists act ``delay`` seconds after their stamps, as below;
all speeds are ``1 + speed_scale`` times as large, which only known landmarks make observable; the
camera is turned by ``camera_yaw`` and shifted by ``camera_x`` and ``camera_y`` from its given pose.
A robot whose twist is exactly zero is stationary, and gathers neither drift nor noise.

Where odometry is the commanded twist u, the robot follows as a first-order lag with the time
constant T: its twist is s, with ``T ds/dt = u - s``. Its pose is then the commanded one less the
motion ``exp(T s)``, exact for a constant direction of u; so only the ends of a motion change.

In the slip, r is the turn per metre of this robot where it drives straightest. The speed is right
there, and slip is zero for a robot that always turns alike; else slip could be traded for the scale
of the map, which nothing else determines: it would shrink, since small maps fit noise better.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import numpy as np

from homeward.geometry.covariance import positive
from homeward.geometry.se2 import between, composition
from homeward.localizer.tunables import BEND, MIN_STEADY_SPEED, NUM_BENDS
from homeward.odometry.history import SettledTwist

ODOMETRY_CALIBRATION = (
    "turn_scale",
    "turn_bias",
    "turn_slip",
    "delay",
    "time_constant",
    "speed_scale",
)
CALIBRATION = (*ODOMETRY_CALIBRATION, "camera_yaw", "camera_x", "camera_y")
"""Unknowns of odometry and camera: [1], [rad/s], [m], [s], [s], [1], [rad], [m], [m]."""
NC = len(CALIBRATION)
(
    TURN_SCALE,
    TURN_BIAS,
    TURN_SLIP,
    DELAY,
    TIME_CONSTANT,
    SPEED_SCALE,
    CAMERA_YAW,
    CAMERA_X,
    CAMERA_Y,
) = range(NC)
MOUNT = slice(CAMERA_YAW, CAMERA_Y + 1)
CAMERA_JACOBIAN = np.eye(NC)[[CAMERA_X, CAMERA_Y, CAMERA_YAW]]
"""(3, 9): Jacobian of the camera's pose on the robot by the calibration."""


@dataclass(frozen=True)
class Motion:
    """Preintegrated motion in the frame of its start, linear in the calibration."""

    delta: np.ndarray
    """(3,): x [m], y [m], heading [rad], the heading not wrapped."""
    covariance: np.ndarray
    """(3, 3): of `delta`, by white noise alone."""
    jacobian: np.ndarray
    """(3, 9): of `delta` by the calibration."""
    path: float = 0.0
    """Length driven [m]."""
    turned: float = 0.0
    """Sum of the sizes of all turns [rad]."""
    calibration: np.ndarray = field(default_factory=lambda: np.zeros(NC))
    """(9,): linearisation point."""
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


class Piece(NamedTuple):
    """Interval with one twist, preceded by the growth of variance during a dropout, if any."""

    shift: float
    """Growth of the shift's variance [m^2] ..."""
    swing: float
    """... and of the heading's [rad^2]."""
    dt: float
    """[s]"""
    v: float
    """[m/s]"""
    omega: float
    """[rad/s]"""
    steady: float
    """Smoothed speed: slip computed from noisy samples would be correlated with their noise [m/s].
    """


def integrate(
    pieces: Sequence[Piece],
    ends: tuple[SettledTwist, SettledTwist],
    calibration: np.ndarray,
    rates: np.ndarray,
    straightest: float,
) -> tuple[Motion, np.ndarray]:
    """Preintegrate the twists of consecutive intervals; return the motion, and its length by bend.

    `ends` are the robot's twists at the start and at the end: the noise of single samples there
    would count as information on the delay. `calibration` (9,) is the linearisation point; the
    delay is already in the times of the pieces, of which there is at least one. `rates` (3, 3) is
    the growth of the variances (`homeward.drives.settings.noise_rates`), and `straightest` the turn
    per metre where the robot drives straightest, r above [rad/m]. The length (NUM_BENDS,) is by
    class of turn per metre [m].
    """
    scale, bias, slip = calibration[[TURN_SCALE, TURN_BIAS, TURN_SLIP]].tolist()
    size = 1.0 + float(calibration[SPEED_SCALE])
    x = y = psi = path = turned = 0.0
    by_bend, chords = [0.0] * NUM_BENDS, []
    for piece in pieces:  # of so few numbers, floats are quicker than arrays
        _, _, dt, v, omega, steady = piece
        way, spin = abs(v) * dt, abs(omega)
        rate = (1.0 + scale) * omega + bias if v or omega else 0.0
        ahead = steady if abs(steady) > MIN_STEADY_SPEED else v
        slips = math.copysign(spin, ahead) - steady * straightest if v else 0.0
        speed, half = size * (v - slip * slips), 0.5 * rate * dt
        c, s = math.cos(psi + half), math.sin(psi + half)
        chord = speed * dt * (math.sin(half) / half if half else 1.0)
        chords.append((piece, x + 0.5 * chord * c, y + 0.5 * chord * s, c, s, size * slips))
        x, y, psi = x + chord * c, y + chord * s, psi + 2.0 * half
        path, turned = path + way, turned + 2.0 * abs(half)
        by_bend[min(int(spin / max(abs(steady), 1e-6) / BEND), NUM_BENDS - 1)] += way
    delta, jacobian = np.array([x, y, psi]), np.zeros((3, NC))
    covariance = _add_errors(chords, delta, rates.tolist(), jacobian)
    commanded = Motion(delta, covariance, jacobian, path, turned, calibration, True)
    first, last = (
        _outstanding(*end, calibration, sign) for end, sign in zip(ends, (1.0, -1.0), strict=True)
    )
    motion = first.compose(commanded).compose(last)
    motion.jacobian[:2, SPEED_SCALE] = motion.delta[:2] / size
    twists = [(size * v, (1.0 + scale) * w + bias if v or w else 0.0) for (v, w), _ in ends]
    motion.jacobian[:, DELAY] = _shift(motion.delta, *twists[0], *twists[1])
    return motion, np.array(by_bend)


def _outstanding(
    twist: tuple[float, float],
    slope: tuple[float, float],
    calibration: np.ndarray,
    sign: float,
) -> Motion:
    """Return the commanded motion that the robot still has to make, forward or backward by sign.

    A first-order lag is behind its command by its time constant times its own twist.
    """
    scale, bias, lag = calibration[[TURN_SCALE, TURN_BIAS, TIME_CONSTANT]].tolist()
    size, (v, omega) = 1.0 + float(calibration[SPEED_SCALE]), twist
    rate = (1.0 + scale) * omega + bias if v or omega else 0.0
    half = 0.5 * rate * sign * lag
    chord = size * v * sign * lag * (math.sin(half) / half if half else 1.0)
    x, y, heading = chord * math.cos(half), chord * math.sin(half), 2.0 * half
    by_calibration = np.zeros((3, NC))
    c, s = math.cos(heading), math.sin(heading)
    for column, turn in ((TURN_SCALE, sign * lag * omega), (TURN_BIAS, sign * lag)):
        by_calibration[:, column] = -x * heading / 3.0 * turn, 0.5 * x * turn, turn
    ahead, turn = size * slope[0], (1.0 + scale) * slope[1] + bias if v or omega else 0.0
    by_calibration[:, TIME_CONSTANT] = sign * c * ahead, sign * s * ahead, sign * turn
    return Motion(
        np.array([x, y, heading]), np.zeros((3, 3)), by_calibration, 0.0, 0.0, calibration, True
    )


def _add_errors(
    chords: list[tuple[Piece, float, float, float, float, float]],
    end: np.ndarray,
    rates: list[list[float]],
    jacobian: np.ndarray,
) -> np.ndarray:
    """Return the covariance of a motion, and fill in its Jacobian by scale, bias and slip.

    Each chord is an interval, its midpoint x, y, the cosine and sine of its direction, and its
    slip. A turn in it rotates everything from its midpoint to the motion's `end`.
    """
    xx = xy = xt = yy = yt = tt = 0.0
    scale_x = scale_y = scale_t = bias_x = bias_y = bias_t = slip_x = slip_y = 0.0
    end_x, end_y, _ = end.tolist()
    (a, a_speed, a_turn), (b, b_speed, b_turn), (h, h_speed, h_turn) = rates
    for (shift, swing, dt, v, omega, _), x, y, c, s, slips in chords:
        steady, speed, spin = dt if v or omega else 0.0, abs(v), abs(omega)
        along = steady * (a + a_speed * speed + a_turn * spin) + shift
        across = steady * (b + b_speed * speed + b_turn * spin) + shift
        heading = steady * (h + h_speed * speed + h_turn * spin) + swing
        dx, dy = y - end_y, end_x - x
        xx += dx * dx * heading + c * c * along + s * s * across
        xy += dx * dy * heading + c * s * (along - across)
        yy += dy * dy * heading + s * s * along + c * c * across
        xt, yt, tt = xt + dx * heading, yt + dy * heading, tt + heading
        scale_x, bias_x = scale_x + dx * omega * dt, bias_x + dx * steady
        scale_y, bias_y = scale_y + dy * omega * dt, bias_y + dy * steady
        scale_t, bias_t = scale_t + omega * dt, bias_t + steady
        slip_x, slip_y = slip_x - c * slips * dt, slip_y - s * slips * dt
    jacobian[:, TURN_SCALE] = scale_x, scale_y, scale_t
    jacobian[:, TURN_BIAS] = bias_x, bias_y, bias_t
    jacobian[:2, TURN_SLIP] = slip_x, slip_y
    return np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])


def _shift(delta: np.ndarray, v0: float, rate0: float, v1: float, rate1: float) -> np.ndarray:
    """Return the derivative of a motion by a delay of all its twists, shape (3,)."""
    c, s = math.cos(delta[2]), math.sin(delta[2])
    return np.array([v0 - rate0 * delta[1] - c * v1, rate0 * delta[0] - s * v1, rate0 - rate1])
