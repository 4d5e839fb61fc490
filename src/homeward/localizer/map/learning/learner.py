"""Adaptive noise and extrinsics, and walking landmarks, by the residuals of a solved map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from homeward.localizer import kernels
from homeward.localizer.inputs.bearing_noise import BearingNoise
from homeward.localizer.map.landmarks import Landmarks
from homeward.localizer.map.learning.walking import update_walking
from homeward.localizer.map.sightings import GAP, LANDMARK, OWN, SIGMA
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.motion.extrinsics import Extrinsics
from homeward.localizer.motion.odometry import ProcessNoise, shows_lag
from homeward.localizer.motions import DELAY
from homeward.localizer.reference.extension import Unknown
from homeward.localizer.reference.factors import cauchy_weights
from homeward.localizer.reference.window import Linearised
from homeward.localizer.tunables import GATE, MAX_INFLATION, ODOMETRY_EVERY, USUAL_DISTANCE_M


class Learner:
    """Learns from the residuals of bearings and motions in solutions of a map.

    Prior standard deviations: `time_constant_sigma` of the odometry's time constant once it is free
    [s], `slip_sigma` of slip in bends, of robots in a room [m].
    """

    def __init__(
        self,
        noise: BearingNoise,
        process_noise: ProcessNoise,
        extrinsics: Extrinsics,
        time_constant_sigma: float | None,
        slip_sigma: float,
    ) -> None:
        self._noise, self._process_noise, self._extrinsics = noise, process_noise, extrinsics
        self._time_constant_sigma, self._slip_sigma = time_constant_sigma, slip_sigma
        self._updated_at = self._odometry_updated_at = 0

    @property
    def is_noise_confirmed(self) -> bool:
        """Whether residuals confirm the noise of the bearings."""
        return self._noise.confirmed

    def scale_noise_prior(self, smoother: Smoother) -> None:
        """Scale the prior of the odometry noise to the scene: robots are no larger than it.

        A robot k times as large that drives k times as far errs and slips k times as far, so its
        variance per metre is k times as large. In a hall the robot may be as small as in a room.
        """
        share = min(1.0, smoother.state.scale / USUAL_DISTANCE_M)
        smoother.scale_odometry(self._process_noise.scale_prior(share))
        smoother.slip_sigma = share * self._slip_sigma

    def learn_bearings(self, smoother: Smoother, landmarks: Landmarks) -> None:
        """Update the noise of bearings, then the walking landmarks.

        `numpy.linalg.LinAlgError` when the normal equations are singular.
        """
        newest, residuals = smoother.newest, smoother.residuals()
        own, total, gaps, numbers = smoother.sightings[:, [OWN, SIGMA, GAP, LANDMARK]].T
        since, self._updated_at = newest - self._updated_at, newest
        factor = self._noise.update(residuals, own, total, gaps, numbers, since)
        if factor != 1.0:
            smoother.scale_noise(factor)
            landmarks.scale_noise(factor)
        if smoother.converged:
            update_walking(smoother, [*landmarks.mapped.values(), *landmarks.former.values()])

    def learn_odometry(self, smoother: Smoother) -> None:
        """Update the noise of odometry, not at each solution.

        `numpy.linalg.LinAlgError` when the normal equations are singular.
        """
        since = smoother.newest - self._odometry_updated_at
        if since >= ODOMETRY_EVERY and smoother.converged:
            self._odometry_updated_at = smoother.newest
            sums, motions = _odometry_misfit(smoother), len(smoother.stamps) - 1
            smoother.scale_odometry(self._process_noise.update(*sums, motions, min(since, motions)))

    def free_contradicted(self, smoother: Smoother) -> bool:
        """Free extrinsics and time constant where the map contradicts zero; return whether so.

        That happens once for each, and requires another solution.
        """
        now = smoother.state
        calibration, variances = now.calibration, now.calibration_variances
        if not (smoother.converged and self._noise.confirmed):
            return False
        extrinsics = self._extrinsics.test(calibration, variances, now.scale)
        if extrinsics:
            smoother.mount_sigmas = self._extrinsics.sigmas
        sigma = self._time_constant_sigma
        if sigma is None or not shows_lag(calibration, variances):
            return extrinsics
        smoother.time_constant_prior, self._time_constant_sigma = (0.0, sigma), None
        # A negative delay with a time constant would be a filter of noise without a lag.
        smoother.one_sided.append(DELAY)
        return True


def _odometry_misfit(smoother: Smoother) -> Misfit:
    """Compare the residuals of motions in the last solution with their expectation."""
    given, rows = smoother.linearised(), smoother.sightings
    sigma, rng = rows[:, SIGMA], np.random.default_rng(smoother.newest)
    error = given.seen.residual * smoother.effective_sigmas(rows) / sigma
    return misfit(given, error, (rows[:, OWN] / sigma) ** 2, rng)


CHI_SQUARES = chdtri(3, (np.arange(64) + 0.5) / 64)
"""Quantiles of the squared Mahalanobis distance of a motion."""


class Misfit(NamedTuple):
    """Residuals of motions in a solved map, for shift and turn, each (2, 2).

    In the first row with robust weights; in the second unweighted, but bounded by the gate.
    """

    squares: np.ndarray
    """Sums of squared residuals over the assumed variances."""
    redundancies: np.ndarray
    """Their expectations."""


def misfit(
    given: Linearised, error: np.ndarray, own: np.ndarray, rng: np.random.Generator
) -> Misfit:
    """Compare the residuals of motions in a window at its solution with their expectation.

    `error` (m,) are the residuals of bearings over the standard deviations of single ones, `own`
    (m,) the shares of their own noise in their variances; the rest is from odometry [1]. `rng` is
    the source of the signs.
    """
    motions, clear, steps = given.motions, own >= MAX_INFLATION**-2.0, len(given.motions.error)
    covariance, weight = np.linalg.inv(motions.information), motions.weight[:, None, None]
    root = np.zeros_like(covariance)  # of the information on shift, and on turn
    root[:, :2, :2] = np.linalg.cholesky(np.linalg.inv(covariance[:, :2, :2])).transpose(0, 2, 1)
    root[:, 2, 2] = covariance[:, 2, 2] ** -0.5
    root *= np.sqrt(weight)
    # Errors with random signs, of bearings, shift and turn: the map absorbs a part of them.
    used = clear.size if clear.any() else 0
    drawn = rng.choice([-1.0, 1.0], used + 3 * steps)
    by_bearing, by_motion, signs = np.zeros((clear.size, 3)), root * 0.0, np.zeros((steps, 3, 2))
    by_bearing[clear, 0] = drawn[:used][clear[:used]]
    signs[:, :2, 0], signs[:, 2, 1] = drawn[used:-steps].reshape(-1, 2), drawn[-steps:]
    by_motion[:, :, 1:] = covariance @ (root.transpose(0, 2, 1) @ signs / weight)
    unknown = Unknown(by_bearing, np.zeros_like(given.seen.pose), np.zeros(3), by_motion)
    bearings, absorbed = kernels.extend(given, unknown, with_absorbed=True).absorbed

    overestimated = 1.0 - bearing_variance(error, by_bearing[:, 0], bearings[:, 0])
    free = signs * (signs - root @ absorbed[:, :, 1:])
    by_bearings = own @ bearings[:, 1:] ** 2 / np.maximum(free.sum(axis=(0, 1)), 1e-9)
    free *= 1.0 - overestimated * np.minimum(by_bearings, 1.0)
    square = (root @ motions.error[:, :, None]) ** 2 * signs**2
    squares = np.sum([weight * square, np.minimum(square / weight, GATE**2)], axis=(1, 2))
    redundancies = np.sum([weight * free, free], axis=(1, 2))
    redundancies[0] *= _robust_share(redundancies[1].sum() / motions.error.size)
    return Misfit(squares, redundancies)


def bearing_variance(error: np.ndarray, signs: np.ndarray, absorbed: np.ndarray) -> float:
    """Return the variance of bearings over the assumed one, 1 at most: `BearingNoise` finds more.

    From bearings with random `signs` (m,), of which the map absorbs some part (m,); 0: no part.
    """
    clear = signs != 0.0
    if not clear.any():
        return 1.0
    free = (signs - absorbed)[clear]
    redundancy, own = float(signs[clear] @ free), float(free @ free)
    squares = float(np.minimum(error[clear] ** 2, GATE**2).sum())
    return min(max((squares - (redundancy - own)) / own, 0.0), 1.0)


def _robust_share(redundancy: float) -> float:
    """Return the share of the squares of Gaussian motions that robust weights leave [1]."""
    squares = max(redundancy, 1e-3) * CHI_SQUARES
    weight = cauchy_weights(squares)
    return float((weight**2 * squares).mean() / (weight.mean() * squares.mean()))
