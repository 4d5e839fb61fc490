"""Preintegration of odometry (Lupton and Sukkarieh, 2012; Forster et al., 2017).

The twists between two times become one motion, with its covariance and its Jacobian by the
calibration, so that a new calibration needs no new integration.

The true turn rate is ``(1 + turn_scale) omega + turn_bias`` while the robot moves; the true speed
is reduced in bends by the slip ``turn_slip (|omega| - r |v|)``; twists act ``delay`` seconds after
their stamps; all speeds are ``1 + speed_scale`` times as large. A robot whose twist is exactly zero
is stationary, and gathers neither drift nor noise.

Where odometry is the commanded twist u, the robot follows as a first-order lag with the time
constant T: its twist is s, with ``T ds/dt = u - s``. Its pose is then the commanded one less the
motion ``exp(T s)``, exact for a constant direction of u; so only the ends of a motion change.

In the slip, r is the turn per metre of this robot where it drives straightest. The speed is right
there, and slip is zero for a robot that always turns alike; else slip could be traded for the scale
of the map, which nothing else determines: it would shrink, since small maps fit noise better.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from homeward.localizer.motions import (
    DELAY,
    NC,
    SPEED_SCALE,
    TIME_CONSTANT,
    TURN_BIAS,
    TURN_SCALE,
    TURN_SLIP,
    Motion,
)
from homeward.localizer.tunables import (
    BEND,
    BRIDGED,
    MAX_LAG_S,
    MEAN_S,
    MIN_STEADY_SPEED,
    NUM_BENDS,
    SPEED_TIME_S,
    TURN_TIME_S,
)
from homeward.odometry.history import STEADY_S, OdometrySample
from homeward.odometry.validity import TWIST_VALIDITY_S

T, V, OMEGA, UNTIL, HEADING, PATH = range(6)
"""Columns of the table of twists; see `OdometrySample`."""
LAG_TIMES = -np.log1p(-np.arange(11) / 10.5)
"""Times before the present, in time constants, between which a first-order lag weighs the command
equally."""
_SLOPES = -np.diff((1.0 + LAG_TIMES) * np.exp(-LAG_TIMES))
WEIGHTS = np.stack([np.full(_SLOPES.size, 1.0 / _SLOPES.size), _SLOPES / _SLOPES.sum()])
"""(2, 10): weights of those intervals in the twist, and in the derivative by T of T times it, T the
time constant."""


class SettledTwist(NamedTuple):
    """The twist of a robot that follows its odometry as a first-order lag with time constant T."""

    twist: tuple[float, float]
    """Speed [m/s] and yaw rate [rad/s]."""
    slope: tuple[float, float]
    """Derivative by T of T times `twist` [m/s], [rad/s]."""


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


def preintegrate(
    table: np.ndarray,
    begin: float,
    end: float,
    calibration: np.ndarray,
    rates: np.ndarray,
    usual: tuple[float, float],
    straightest: float,
) -> tuple[Motion, np.ndarray, float]:
    """Preintegrate the twists between two times.

    Return the motion, the length driven by class of turn per metre, (NUM_BENDS,) [m], and the time
    in motion [s].

    Parameters
    ----------
    table : ndarray, shape (n, 13)
        Twists in order of time, a row as `OdometrySample`.
    begin, end : float
        The times, of which the delay is not subtracted yet [s].
    calibration : ndarray, shape (9,)
        Linearisation point.
    rates : ndarray, shape (3, 3)
        Growth of the variances (`homeward.drives.settings.noise_rates`).
    usual : tuple of float
        Usual speed [m/s] and turn rate [rad/s], for dropouts.
    straightest : float
        Turn per metre where the robot drives straightest, r above [rad/m].
    """
    delay, constant = calibration[[DELAY, TIME_CONSTANT]].tolist()
    delay, constant = min(max(delay, -MAX_LAG_S), MAX_LAG_S), min(constant, MAX_LAG_S)
    begin, end = begin - delay, end - delay
    # The noise of single samples at the ends would count as information on the delay.
    known = max(begin, float(table[0, T])) if len(table) else end
    ends = settled(table, known, constant), settled(table, end, constant)
    pieces = _pieces(table, begin, end, usual)
    motion, by_bend = _commanded(pieces, calibration, rates, straightest)
    first, last = (
        _outstanding(*at, calibration, sign) for at, sign in zip(ends, (1.0, -1.0), strict=True)
    )
    motion = first.compose(motion).compose(last)
    (scale, bias), size = calibration[[TURN_SCALE, TURN_BIAS]].tolist(), _size(calibration)
    motion.jacobian[:2, SPEED_SCALE] = motion.delta[:2] / size
    twists = [(size * v, (1.0 + scale) * w + bias if v or w else 0.0) for (v, w), _ in ends]
    motion.jacobian[:, DELAY] = _shift(motion.delta, *twists[0], *twists[1])
    return motion, by_bend, sum(piece.dt for piece in pieces if piece.v or piece.omega)


def settled(table: np.ndarray, t: float, time_constant: float) -> SettledTwist:
    """Return the robot's twist at `t` [s]; the time constant [s] is `MEAN_S` / 2 at least."""
    if not len(table):
        return SettledTwist((0.0, 0.0), (0.0, 0.0))
    lag = max(time_constant, 0.5 * MEAN_S)
    times = t - lag * LAG_TIMES
    rows = table[np.maximum(table[:, T].searchsorted(times, "right") - 1, 0)]
    dt = times - rows[:, T]  # the first twist counts before its stamp, too
    dt = np.where(dt > 0.0, np.maximum(np.minimum(dt, rows[:, UNTIL] - rows[:, T]), 0.0), dt)
    reckoned = rows[:, [PATH, HEADING]] + rows[:, [V, OMEGA]] * dt[:, None]
    rates = (reckoned[:-1] - reckoned[1:]) / (lag * np.diff(LAG_TIMES))[:, None]
    (v, omega), (by_v, by_omega) = (WEIGHTS @ rates).tolist()
    return SettledTwist((v, omega), (by_v, by_omega))


def variance_growth(silent: float, time: float, usual: tuple[float, float]) -> tuple[float, float]:
    """Return the growth of the variances of shift [m^2] and turn [rad^2] during a dropout.

    Odometry was `silent` before, and is for `time` more [s]; `usual` as in `preintegrate`.
    """
    shift, turn = (_variance(silent, time, lasts) for lasts in (SPEED_TIME_S, TURN_TIME_S))
    return usual[0] ** 2 * shift, usual[1] ** 2 * turn


def _variance(after: float, time: float, lasts: float) -> float:
    """Return the growth of an integrated Ornstein-Uhlenbeck process of unit variance [s^2]."""
    return 2.0 * lasts * (time + lasts * math.exp(-after / lasts) * math.expm1(-time / lasts))


def _pieces(table: np.ndarray, begin: float, end: float, usual: tuple[float, float]) -> list[Piece]:
    """Return the time from `begin` to `end` [s] in pieces of one twist."""
    first, last = table[:, T].searchsorted([begin, end]).tolist()
    held = [OdometrySample._make(row) for row in table[max(first - 1, 0) : last].tolist()]

    def dropout(silent: float, since: float, until: float) -> tuple[float, float]:
        if until <= since:
            return 0.0, 0.0
        # Of Unix time, the sum of a stamp and a validity is rounded by up to 0.1 us.
        return variance_growth(max(since - silent, 0.0), until - since, usual)

    if not held:  # before the first twist, or none at all
        return [Piece(*dropout(-math.inf, begin, end), 0.0, 0.0, 0.0, 0.0)]
    pieces: list[Piece] = []
    until = [twist.t for twist in held[1:]] + [end]
    steady = [twist.steady for twist in held[1:]] + [steady_speed(table, end)]
    for twist, then, speed in zip(held, until, steady, strict=True):
        start, silent = max(twist.t, begin), twist.until
        known = min(max(silent - start, 0.0), then - start)
        shift = swing = 0.0
        if start + known < then:
            shift, swing = dropout(silent, start + known, then)
        if (bridged := start + known - max(start, twist.t + TWIST_VALIDITY_S)) > 0.0:
            shift += (BRIDGED * twist.v * bridged) ** 2
            swing += (BRIDGED * twist.omega * bridged) ** 2
        pieces.append(Piece(shift, swing, known, twist.v, twist.omega, speed))
    if held[0].t > begin:
        shift, swing = dropout(-math.inf, begin, held[0].t)
        begun = pieces[0]
        pieces[0] = begun._replace(shift=begun.shift + shift, swing=begun.swing + swing)
    return pieces


def steady_speed(table: np.ndarray, t: float) -> float:
    """Return the mean speed just before `t` [s], without the noise of single samples [m/s].

    There is a twist at least.
    """
    rows = table[np.maximum(table[:, T].searchsorted([t - STEADY_S, t], "right") - 1, 0)].tolist()
    before, now = (
        OdometrySample._make(row).reckoned(at)[1]
        for row, at in zip(rows, (t - STEADY_S, t), strict=True)
    )
    return (now - before) / STEADY_S


def _size(calibration: np.ndarray) -> float:
    """Return the factor of all speeds."""
    return 1.0 + float(calibration[SPEED_SCALE])


def _commanded(
    pieces: Sequence[Piece], calibration: np.ndarray, rates: np.ndarray, straightest: float
) -> tuple[Motion, np.ndarray]:
    """Integrate pieces without a lag; return the motion, and the length driven by bend [m]."""
    scale, bias, slip = calibration[[TURN_SCALE, TURN_BIAS, TURN_SLIP]].tolist()
    size = _size(calibration)
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
    motion = Motion(delta, covariance, jacobian, path, turned, calibration, True)
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
    size, (v, omega) = _size(calibration), twist
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
