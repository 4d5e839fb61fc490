"""Preintegration of odometry (Lupton and Sukkarieh, 2012; Forster et al., 2017).

The twists between two times become one motion, with its covariance and its Jacobian by the
calibration, so that a new calibration needs no new integration.

The true turn rate is ``(1 + turn_scale) omega + turn_bias`` while the robot moves; the true speed
ahead is reduced in bends by the slip ``turn_slip (|omega| - r |v|)``; twists act ``delay`` seconds
after their stamps; all speeds are ``1 + speed_scale`` times as large, and that to the left another
``1 + sideways_scale`` times. A robot whose twist is exactly zero is stationary, and gathers neither
drift nor noise.

The sideways scale is open only in motions at whose end the robot strafes: else jitter to and fro,
as of legs, would count as information on it.

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
    SIDEWAYS_SCALE,
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
    MIN_SIDEWAYS_SHARE,
    MIN_STEADY_SPEED,
    NUM_BENDS,
    SPEED_TIME_S,
    TURN_TIME_S,
)
from homeward.odometry.history import MOVING_SPEED, STEADY_S, OdometrySample
from homeward.odometry.validity import TWIST_VALIDITY_S

T, V, VY, OMEGA, UNTIL, HEADING, PATH, SIDE = range(8)
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

    twist: tuple[float, float, float]
    """Speeds ahead and to the left [m/s], and yaw rate [rad/s]."""
    slope: tuple[float, float, float]
    """Derivative by T of T times `twist` [m/s], [m/s], [rad/s]."""


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
    vy: float
    """[m/s]"""
    omega: float
    """[rad/s]"""
    steady: float
    """Smoothed `v`: slip computed from noisy samples would be correlated with their noise [m/s].
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

    Return the motion, the length driven ahead by class of turn per metre, (NUM_BENDS,) [m], and the
    time in motion [s].

    Parameters
    ----------
    table : ndarray, shape (n, 15)
        Twists in order of time, a row as `OdometrySample`.
    begin, end : float
        The times, of which the delay is not subtracted yet [s].
    calibration : ndarray, shape (10,)
        Linearisation point.
    rates : ndarray, shape (3, 3)
        Growth of the variances (`homeward.drives.settings.noise_rates`), along and across the
        direction of motion; those constant in time along the robot's axes if it has both.
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
    (scale, bias), (size, aside) = (
        calibration[[TURN_SCALE, TURN_BIAS]].tolist(),
        _sizes(calibration),
    )
    motion.jacobian[:2, SPEED_SCALE] = motion.delta[:2] / size
    if not strafes(table, end):
        motion.jacobian[:, SIDEWAYS_SCALE] = 0.0
    twists = [
        (size * v, aside * vy, (1.0 + scale) * omega + bias if v or vy or omega else 0.0)
        for (v, vy, omega), _ in ends
    ]
    motion.jacobian[:, DELAY] = _shift(motion.delta, *twists)
    return motion, by_bend, sum(p.dt for p in pieces if p.v or p.vy or p.omega)


def settled(table: np.ndarray, t: float, time_constant: float) -> SettledTwist:
    """Return the robot's twist at `t` [s]; the time constant [s] is `MEAN_S` / 2 at least."""
    if not len(table):
        return SettledTwist((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    lag = max(time_constant, 0.5 * MEAN_S)
    times = t - lag * LAG_TIMES
    rows = table[np.maximum(table[:, T].searchsorted(times, "right") - 1, 0)]
    dt = times - rows[:, T]  # the first twist counts before its stamp, too
    dt = np.where(dt > 0.0, np.maximum(np.minimum(dt, rows[:, UNTIL] - rows[:, T]), 0.0), dt)
    reckoned = rows[:, [PATH, SIDE, HEADING]] + rows[:, [V, VY, OMEGA]] * dt[:, None]
    rates = (reckoned[:-1] - reckoned[1:]) / (lag * np.diff(LAG_TIMES))[:, None]
    (v, vy, omega), (by_v, by_vy, by_omega) = (WEIGHTS @ rates).tolist()
    return SettledTwist((v, vy, omega), (by_v, by_vy, by_omega))


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
        return [Piece(*dropout(-math.inf, begin, end), 0.0, 0.0, 0.0, 0.0, 0.0)]
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
            shift += (BRIDGED * math.hypot(twist.v, twist.vy) * bridged) ** 2
            swing += (BRIDGED * twist.omega * bridged) ** 2
        pieces.append(Piece(shift, swing, known, twist.v, twist.vy, twist.omega, speed))
    if held[0].t > begin:
        shift, swing = dropout(-math.inf, begin, held[0].t)
        begun = pieces[0]
        pieces[0] = begun._replace(shift=begun.shift + shift, swing=begun.swing + swing)
    return pieces


def steady_speed(table: np.ndarray, t: float) -> float:
    """Return the mean speed ahead just before `t` [s], without the noise of single samples [m/s].

    There is a twist at least.
    """
    return _steady_speeds(table, t)[0]


def strafes(table: np.ndarray, t: float) -> bool:
    """Return whether the robot moves sideways at `t` [s], beyond jitter to and fro."""
    if not len(table):
        return False
    ahead, side = _steady_speeds(table, t)
    return abs(side) > max(MOVING_SPEED, MIN_SIDEWAYS_SHARE * abs(ahead))


def _steady_speeds(table: np.ndarray, t: float) -> tuple[float, float]:
    """Return the mean speeds ahead and to the left just before `t` [s], as `steady_speed`."""
    rows = table[np.maximum(table[:, T].searchsorted([t - STEADY_S, t], "right") - 1, 0)].tolist()
    (_, *before), (_, *now) = (
        OdometrySample._make(row).reckoned(at)
        for row, at in zip(rows, (t - STEADY_S, t), strict=True)
    )
    return (now[0] - before[0]) / STEADY_S, (now[1] - before[1]) / STEADY_S


def _sizes(calibration: np.ndarray) -> tuple[float, float]:
    """Return the factors of the speeds ahead and to the left."""
    size = 1.0 + float(calibration[SPEED_SCALE])
    return size, size * (1.0 + float(calibration[SIDEWAYS_SCALE]))


def _commanded(
    pieces: Sequence[Piece], calibration: np.ndarray, rates: np.ndarray, straightest: float
) -> tuple[Motion, np.ndarray]:
    """Integrate pieces without a lag; return the motion, and the length ahead by bend [m]."""
    scale, bias, slip = calibration[[TURN_SCALE, TURN_BIAS, TURN_SLIP]].tolist()
    size, aside = _sizes(calibration)
    x = y = psi = path = turned = side_x = side_y = 0.0
    by_bend, chords = [0.0] * NUM_BENDS, []
    for piece in pieces:  # of so few numbers, floats are quicker than arrays
        _, _, dt, v, vy, omega, steady = piece
        spin, rate = abs(omega), (1.0 + scale) * omega + bias if v or vy or omega else 0.0
        ahead = steady if abs(steady) > MIN_STEADY_SPEED else v
        slips = math.copysign(spin, ahead) - steady * straightest if v else 0.0
        speed, half = size * (v - slip * slips), 0.5 * rate * dt
        c, s = math.cos(psi + half), math.sin(psi + half)
        shrink = math.sin(half) / half if half else 1.0
        chord, left = speed * dt * shrink, aside * vy * dt * shrink
        side_x, side_y = side_x - left * s, side_y + left * c
        dx, dy = chord * c - left * s, chord * s + left * c
        chords.append((piece, x + 0.5 * dx, y + 0.5 * dy, c, s, size * slips))
        x, y, psi = x + dx, y + dy, psi + 2.0 * half
        path, turned = path + math.hypot(v, vy) * dt, turned + 2.0 * abs(half)
        by_bend[min(int(spin / max(abs(steady), 1e-6) / BEND), NUM_BENDS - 1)] += abs(v) * dt
    delta, jacobian = np.array([x, y, psi]), np.zeros((3, NC))
    jacobian[:2, SIDEWAYS_SCALE] = side_x * size / aside, side_y * size / aside
    covariance = _add_errors(chords, delta, rates.tolist(), jacobian)
    motion = Motion(delta, covariance, jacobian, path, turned, calibration, True)
    return motion, np.array(by_bend)


def _outstanding(
    twist: tuple[float, float, float],
    slope: tuple[float, float, float],
    calibration: np.ndarray,
    sign: float,
) -> Motion:
    """Return the commanded motion that the robot still has to make, forward or backward by sign.

    A first-order lag is behind its command by its time constant times its own twist.
    """
    scale, bias, lag = calibration[[TURN_SCALE, TURN_BIAS, TIME_CONSTANT]].tolist()
    (size, aside), (v, vy, omega), (by_v, by_vy, by_omega) = _sizes(calibration), twist, slope
    rate, by_rate = (
        (1.0 + scale) * turn + bias if v or vy or omega else 0.0 for turn in (omega, by_omega)
    )
    half, heading = 0.5 * rate * sign * lag, rate * sign * lag
    shrink = math.sin(half) / half if half else 1.0
    chord, left = size * v * sign * lag * shrink, aside * vy * sign * lag * shrink
    c, s = math.cos(half), math.sin(half)
    delta = np.array([chord * c - left * s, chord * s + left * c, heading])
    by_calibration = np.zeros((3, NC))
    ahead, side = chord * c, left * c
    by_turn = np.array(
        [-ahead * heading / 3.0 - 0.5 * side, 0.5 * ahead - side * heading / 3.0, 1.0]
    )
    by_calibration[:, TURN_SCALE] = by_turn * (sign * lag * omega)
    by_calibration[:, TURN_BIAS] = by_turn * (sign * lag)
    by_calibration[:2, SIDEWAYS_SCALE] = -left * s * size / aside, left * c * size / aside
    c, s, ahead, side = math.cos(heading), math.sin(heading), size * by_v, aside * by_vy
    by_calibration[:, TIME_CONSTANT] = c * ahead - s * side, s * ahead + c * side, by_rate
    by_calibration[:, TIME_CONSTANT] *= sign
    return Motion(delta, np.zeros((3, 3)), by_calibration, 0.0, 0.0, calibration, True)


def _add_errors(
    chords: list[tuple[Piece, float, float, float, float, float]],
    end: np.ndarray,
    rates: list[list[float]],
    jacobian: np.ndarray,
) -> np.ndarray:
    """Return the covariance of a motion, and fill in its Jacobian by scale, bias and slip.

    Each chord is an interval, its midpoint x, y, the cosine and sine of the heading there, and its
    slip. A turn in it rotates everything from its midpoint to the motion's `end`.
    """
    xx = xy = xt = yy = yt = tt = 0.0
    scale_x = scale_y = scale_t = bias_x = bias_y = bias_t = slip_x = slip_y = 0.0
    end_x, end_y, _ = end.tolist()
    (a, a_speed, a_turn), (b, b_speed, b_turn), (h, h_speed, h_turn) = rates
    for (shift, swing, dt, v, vy, omega, _), x, y, c, s, slips in chords:
        steady, speed, spin = dt if v or vy or omega else 0.0, math.hypot(v, vy), abs(omega)
        along = steady * (a + a_speed * speed + a_turn * spin) + shift
        across = steady * (b + b_speed * speed + b_turn * spin) + shift
        heading = steady * (h + h_speed * speed + h_turn * spin) + swing
        slip_x, slip_y = slip_x - c * slips * dt, slip_y - s * slips * dt
        if vy:  # from the heading to the direction of the motion
            if b:
                own, other = steady * a, steady * b
                along, across = along - own, across - other
                xx += c * c * own + s * s * other
                xy += c * s * (own - other)
                yy += s * s * own + c * c * other
            c, s = (c * v - s * vy) / speed, (s * v + c * vy) / speed
        dx, dy = y - end_y, end_x - x
        xx += dx * dx * heading + c * c * along + s * s * across
        xy += dx * dy * heading + c * s * (along - across)
        yy += dy * dy * heading + s * s * along + c * c * across
        xt, yt, tt = xt + dx * heading, yt + dy * heading, tt + heading
        scale_x, bias_x = scale_x + dx * omega * dt, bias_x + dx * steady
        scale_y, bias_y = scale_y + dy * omega * dt, bias_y + dy * steady
        scale_t, bias_t = scale_t + omega * dt, bias_t + steady
    jacobian[:, TURN_SCALE] = scale_x, scale_y, scale_t
    jacobian[:, TURN_BIAS] = bias_x, bias_y, bias_t
    jacobian[:2, TURN_SLIP] = slip_x, slip_y
    return np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])


def _shift(
    delta: np.ndarray, first: tuple[float, float, float], last: tuple[float, float, float]
) -> np.ndarray:
    """Return the derivative of a motion by a delay of all its twists, shape (3,)."""
    (x, y, heading), (v0, vy0, rate0), (v1, vy1, rate1) = delta.tolist(), first, last
    c, s = math.cos(heading), math.sin(heading)
    return np.array(
        [v0 - rate0 * y - (c * v1 - s * vy1), vy0 + rate0 * x - (s * v1 + c * vy1), rate0 - rate1]
    )
