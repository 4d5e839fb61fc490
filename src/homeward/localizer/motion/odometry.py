"""Odometry: the preintegrated motion since the newest keyframe, through dropouts, too."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from homeward.drives.clock import LATE_S
from homeward.drives.drive import DriveSettings
from homeward.estimator import HOLD_S
from homeward.localizer.motion.preintegration import BEND, BENDS, LAG, Motion, Piece, integrate
from homeward.localizer.motion.process_noise import ProcessNoise
from homeward.localizer.motion.twists import STEADY_S, Twists
from homeward.localizer.settings import LocalizerSettings
from homeward.localizer.tunables import (
    MIN_USUAL_SPEED,
    MIN_USUAL_TURN_RATE,
    MOTION_MEMORY_S,
    SPEED_TIME_S,
    TURN_TIME_S,
)

ADVANCE_S = 0.5
"""Twists are integrated at least this often [s]."""
STRAIGHTEST = 0.2
"""So large a share of the path counts as the straightest [1]."""
STRAIGHT_BEFORE_M = 1.0
"""Before it began the robot is thought to have driven straight for so long [m]."""
NOTABLE_LAG = 0.25
"""A lag beyond this is told to the user [s]."""
LONGEST_LAG = 0.8
"""A lag beyond this is not believed [s]."""


def calibration_sigmas(
    drive: DriveSettings, settings: LocalizerSettings, scale_tells: bool
) -> np.ndarray:
    """Return how unknown the odometry's calibration is a priori, shape (5,).

    The scale of the speed is among it where something `scale_tells`: bearings cannot.
    """
    given, default = drive.odometry, settings.odometry
    speed = default.speed_scale if given.speed_scale_sigma is None else given.speed_scale_sigma
    scale, bias = given.turn_scale_sigma, given.turn_bias_sigma
    return np.array(
        [
            default.turn_scale if scale is None else scale,
            default.turn_bias if bias is None else bias,
            default.turn_slip if given.speed_scale_sigma is None else 0.0,
            settings.lag_sigma,
            speed if scale_tells else 0.0,
        ]
    )


def lag_words(calibration: np.ndarray) -> tuple[str, ...]:
    """Return what the user must know of the lag in a calibration (8,), if it is notable."""
    lag = float(calibration[LAG])
    if abs(lag) < NOTABLE_LAG:
        return ()
    way = "after" if lag > 0 else "before"
    return (f"By the bearings, twists act {abs(lag):.2f} s {way} their stamps: is it one clock?",)


class MotionPrior:
    """Motion prior: how fast the robot usually is, and so how far it may go during a dropout.

    Nobody knows where to, but hardly faster than usual. So its velocity is a random one of that
    size that is forgotten in `SPEED_TIME_S` (a process of Ornstein and Uhlenbeck, 1930): the shift
    grows with the time at first, and with its root later. What it grows by from one time to another
    depends on these two alone, not on how often somebody asked in between.
    """

    def __init__(self) -> None:
        self._moving, self._path, self._turned = 0.0, 0.0, 0.0

    def count(self, moving: float, path: float, turned: float) -> None:
        """Count time of moving [s], with the path [m] and the turns [rad] made in it."""
        keep = math.exp(-moving / MOTION_MEMORY_S)
        self._moving = keep * self._moving + moving
        self._path = keep * self._path + path
        self._turned = keep * self._turned + turned

    def variance_growth(self, silent: float, time: float) -> tuple[float, float]:
        """Return by what variances shift [m^2] and turn [rad^2] grow while odometry is silent.

        Parameters
        ----------
        silent, time : float
            How long it was silent before, and for how much longer [s].
        """
        moving = max(self._moving, 1e-9)
        speed, turn = (
            max(MIN_USUAL_SPEED, self._path / moving),
            max(MIN_USUAL_TURN_RATE, self._turned / moving),
        )
        shift, swing = _growth(silent, time, SPEED_TIME_S), _growth(silent, time, TURN_TIME_S)
        return speed**2 * shift, turn**2 * swing


class _Done(NamedTuple):
    """What is integrated, as it was before it ran ahead."""

    t: float
    motion: Motion
    path_by_bend: np.ndarray
    motion_prior: MotionPrior


class Odometry:
    """The motion since the last keyframe, by the twists.

    Parameters
    ----------
    twists : Twists
        The history of them, which others may share.
    noise : ProcessNoise
        Of them.
    """

    def __init__(self, twists: Twists, noise: ProcessNoise) -> None:
        self._twists, self._noise = twists, noise
        self._motion = Motion.identity()
        self._done = self._since = -math.inf
        self._path_by_bend = np.zeros(BENDS)
        self._path_by_bend[0] = STRAIGHT_BEFORE_M
        self._straightest = 0.0
        self._motion_prior = MotionPrior()
        self._before: deque[_Done] = deque()

    def rewind(self, t: float) -> None:
        """Undo what ran ahead of `t` [s], where a late twist came."""
        while self._before and t < self._done:
            self._done, self._motion, self._path_by_bend, self._motion_prior = self._before.pop()

    def restart(self, t: float) -> None:
        """Let the motion begin anew at `t` [s]: there is a keyframe now."""
        self._motion, self._done, self._since = Motion.identity(), t, t
        self._before.clear()
        share = self._path_by_bend.cumsum() / self._path_by_bend.sum()
        straight = int((share >= STRAIGHTEST).argmax())
        self._straightest = BEND * (straight + 0.5) if straight else 0.0

    def motion(self, t: float, calibration: np.ndarray) -> Motion:
        """Return the motion since the last keyframe up to `t` [s]; nothing changes.

        Parameters
        ----------
        t : float
            A time before the end of what is done counts as that end.
        calibration : ndarray, shape (8,)
            Where to linearise.
        """
        if t <= self._done:
            return self._motion
        pieces = self._pieces(self._done, t, calibration)
        return self._motion.compose(
            integrate(pieces, calibration, self._noise.rates, self._straightest)[0]
        )

    def advance(self, t: float, calibration: np.ndarray) -> Motion:
        """Return the motion up to `t` [s], and be done with it: nothing earlier is to come."""
        self.rewind(t)
        self._before.clear()
        self._integrate(t, calibration)
        return self._motion

    def run_ahead(self, t: float, calibration: np.ndarray) -> None:
        """Integrate up to `t` [s]; what comes up to `LATE_S` late is still taken."""
        done = self._path_by_bend.copy(), copy.copy(self._motion_prior)
        self._before.append(_Done(self._done, self._motion, *done))
        while len(self._before) > 1 and self._before[1].t <= t - LATE_S:
            self._before.popleft()
        self._integrate(t, calibration)

    def unknown(self, t: float) -> Motion:
        """Return the motion up to `t` [s], were odometry silent since the last keyframe."""
        shift, swing = self._motion_prior.variance_growth(0.0, t - self._since)
        covariance = np.diag([shift, shift, swing])
        return dataclasses.replace(Motion.identity(), covariance=covariance)

    def accepts(self, t: float) -> bool:
        """Return whether a sample of `t` [s] can be taken: no motion up to a later one was used."""
        return not self._twists or t >= (self._before[0].t if self._before else self._done)

    @property
    def needed(self) -> float:
        """Since when twists are still needed [s]."""
        return (self._before[0].t if self._before else self._done) - 2.0 * LONGEST_LAG - STEADY_S

    @property
    def done(self) -> float:
        """How far the twists are integrated [s]."""
        return self._done

    def _integrate(self, t: float, calibration: np.ndarray) -> None:
        """Add the motion up to `t` [s] to what is done."""
        if t <= self._done:
            return
        pieces = self._pieces(self._done, t, calibration)
        motion, path = integrate(pieces, calibration, self._noise.rates, self._straightest)
        self._motion, self._done = self._motion.compose(motion), t
        self._path_by_bend += path  # for r
        self._motion_prior.count(_time_moving(pieces), motion.path, motion.turned)

    def _pieces(self, begin: float, end: float, calibration: np.ndarray) -> list[Piece]:
        """Return the time from `begin` to `end` [s] in pieces of one twist, as for `integrate`."""
        lag = min(max(float(calibration[LAG]), -LONGEST_LAG), LONGEST_LAG)
        begin, end = begin - lag, end - lag
        held = self._twists.between(begin, end)
        if not held:  # before the first twist, or none at all
            return [Piece(*self._unknown(-math.inf, begin, end), 0.0, 0.0, 0.0, 0.0)]
        pieces: list[Piece] = []
        until = [twist.t for twist in held[1:]] + [end]
        steady = [twist.steady for twist in held[1:]] + [self._twists.steady_speed(end)]
        for twist, then, speed in zip(held, until, steady, strict=True):
            start, silent = max(twist.t, begin), twist.t + HOLD_S
            known = min(max(silent - start, 0.0), then - start)
            unknown = self._unknown(silent, start + known, then)
            pieces.append(Piece(*unknown, known, twist.v, twist.omega, speed))
        if held[0].t > begin:
            shift, swing = self._unknown(-math.inf, begin, held[0].t)
            begun = pieces[0]
            pieces[0] = begun._replace(shift=begun.shift + shift, swing=begun.swing + swing)
        return pieces

    def _unknown(self, silent: float, begin: float, end: float) -> tuple[float, float]:
        """Return what the variances grow by from `begin` to `end` [s], of a silence since then."""
        return (
            self._motion_prior.variance_growth(begin - silent, end - begin)
            if end > begin
            else (0.0, 0.0)
        )


def _time_moving(pieces: Sequence[Piece]) -> float:
    """Return for how long the robot moved in pieces of time [s]."""
    return sum(piece.dt for piece in pieces if piece.v or piece.omega)


def _growth(after: float, time: float, lasts: float) -> float:
    """Return how the variance of the integral of a velocity of variance one grows [s^2]."""
    return 2.0 * lasts * (time + lasts * math.exp(-after / lasts) * math.expm1(-time / lasts))
